//! Feature extraction for map queries, on a thread of its own.
//!
//! Odometry runs at the rate of the camera; an extractor takes longer than one period. So an image is submitted with
//! the id of its pose clone, which stays in the filter, and the map is queried when the features are ready.

use super::query_cameras::QueryImage;
use protocol::FeatureSet;
use sensors::ImageData;
use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, Sender, channel};
use vision::feature_set;
use vision::features::ExtractError;
use vision::{FeatureExtractor, GrayImage, ImageError};

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
    /// The image.
    pub image: QueryImage,
    /// Time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// The features, or why there are none.
    pub features: Result<FeatureSet, ExtractionError>,
}

struct Job {
    image: QueryImage,
    stamp_ns: i64,
    data: ImageData,
}

/// An extractor on a thread of its own, one image after the other. The thread ends when this value is dropped.
#[derive(Debug)]
pub struct ExtractionThread {
    jobs: Sender<Job>,
    results: Receiver<Extracted>,
    /// The images that are submitted and not extracted, the oldest first.
    pending: VecDeque<(QueryImage, i64)>,
}

impl ExtractionThread {
    /// Starts the thread.
    ///
    /// # Arguments
    /// * `masks`: of the cameras in their order; no features where they are zero.
    ///
    /// # Errors
    /// The operating system refuses a thread.
    pub fn start(
        mut extractor: Box<dyn FeatureExtractor>,
        max_features: usize,
        masks: Vec<Option<GrayImage>>,
    ) -> std::io::Result<Self> {
        let (jobs, inbox) = channel::<Job>();
        let (outbox, results) = channel();
        let work = move || {
            while let Ok(job) = inbox.recv() {
                let mask = masks.get(job.image.camera).and_then(Option::as_ref);
                let features = extract(extractor.as_mut(), &job.data, mask, max_features);
                if outbox.send(Extracted { image: job.image, stamp_ns: job.stamp_ns, features }).is_err() {
                    break;
                }
            }
        };
        std::thread::Builder::new().name("features".into()).spawn(work)?;
        Ok(Self { jobs, results, pending: VecDeque::new() })
    }

    /// Whether all submitted images are extracted.
    pub fn is_idle(&self) -> bool {
        self.pending.is_empty()
    }

    /// Submits an image.
    pub fn submit(&mut self, image: QueryImage, stamp_ns: i64, data: ImageData) {
        // A thread that has ended is reported as the result of this image.
        let _ = self.jobs.send(Job { image, stamp_ns, data });
        self.pending.push_back((image, stamp_ns));
    }

    /// The next result, if it is ready.
    pub fn poll(&mut self) -> Option<Extracted> {
        if self.is_idle() {
            return None;
        }
        match self.results.try_recv() {
            Ok(extracted) => self.finish(Some(extracted)),
            Err(std::sync::mpsc::TryRecvError::Empty) => None,
            Err(std::sync::mpsc::TryRecvError::Disconnected) => self.finish(None),
        }
    }

    /// Waits for the next result; `None` when idle. For recordings that are played as fast as possible, not for a robot.
    pub fn wait(&mut self) -> Option<Extracted> {
        if self.is_idle() {
            return None;
        }
        let result = self.results.recv().ok();
        self.finish(result)
    }

    fn finish(&mut self, result: Option<Extracted>) -> Option<Extracted> {
        let (image, stamp_ns) = self.pending.pop_front()?;
        let ended = || Extracted { image, stamp_ns, features: Err(ExtractionError::ThreadEnded) };
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
