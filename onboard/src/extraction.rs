//! Feature extraction for map queries, on a thread of its own.
//!
//! Odometry runs at the rate of the camera; an extractor takes longer than one period. So an image is submitted with
//! the id of its pose clone, which stays in the filter, and the map is queried when the features are ready.

use anyhow::{Context as _, Result, bail};
use estimator::CloneId;
use protocol::FeatureSet;
use sensors::ImageData;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, Sender, channel};
use vision::feature_set;
use vision::features::{DEFAULT_EXTRACTOR, ExtractError, open};
use vision::{FeatureExtractor, GrayImage, ImageError};

/// Heading of these switches in `--help`.
const HEADING: &str = "Image features";

/// Most extractors at once: that many images, and a little more, are in memory.
const MAX_EXTRACTORS: usize = 8;

/// Which features of images are matched with the map's.
#[derive(clap::Args, Clone, Debug)]
pub struct FeatureArguments {
    /// Extractor of features for place recognition: sift-1, or a learned one (see `driftless weights`)
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

    /// Opens one extractor for each processor; only one where the extractor is a network, which uses all processors itself.
    ///
    /// # Errors
    /// As [`FeatureArguments::open`].
    pub fn open_several(&self) -> Result<Vec<Box<dyn FeatureExtractor>>> {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let count = if self.extractor == DEFAULT_EXTRACTOR { processors.min(MAX_EXTRACTORS) } else { 1 };
        (0..count).map(|_| self.open()).collect()
    }

    /// Reads the mask, if there is one.
    ///
    /// # Errors
    /// The file is not an image.
    pub fn read_mask(&self) -> Result<Option<GrayImage>> {
        self.mask.as_deref().map(GrayImage::read).transpose().context("--mask")
    }
}

/// Why an image has no features.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExtractionError {
    /// The image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The extractor failed.
    #[error("{image}: {source}")]
    Extractor {
        /// The image.
        image: String,
        /// The error of the extractor.
        source: ExtractError,
    },
    /// The thread has ended, because the extractor panicked.
    #[error("the thread of the feature extractor has ended; see the panic message above")]
    ThreadEnded,
}

/// The result of one extraction.
#[derive(Debug)]
pub struct Extracted {
    /// The clone of the image's pose.
    pub clone: CloneId,
    /// Time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// The features, or why there are none.
    pub features: Result<FeatureSet, ExtractionError>,
}

struct Job {
    clone: CloneId,
    stamp_ns: i64,
    image: ImageData,
}

/// An extractor on a thread of its own, one image at a time. The thread ends when this value is dropped.
#[derive(Debug)]
pub struct ExtractionThread {
    jobs: Sender<Job>,
    results: Receiver<Extracted>,
    /// The image that is processed now.
    pending: Option<(CloneId, i64)>,
}

impl ExtractionThread {
    /// Starts the thread.
    ///
    /// # Errors
    /// The operating system refuses a thread.
    pub fn start(
        mut extractor: Box<dyn FeatureExtractor>,
        max_features: usize,
        mask: Option<GrayImage>,
    ) -> std::io::Result<Self> {
        let (jobs, inbox) = channel::<Job>();
        let (outbox, results) = channel();
        let work = move || {
            while let Ok(job) = inbox.recv() {
                let features = extract(extractor.as_mut(), &job.image, mask.as_ref(), max_features);
                if outbox.send(Extracted { clone: job.clone, stamp_ns: job.stamp_ns, features }).is_err() {
                    break;
                }
            }
        };
        std::thread::Builder::new().name("features".into()).spawn(work)?;
        Ok(Self { jobs, results, pending: None })
    }

    /// Whether no image is being processed.
    pub fn is_idle(&self) -> bool {
        self.pending.is_none()
    }

    /// Submits an image. The thread must be idle.
    pub fn submit(&mut self, clone: CloneId, stamp_ns: i64, image: ImageData) {
        // A thread that has ended is reported as the result of this image.
        let _ = self.jobs.send(Job { clone, stamp_ns, image });
        self.pending = Some((clone, stamp_ns));
    }

    /// The result, if it is ready.
    pub fn poll(&mut self) -> Option<Extracted> {
        self.pending?;
        match self.results.try_recv() {
            Ok(extracted) => self.finish(Some(extracted)),
            Err(std::sync::mpsc::TryRecvError::Empty) => None,
            Err(std::sync::mpsc::TryRecvError::Disconnected) => self.finish(None),
        }
    }

    /// Waits for the result; for recordings that are played as fast as possible, not for a robot.
    pub fn wait(&mut self) -> Option<Extracted> {
        self.pending?;
        let result = self.results.recv().ok();
        self.finish(result)
    }

    fn finish(&mut self, result: Option<Extracted>) -> Option<Extracted> {
        let (clone, stamp_ns) = self.pending.take()?;
        let ended = || Extracted { clone, stamp_ns, features: Err(ExtractionError::ThreadEnded) };
        Some(result.unwrap_or_else(ended))
    }
}

fn extract(
    extractor: &mut dyn FeatureExtractor,
    image: &ImageData,
    mask: Option<&GrayImage>,
    max_features: usize,
) -> Result<FeatureSet, ExtractionError> {
    let features = extractor
        .extract(&*image.read()?, mask, max_features)
        .map_err(|source| ExtractionError::Extractor { image: image.to_string(), source })?;
    Ok(feature_set(extractor.name(), features))
}
