//! What an image looks like at its distinctive points, for place recognition: one trait, several extractors.
//!
//! Robot and map must use the same extractor: [`FeatureExtractor::name`] goes into the map and into every query.

pub mod classical;
#[cfg(feature = "neural")]
pub mod neural;
mod open;
pub mod weights;

pub use open::{DEFAULT_EXTRACTOR, KNOWN, OpenError, open};

use crate::GrayImage;
use crate::descriptors::Metric;

/// A distinctive point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// `[u, v]`, sub-pixel; (0, 0) is the centre of the top-left pixel.
    pub pixel: [f32; 2],
    /// Size of what was described (standard deviation of the smoothing or its like), pixels.
    pub scale: f32,
    /// How distinctive it is: the larger the better, comparable within one image only.
    pub score: f32,
}

/// What an extractor saw in one image, best point first.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageFeatures {
    /// Where; point `i` belongs to descriptor `i`.
    pub keypoints: Vec<Keypoint>,
    /// How descriptors are compared.
    pub metric: Metric,
    /// Bytes a descriptor.
    pub width: usize,
    /// The descriptors one after the other.
    pub descriptors: Vec<u8>,
    /// A description of the whole image, of norm 1, where the extractor has one.
    pub global: Option<Vec<f32>>,
}

/// Why an image has no features.
#[derive(Debug, thiserror::Error)]
pub enum ExtractError {
    /// The image is smaller than the extractor can look at.
    #[error("an image of {width} x {height} pixels is too small: {least} a side are needed")]
    TooSmall {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Fewest pixels a side.
        least: usize,
    },
    /// A mask does not have the size of the image.
    #[error("the mask has {mask:?} pixels, the image {image:?}")]
    MaskSize {
        /// Columns and rows of the mask.
        mask: (usize, usize),
        /// Columns and rows of the image.
        image: (usize, usize),
    },
    /// The network failed.
    #[error("{0}")]
    Network(String),
}

/// Finds and describes the distinctive points of images.
pub trait FeatureExtractor: Send {
    /// Name and version, for example `sift-1`: descriptors of different names cannot be compared.
    fn name(&self) -> &str;

    /// How its descriptors are compared.
    fn metric(&self) -> Metric;

    /// Bytes a descriptor.
    fn width(&self) -> usize;

    /// The best points of an image, at most `max_features`, best first.
    ///
    /// # Arguments
    /// * `mask`: where it is zero no point is wanted (the robot itself); of the image's size.
    ///
    /// # Errors
    /// [`ExtractError`].
    fn extract(
        &mut self,
        image: &GrayImage,
        mask: Option<&GrayImage>,
        max_features: usize,
    ) -> Result<ImageFeatures, ExtractError>;
}

/// An image must have at least `least` pixels a side, and its mask the same size.
fn check_size(image: &GrayImage, mask: Option<&GrayImage>, least: usize) -> Result<(), ExtractError> {
    let (width, height) = (image.width(), image.height());
    if width < least || height < least {
        return Err(ExtractError::TooSmall { width, height, least });
    }
    match mask.map(|mask| (mask.width(), mask.height())) {
        Some(mask) if mask != (width, height) => Err(ExtractError::MaskSize { mask, image: (width, height) }),
        _ => Ok(()),
    }
}
