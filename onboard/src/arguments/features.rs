//! Switches of the features of images.

use anyhow::{Context as _, Result, bail};
use clap::builder::{OsStringValueParser, TypedValueParser};
use std::path::PathBuf;
use vision::features::{DEFAULT_EXTRACTOR, open};
use vision::{FeatureExtractor, GrayImage};

/// Heading of these switches in `--help`.
const HEADING: &str = "Image features";

/// Most extractors at once: that many images, and a little more, are in memory.
const MAX_EXTRACTORS: usize = 8;

/// Most features of an image where nothing else is said.
pub const DEFAULT_MAX_FEATURES: usize = 1000;

/// Which features of images are matched with the map's.
#[derive(clap::Args, Clone, Debug)]
pub struct FeatureArguments {
    /// Extractor of features for place recognition: sift-1, edgepoint2-1 (learned), or one with weights to fetch (see `driftless weights`)
    /// [default: the map's, where a command reads the map or asks its server before it extracts; else sift-1]
    #[arg(long, value_name = "NAME", help_heading = HEADING)]
    pub extractor: Option<String>,
    /// Folder with the weights of learned extractors [default: where `driftless weights` puts them]
    #[arg(long, value_name = "DIR", help_heading = HEADING)]
    pub weights: Option<PathBuf>,
    /// Maximum number of features per image
    #[arg(long, value_name = "N", default_value_t = DEFAULT_MAX_FEATURES, help_heading = HEADING)]
    pub max_features: usize,
    /// Image that is black (zero) where camera 0 sees the robot itself; of several cameras one each, separated by commas, in their
    /// order, with nothing between the commas for a camera without a mask
    #[arg(long, value_name = "FILE[,FILE]", value_delimiter = ',', value_parser = mask_path(), help_heading = HEADING)]
    pub mask: Vec<PathBuf>,
}

impl FeatureArguments {
    /// Where no extractor was given: the one that a map was built with.
    ///
    /// # Arguments
    /// * `extractor`: as the map names it; empty where that is not known.
    pub fn or_of_map(&self, extractor: &str) -> Self {
        let of_map = Some(extractor).filter(|name| !name.is_empty()).map(str::to_owned);
        Self { extractor: self.extractor.clone().or(of_map), ..self.clone() }
    }

    /// The switches that differ from their defaults, of which a command without images makes nothing.
    pub fn given(&self) -> Vec<&'static str> {
        let switches = [
            ("--extractor", self.extractor.is_some()),
            ("--weights", self.weights.is_some()),
            ("--max-features", self.max_features != DEFAULT_MAX_FEATURES),
            ("--mask", !self.mask.is_empty()),
        ];
        switches.into_iter().filter(|(_, is_given)| *is_given).map(|(name, _)| name).collect()
    }

    /// Opens the extractor for the images of a map.
    ///
    /// # Errors
    /// An unknown name, missing or damaged weights, --max-features out of range.
    pub fn open(&self) -> Result<Box<dyn FeatureExtractor>> {
        self.open_for(protocol::MAX_FEATURES)
    }

    /// Opens the extractor for images that a map server is queried with.
    ///
    /// # Errors
    /// As of [`FeatureArguments::open`].
    pub fn open_for_queries(&self) -> Result<Box<dyn FeatureExtractor>> {
        self.open_for(protocol::MAX_QUERY_FEATURES)
    }

    fn open_for(&self, most: usize) -> Result<Box<dyn FeatureExtractor>> {
        if self.max_features == 0 || self.max_features > most {
            bail!("--max-features {}: give a number from 1 to {most}", self.max_features);
        }
        let name = self.extractor.as_deref().unwrap_or(DEFAULT_EXTRACTOR);
        open(name, self.weights.as_deref()).context("--extractor")
    }

    /// Opens one extractor for each processor.
    ///
    /// # Errors
    /// As [`FeatureArguments::open`].
    pub fn open_several(&self) -> Result<Vec<Box<dyn FeatureExtractor>>> {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        (0..processors.min(MAX_EXTRACTORS)).map(|_| self.open()).collect()
    }

    /// Reads the masks of the cameras, in their order.
    ///
    /// # Errors
    /// A file is not an image.
    pub fn read_masks(&self) -> Result<Vec<Option<GrayImage>>> {
        read_masks(&self.mask)
    }
}

/// Parses one path of `--mask`, which may be empty, unlike other paths.
pub fn mask_path() -> impl TypedValueParser<Value = PathBuf> {
    OsStringValueParser::new().map(PathBuf::from)
}

/// Reads the masks of cameras, in their order; an empty path is that of a camera without one.
///
/// # Errors
/// A file is not an image.
pub fn read_masks(paths: &[PathBuf]) -> Result<Vec<Option<GrayImage>>> {
    let read = |path: &PathBuf| {
        let is_none = path.as_os_str().is_empty();
        (!is_none).then(|| GrayImage::read(path)).transpose().context("--mask")
    };
    paths.iter().map(read).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Program {
        #[command(flatten)]
        features: FeatureArguments,
    }

    #[test]
    fn the_extractor_is_the_given_one_else_the_maps_else_the_default() {
        let parse = |line: &str| Program::parse_from(line.split(' ')).features;
        let name = |features: &FeatureArguments| features.open().unwrap().name().to_owned();
        let given = parse("program --extractor sift-1");
        assert_eq!(name(&given.or_of_map("edgepoint2-1")), "sift-1");
        let silent = parse("program");
        assert_eq!(name(&silent.or_of_map("edgepoint2-1")), "edgepoint2-1");
        assert_eq!(name(&silent.or_of_map("")), DEFAULT_EXTRACTOR);
        assert_eq!(name(&silent), DEFAULT_EXTRACTOR);
    }

    #[test]
    fn switches_that_were_given_are_known() {
        let given = |line: &str| Program::parse_from(line.split(' ')).features.given();
        assert_eq!(given("program --max-features 1000"), [""; 0]);
        assert_eq!(given("program --weights w --max-features 300"), ["--weights", "--max-features"]);
        assert_eq!(given("program --mask hood.png --extractor sift-1"), ["--extractor", "--mask"]);
    }

    #[test]
    fn cameras_without_a_mask_are_left_out_between_commas() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("hood.png");
        let mask = GrayImage::from_fn(4, 3, |x, _| if x < 2 { 0 } else { 255 });
        std::fs::write(&path, mask.to_png().unwrap()).unwrap();
        let read = |masks: &str| Program::parse_from(["robot", "--mask", masks]).features.read_masks();
        let file = path.display().to_string();
        assert_eq!(read(&file).unwrap(), [Some(mask.clone())]);
        assert_eq!(read(&format!(",,{file}")).unwrap(), [None, None, Some(mask)]);
        assert!(read(&format!("{file},missing.png")).is_err());
    }
}
