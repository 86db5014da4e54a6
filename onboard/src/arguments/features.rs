//! Switches of the features of images.

use anyhow::{Context as _, Result, bail};
use std::path::PathBuf;
use vision::features::{DEFAULT_EXTRACTOR, open};
use vision::{FeatureExtractor, GrayImage};

/// Heading of these switches in `--help`.
const HEADING: &str = "Image features";

/// Most extractors at once: that many images, and a little more, are in memory.
const MAX_EXTRACTORS: usize = 8;

/// Which features of images are matched with the map's.
#[derive(clap::Args, Clone, Debug)]
pub struct FeatureArguments {
    /// Extractor of features for place recognition: sift-1, edgepoint2-1 (learned), or one with weights to fetch (see `driftless weights`)
    #[arg(long, value_name = "NAME", default_value = DEFAULT_EXTRACTOR, help_heading = HEADING)]
    pub extractor: String,
    /// Folder with the weights of learned extractors [default: where `driftless weights` puts them]
    #[arg(long, value_name = "DIR", help_heading = HEADING)]
    pub weights: Option<PathBuf>,
    /// Maximum number of features per image
    #[arg(long, value_name = "N", default_value_t = 1000, help_heading = HEADING)]
    pub max_features: usize,
    /// Image that is black (zero) where camera 0 sees the robot itself
    #[arg(long, value_name = "PNG", help_heading = HEADING)]
    pub mask: Option<PathBuf>,
}

impl FeatureArguments {
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
        open(&self.extractor, self.weights.as_deref()).context("--extractor")
    }

    /// Opens one extractor for each processor.
    ///
    /// # Errors
    /// As [`FeatureArguments::open`].
    pub fn open_several(&self) -> Result<Vec<Box<dyn FeatureExtractor>>> {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        (0..processors.min(MAX_EXTRACTORS)).map(|_| self.open()).collect()
    }

    /// Reads the mask, if there is one.
    ///
    /// # Errors
    /// The file is not an image.
    pub fn read_mask(&self) -> Result<Option<GrayImage>> {
        self.mask.as_deref().map(GrayImage::read).transpose().context("--mask")
    }
}
