//! The extractor that needs no weights: points of the difference of Gaussians, described by gradient histograms (SIFT).
//!
//! | step | where |
//! |---|---|
//! | blur at growing scale, extrema of the differences refined to fractions of a pixel and of a level, no edges | `scale_space` |
//! | the best points, spread over the image | `spread` |
//! | the direction of the gradients | `orientation` |
//! | histograms of gradient directions in 4 x 4 cells, clipped, square roots | `histogram` |
//! | cosine transform, 64 signed bytes | `compress` |
//!
//! Unlike Lowe's program, gradients are taken on a grid turned and scaled with the point, so that a point costs the same
//! at every scale, and a point has one feature: the direction of its highest peak.
//!
//! TABLES
//!
//! Sources: Lowe, IJCV 2004 (US patent 6711293 expired in 2020); Arandjelovic & Zisserman, CVPR 2012 (square roots).

mod compress;
mod histogram;
mod orientation;
mod patch;
mod plane;
mod scale_space;
mod spread;

use super::{ExtractError, FeatureExtractor, ImageFeatures, Keypoint, check_size};
use crate::GrayImage;
use crate::descriptors::Metric;
use compress::Compressor;
use histogram::Describer;
use orientation::Orienter;
use plane::Plane;
use scale_space::{Extremum, ScaleSpace};

/// Fewest pixels a side of an image: less has no room for a point and what surrounds it.
const LEAST_SIDE: usize = 24;

/// How [`SiftExtractor`] looks for points. The descriptors do not depend on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SiftOptions {
    /// Whether to look for points in the image at twice its size too: finer ones, at three times the cost.
    pub doubled: bool,
    /// Weakest response of a point (difference of Gaussians) as a part of the standard deviation of the image's grey
    /// levels, so that a darker or hazier image keeps its points.
    pub least_contrast: f32,
    /// Weakest response of a point in any image, grey levels: below lies the rounding of its pixels.
    pub least_response: f32,
    /// Up to this distance (pixels) points are kept apart while enough others are left.
    pub spacing: f32,
}

impl Default for SiftOptions {
    /// Not doubled, 1 % of the contrast, 0.25 grey levels, 8 pixels; the module says what they were tuned on.
    fn default() -> Self {
        Self { doubled: false, least_contrast: 0.01, least_response: 0.25, spacing: 8.0 }
    }
}

/// Finds and describes points; keeps its buffers from image to image.
///
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
    orienter: Orienter,
    describer: Describer,
    compressor: Compressor,
}

impl Default for SiftExtractor {
    fn default() -> Self {
        Self::new(SiftOptions::default())
    }
}

impl SiftExtractor {
    /// An extractor; it has no weights to load.
    pub fn new(options: SiftOptions) -> Self {
        Self {
            options,
            scale_space: ScaleSpace::default(),
            plane: Plane::default(),
            orienter: Orienter::new(),
            describer: Describer::new(),
            compressor: Compressor::new(),
        }
    }

    /// The points to describe, best first, and the scale space they are in.
    fn detect(&mut self, image: &GrayImage, mask: Option<&GrayImage>, max_features: usize) -> Vec<Extremum> {
        self.plane.copy_image(image);
        let contrast = standard_deviation(&self.plane.data);
        let threshold = (self.options.least_contrast * contrast).max(self.options.least_response);
        self.scale_space.build(&self.plane, self.options.doubled);
        let mut extrema = self.scale_space.extrema(threshold);
        extrema.retain(|extremum| is_wanted(mask, self.scale_space.pixel_of(extremum)));
        extrema.sort_by(|a, b| b.response.total_cmp(&a.response));
        let pixels: Vec<[f32; 2]> =
            extrema.iter().map(|extremum| self.scale_space.pixel_of(extremum)).collect();
        let size = [image.width() as f32, image.height() as f32];
        let chosen = spread::spread(&pixels, max_features, size, self.options.spacing);
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
        check_size(image, mask, LEAST_SIDE)?;
        let points = self.detect(image, mask, max_features);
        let mut keypoints = Vec::with_capacity(points.len());
        let mut descriptors = Vec::with_capacity(points.len() * self.width());
        for point in &points {
            let octave = &self.scale_space.octaves()[point.octave];
            let level = &octave.levels[point.level];
            let angle = self.orienter.orientation(level, point.position, point.sigma);
            let histogram = self.describer.histogram(level, point.position, point.sigma, angle);
            descriptors.extend(self.compressor.compress(&histogram));
            keypoints.push(Keypoint {
                pixel: self.scale_space.pixel_of(point),
                scale: point.sigma * octave.pixel_size,
                score: point.response,
            });
        }
        Ok(ImageFeatures { keypoints, metric: self.metric(), width: self.width(), descriptors, global: None })
    }
}

/// Whether the mask lets a point be; points lie within the image.
fn is_wanted(mask: Option<&GrayImage>, pixel: [f32; 2]) -> bool {
    mask.is_none_or(|mask| {
        let [x, y] = pixel.map(|coordinate| coordinate.round() as usize);
        mask.get(x.min(mask.width() - 1), y.min(mask.height() - 1)) != 0
    })
}

/// Standard deviation; summed in double precision, for a sum of squares of grey levels needs it.
fn standard_deviation(data: &[f32]) -> f32 {
    let (sum, squares) = data.iter().fold((0.0, 0.0), |(sum, squares), &value| {
        let value = f64::from(value);
        (sum + value, squares + value * value)
    });
    let count = data.len() as f64;
    let mean = sum / count;
    (squares / count - mean * mean).max(0.0).sqrt() as f32
}
