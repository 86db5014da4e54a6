//! Features of the robot's images for the map, extracted on a thread of their own.
//!
//! Odometry runs at the rate of the camera; an extractor takes longer than that. So an image is handed over with the
//! clone of its pose, which stays in the filter, and the map is asked when the features are there.

use anyhow::{Context as _, Result, bail};
use estimator::CloneId;
use protocol::FeatureSet;
use sensors::feature_set;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use vision::features::{DEFAULT_EXTRACTOR, open};
use vision::{FeatureExtractor, GrayImage};

/// Which features of images are compared with the map's.
#[derive(clap::Args, Clone, Debug)]
pub struct FeatureArguments {
    /// Extractor of features for place recognition: sift-1, or a learned one (see `driftless weights`)
    #[arg(long, value_name = "NAME", default_value = DEFAULT_EXTRACTOR)]
    pub extractor: String,
    /// Folder with the weights of learned extractors [default: where `driftless weights` puts them]
    #[arg(long, value_name = "DIR")]
    pub weights: Option<PathBuf>,
    /// Most features an image
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub max_features: usize,
    /// Image that is black where camera 0 sees the robot itself
    #[arg(long, value_name = "PNG")]
    pub mask: Option<PathBuf>,
}

impl FeatureArguments {
    /// The extractor, ready to use.
    ///
    /// # Errors
    /// An unknown name, missing or damaged weights, no features asked for.
    pub fn open(&self) -> Result<Box<dyn FeatureExtractor>> {
        if self.max_features == 0 || self.max_features > protocol::MAX_FEATURES {
            bail!("--max-features {}: give a number from 1 to {}", self.max_features, protocol::MAX_FEATURES);
        }
        open(&self.extractor, self.weights.as_deref()).context("--extractor")
    }

    /// The mask, if there is one.
    ///
    /// # Errors
    /// A file that is no image.
    pub fn read_mask(&self) -> Result<Option<GrayImage>> {
        self.mask.as_deref().map(GrayImage::read).transpose().context("--mask")
    }
}

/// The end of one extraction.
#[derive(Clone, Debug)]
pub struct Extracted {
    /// The clone of the image's pose.
    pub clone: CloneId,
    /// Time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// The features, or why there are none, for a person.
    pub features: Result<FeatureSet, String>,
}

struct Job {
    clone: CloneId,
    stamp_ns: i64,
    image: PathBuf,
}

/// An extractor at work on a thread of its own, one image at a time. The thread ends with this value.
#[derive(Debug)]
pub struct ExtractionThread {
    jobs: Sender<Job>,
    results: Receiver<Extracted>,
    /// The image at work.
    pending: Option<(CloneId, i64)>,
}

impl ExtractionThread {
    /// Starts the thread.
    ///
    /// # Errors
    /// The system has no thread to give.
    pub fn start(
        mut extractor: Box<dyn FeatureExtractor>,
        max_features: usize,
        mask: Option<GrayImage>,
    ) -> Result<Self> {
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
        std::thread::Builder::new()
            .name("features".into())
            .spawn(work)
            .context("no thread for the feature extractor")?;
        Ok(Self { jobs, results, pending: None })
    }

    /// Whether it has no image at work.
    pub fn is_idle(&self) -> bool {
        self.pending.is_none()
    }

    /// Hands over an image; for an idle thread.
    pub fn submit(&mut self, clone: CloneId, stamp_ns: i64, image: &Path) {
        // A thread that is gone is noticed when its result is waited for.
        let _ = self.jobs.send(Job { clone, stamp_ns, image: image.to_path_buf() });
        self.pending = Some((clone, stamp_ns));
    }

    /// The features, if they are ready.
    pub fn poll(&mut self) -> Option<Extracted> {
        self.pending?;
        match self.results.try_recv() {
            Ok(extracted) => self.finish(Some(extracted)),
            Err(std::sync::mpsc::TryRecvError::Empty) => None,
            Err(std::sync::mpsc::TryRecvError::Disconnected) => self.finish(None),
        }
    }

    /// The features as soon as they are ready; for a player that stops its recording meanwhile, not for a robot.
    pub fn wait(&mut self) -> Option<Extracted> {
        self.pending?;
        let result = self.results.recv().ok();
        self.finish(result)
    }

    fn finish(&mut self, result: Option<Extracted>) -> Option<Extracted> {
        let (clone, stamp_ns) = self.pending.take()?;
        let broken =
            || Extracted { clone, stamp_ns, features: Err("the feature extractor broke down".into()) };
        Some(result.unwrap_or_else(broken))
    }
}

fn extract(
    extractor: &mut dyn FeatureExtractor,
    image: &Path,
    mask: Option<&GrayImage>,
    max_features: usize,
) -> Result<FeatureSet, String> {
    let pixels = GrayImage::read(image).map_err(|error| error.to_string())?;
    let seen = extractor
        .extract(&pixels, mask, max_features)
        .map_err(|error| format!("{}: {error}", image.display()))?;
    Ok(feature_set(extractor.name(), seen))
}
