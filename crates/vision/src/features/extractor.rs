//! The trait of feature extractors, and what they return.

use crate::image::GrayImage;
use crate::matching::Metric;

/// A keypoint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// `[u, v]`, sub-pixel; (0, 0) is the centre of the top-left pixel.
    pub pixel: [f32; 2],
    /// Scale, pixels: standard deviation of the blur for SIFT; the factor or cell size of the network's map otherwise.
    pub scale: f32,
    /// Detection score, larger is better; comparable within one image only.
    pub score: f32,
}

/// Keypoints and descriptors of one image, best score first.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageFeatures {
    /// Keypoint `i` belongs to descriptor `i`.
    pub keypoints: Vec<Keypoint>,
    /// The metric of the descriptors.
    pub metric: Metric,
    /// Bytes per descriptor.
    pub width: usize,
    /// The descriptors one after the other.
    pub descriptors: Vec<u8>,
}

/// Why extraction failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExtractError {
    /// The image is too small for the extractor.
    #[error(
        "an image of {width} x {height} pixels is too small: at least {min_side} x {min_side} are needed"
    )]
    TooSmall {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Minimum width and height.
        min_side: usize,
    },
    /// A mask does not have the size of the image.
    #[error("the mask has {mask:?} pixels, the image {image:?}")]
    MaskSize {
        /// Columns and rows of the mask.
        mask: (usize, usize),
        /// Columns and rows of the image.
        image: (usize, usize),
    },
    /// The extractor itself failed, for example its network.
    #[error(transparent)]
    Extractor(Box<dyn std::error::Error + Send + Sync>),
}

/// Detects and describes keypoints.
///
/// # Example
/// ```
/// use vision::features::open;
/// use vision::{DescriptorView, GrayImage, MatchOptions, match_descriptors};
///
/// let image = GrayImage::from_fn(160, 120, |x, y| if (x / 20 + y / 20) % 2 == 0 { 60 } else { 200 });
/// let mut extractor = open("sift-1", None)?;
/// let features = extractor.extract(&image, None, 50)?;
/// let descriptors = DescriptorView::new(features.metric, features.width, &features.descriptors)?;
/// let options = MatchOptions { ratio: None, ..MatchOptions::for_metric(features.metric) };
/// let matches = match_descriptors(descriptors, descriptors, &options)?;
/// assert!(matches.iter().all(|found| found.distance < 1e-6));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait FeatureExtractor: Send {
    /// Name and version, for example `sift-1`: descriptors of different names cannot be compared.
    fn name(&self) -> &str;

    /// The metric of its descriptors.
    fn metric(&self) -> Metric;

    /// Bytes per descriptor.
    fn width(&self) -> usize;

    /// Extracts at most `max_features` keypoints, best first.
    ///
    /// # Arguments
    /// * `mask`: no keypoint where it is zero (for example on the robot itself); of the image's size.
    ///
    /// # Errors
    /// [`ExtractError::TooSmall`], [`ExtractError::MaskSize`], [`ExtractError::Extractor`].
    fn extract(
        &mut self,
        image: &GrayImage,
        mask: Option<&GrayImage>,
        max_features: usize,
    ) -> Result<ImageFeatures, ExtractError>;
}

/// Checks that an image has at least `min_side` columns and rows, and its mask the same size.
pub(super) fn check_size(
    image: &GrayImage,
    mask: Option<&GrayImage>,
    min_side: usize,
) -> Result<(), ExtractError> {
    let (width, height) = (image.width(), image.height());
    if width < min_side || height < min_side {
        return Err(ExtractError::TooSmall { width, height, min_side });
    }
    match mask.map(|mask| (mask.width(), mask.height())) {
        Some(mask) if mask != (width, height) => Err(ExtractError::MaskSize { mask, image: (width, height) }),
        _ => Ok(()),
    }
}
