//! Descriptors of the points that a COLMAP model's images see: a model states none.

use crate::error::BuildError;
use map_io::colmap::ColmapImage;
use vision::{FeatureExtractor, GrayImage};

/// A feature is a model's point where both are this near each other (px): detectors of one kind agree better.
const SAME_PX: f64 = 1.5;

/// Extracts the features of an image and takes the descriptor of the one nearest to each pixel, `None` where none is near.
///
/// # Errors
/// [`BuildError::Extraction`].
pub(super) fn describe(
    image: &ColmapImage,
    pixels: &GrayImage,
    extractor: &mut dyn FeatureExtractor,
    max_features: usize,
) -> Result<Vec<Option<Vec<u8>>>, BuildError> {
    let features = extractor
        .extract(pixels, None, max_features)
        .map_err(|source| BuildError::Extraction { image: image.name.clone(), source })?;
    let descriptor = |of: [f64; 2]| {
        let distance = |index: usize| {
            let [u, v] = features.keypoints[index].pixel.map(f64::from);
            (u - of[0]).hypot(v - of[1])
        };
        let nearest = (0..features.keypoints.len()).min_by(|a, b| distance(*a).total_cmp(&distance(*b)))?;
        let bytes = &features.descriptors[nearest * features.width..][..features.width];
        (distance(nearest) <= SAME_PX).then(|| bytes.to_vec())
    };
    Ok(image.pixels.iter().map(|seen| descriptor(seen.pixel)).collect())
}
