//! Features in images that a map keeps.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::channel;

use geometry::Camera;
use map::KeptImage;
use vision::{FeatureExtractor, GrayImage, ImageFeatures};

use super::AddOptions;
use super::error::AddFeaturesError;
use crate::progress::{Progress, Stage};

/// Extracts the features of images, with all extractors at the same time.
///
/// # Arguments
/// * `images`: each with the camera of its keyframe.
///
/// # Returns
/// The features in the order of the images.
///
/// # Errors
/// That of the first image that cannot be used.
pub(super) fn extract(
    images: &[(&KeptImage, &Camera)],
    options: AddOptions<'_>,
    progress: Progress<'_>,
) -> Result<Vec<ImageFeatures>, AddFeaturesError> {
    let AddOptions { extractor, others, max_features, .. } = options;
    let (next, (outbox, inbox)) = (&AtomicUsize::new(0), channel());
    let mut extracted: Vec<Option<Result<ImageFeatures, AddFeaturesError>>> =
        images.iter().map(|_| None).collect();
    let extractors = std::iter::once(extractor).chain(others.iter_mut().map(|other| &mut **other as _));
    std::thread::scope(|scope| {
        for extractor in extractors {
            let outbox = outbox.clone();
            scope.spawn(move || {
                loop {
                    let at = next.fetch_add(1, Ordering::Relaxed);
                    let Some(&image) = images.get(at) else { break };
                    // The receiver waits for all of them.
                    let _ = outbox.send((at, of_image(image, extractor, max_features)));
                }
            });
        }
        drop(outbox);
        for (done, (at, features)) in inbox.into_iter().enumerate() {
            progress(Stage::Extraction, done + 1, images.len());
            extracted[at] = Some(features);
        }
    });
    extracted.into_iter().flatten().collect()
}

fn of_image(
    (image, camera): (&KeptImage, &Camera),
    extractor: &mut dyn FeatureExtractor,
    max_features: usize,
) -> Result<ImageFeatures, AddFeaturesError> {
    let keyframe = image.keyframe;
    let pixels =
        GrayImage::decode(&image.jpeg).map_err(|source| AddFeaturesError::Image { keyframe, source })?;
    let (found, expected) =
        ((pixels.width(), pixels.height()), (camera.width as usize, camera.height as usize));
    if found != expected {
        return Err(AddFeaturesError::ImageSize { keyframe, found, expected });
    }
    extractor
        .extract(&pixels, None, max_features)
        .map_err(|source| AddFeaturesError::Extraction { keyframe, source })
}
