//! SIFT-like extractor without weights: difference-of-Gaussians keypoints, gradient histogram descriptors.
//!
//! | step | where |
//! |---|---|
//! | Gaussian scale space, extrema of the differences with sub-pixel and sub-level refinement, edge rejection | `scale_space` |
//! | the strongest points, distributed over the image | `spatial_distribution` |
//! | dominant gradient orientation | `orientation` |
//! | histograms of gradient directions in 4 x 4 cells, clipped, square roots | `histogram` |
//! | cosine transform, 64 signed bytes | `compress` |
//!
//! Unlike Lowe's implementation, gradients are sampled on a grid rotated and scaled with the keypoint, so that the cost does
//! not depend on the scale, and each keypoint has one orientation, that of the highest peak.
//!
//! Sources: Lowe, IJCV 2004 (US patent 6711293 expired in 2020); Arandjelovic & Zisserman, CVPR 2012 (square roots).

mod compress;
mod histogram;
mod orientation;
mod patch;
mod plane;
mod scale_space;
mod spatial_distribution;

use super::extractor::{ExtractError, FeatureExtractor, ImageFeatures, Keypoint, check_size};
use crate::image::GrayImage;
use crate::matching::Metric;
use compress::Compressor;
use histogram::HistogramBuilder;
use orientation::OrientationEstimator;
use plane::Plane;
use scale_space::{Extremum, ScaleSpace};

/// Minimum width and height of an image, pixels: a keypoint and its neighbourhood must fit.
const MIN_SIDE: usize = 24;

/// Settings of keypoint detection of [`SiftExtractor`]. The descriptors do not depend on them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SiftOptions {
    /// Whether the first octave has twice the resolution of the image: finer keypoints at three times the cost.
    pub doubled: bool,
    /// Minimum response (difference of Gaussians) as a fraction of the standard deviation of the grey levels, so that
    /// images of low contrast keep their keypoints.
    pub min_contrast: f32,
    /// Minimum response in any image, grey levels: above the quantization of the pixels.
    pub min_response: f32,
    /// Keypoints are kept up to this distance apart (pixels) while enough others remain.
    pub spacing: f32,
}

impl Default for SiftOptions {
    /// Not doubled, 1 % of the contrast, 0.25 grey levels, 8 pixels.
    fn default() -> Self {
        Self { doubled: false, min_contrast: 0.01, min_response: 0.25, spacing: 8.0 }
    }
}

/// Detects and describes SIFT-like keypoints; buffers are reused from image to image.
///
/// # Example
/// ```
/// use vision::features::classical::SiftExtractor;
/// use vision::{FeatureExtractor, GrayImage};
///
/// let checks = GrayImage::from_fn(160, 120, |x, y| if (x / 20 + y / 20) % 2 == 0 { 60 } else { 200 });
/// let features = SiftExtractor::default().extract(&checks, None, 50)?;
/// assert!(!features.keypoints.is_empty() && features.keypoints.len() <= 50);
/// assert_eq!(features.descriptors.len(), features.width * features.keypoints.len());
/// # Ok::<(), vision::ExtractError>(())
/// ```
pub struct SiftExtractor {
    options: SiftOptions,
    scale_space: ScaleSpace,
    plane: Plane,
    orientation_estimator: OrientationEstimator,
    histogram_builder: HistogramBuilder,
    compressor: Compressor,
}

impl Default for SiftExtractor {
    fn default() -> Self {
        Self::new(SiftOptions::default())
    }
}

impl SiftExtractor {
    /// Creates an extractor.
    pub fn new(options: SiftOptions) -> Self {
        Self {
            options,
            scale_space: ScaleSpace::default(),
            plane: Plane::default(),
            orientation_estimator: OrientationEstimator::new(),
            histogram_builder: HistogramBuilder::new(),
            compressor: Compressor::new(),
        }
    }

    /// Detects keypoints, best first; the scale space is updated.
    fn detect(&mut self, image: &GrayImage, mask: Option<&GrayImage>, max_features: usize) -> Vec<Extremum> {
        self.plane.copy_image(image);
        let contrast = standard_deviation(&self.plane.data);
        let threshold = (self.options.min_contrast * contrast).max(self.options.min_response);
        self.scale_space.build(&self.plane, self.options.doubled);
        let mut extrema = self.scale_space.extrema(threshold);
        extrema.retain(|extremum| is_unmasked(mask, self.scale_space.pixel_of(extremum)));
        extrema.sort_by(|a, b| b.response.total_cmp(&a.response));
        let pixels: Vec<[f32; 2]> =
            extrema.iter().map(|extremum| self.scale_space.pixel_of(extremum)).collect();
        let size = [image.width() as f32, image.height() as f32];
        let chosen =
            spatial_distribution::select_distributed(&pixels, max_features, size, self.options.spacing);
        chosen.into_iter().map(|index| extrema[index]).collect()
    }
}

impl FeatureExtractor for SiftExtractor {
    fn name(&self) -> &'static str {
        "sift-1"
    }

    fn metric(&self) -> Metric {
        Metric::CosineInt8
    }

    fn width(&self) -> usize {
        compress::WIDTH
    }

    fn extract(
        &mut self,
        image: &GrayImage,
        mask: Option<&GrayImage>,
        max_features: usize,
    ) -> Result<ImageFeatures, ExtractError> {
        check_size(image, mask, MIN_SIDE)?;
        let points = self.detect(image, mask, max_features);
        let mut keypoints = Vec::with_capacity(points.len());
        let mut descriptors = Vec::with_capacity(points.len() * self.width());
        for point in &points {
            let octave = &self.scale_space.octaves()[point.octave];
            let level = &octave.levels[point.level];
            let angle = self.orientation_estimator.orientation(level, point.position, point.sigma);
            let histogram = self.histogram_builder.histogram(level, point.position, point.sigma, angle);
            descriptors.extend(self.compressor.compress(&histogram));
            keypoints.push(Keypoint {
                pixel: self.scale_space.pixel_of(point),
                scale: point.sigma * octave.pixel_size,
                score: point.response,
            });
        }
        Ok(ImageFeatures { keypoints, metric: self.metric(), width: self.width(), descriptors })
    }
}

/// Whether the mask is non-zero at a point inside the image.
fn is_unmasked(mask: Option<&GrayImage>, pixel: [f32; 2]) -> bool {
    mask.is_none_or(|mask| {
        let [x, y] = pixel.map(|coordinate| coordinate.round() as usize);
        mask.get(x.min(mask.width() - 1), y.min(mask.height() - 1)) != 0
    })
}

/// Standard deviation; summed in double precision, which the sum of squares needs.
fn standard_deviation(data: &[f32]) -> f32 {
    let (sum, squares) = data.iter().fold((0.0, 0.0), |(sum, squares), &value| {
        let value = f64::from(value);
        (sum + value, squares + value * value)
    });
    let count = data.len() as f64;
    let mean = sum / count;
    (squares / count - mean * mean).max(0.0).sqrt() as f32
}
