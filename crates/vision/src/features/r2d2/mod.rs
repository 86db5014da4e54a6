//! R2D2: repeatable and reliable keypoints with descriptors of 128 numbers.
//!
//! The published weights are for non-commercial use and not distributed here. To use them, give the file of the published program
//! (github.com/naver/r2d2) to `driftless weights r2d2 --from r2d2_WASF_N16.pt`.
//!
//! An image of 736 x 480 pixels takes 5.7 s in one thread with AVX2 (`rten` 0.27 took 9.4 s) and 400 MB.
//!
//! Source: Revaud, Weinzaepfel, De Souza & Humenberger, "R2D2: Repeatable and Reliable Detector and Descriptor",
//! NeurIPS 2019.

mod network;

use super::heatmap::{Heatmap, log};
use super::layers::Map;
use super::quantize::quantized;
use super::selection::select_best;
use super::state_dict::{StateDict, StateDictError};
use super::weights::{self, R2D2, WeightsError};
use crate::features::extractor::{ExtractError, FeatureExtractor, ImageFeatures, Keypoint, check_size};
use crate::image::GrayImage;
use crate::matching::Metric;
use crate::matching::descriptors::normalize;
use network::DIMENSION;
pub use network::R2d2Network;
use std::path::Path;

/// Mean of red, green and blue (0 to 1) in the training images.
const COLOUR_MEAN: [f32; 3] = [0.485, 0.456, 0.406];
/// Standard deviation of red, green and blue (0 to 1) in the training images.
const COLOUR_DEVIATION: [f32; 3] = [0.229, 0.224, 0.225];
/// Radius of non-maximum suppression (3 x 3), as published.
const PEAK_RADIUS: usize = 1;
/// Minimum repeatability and reliability of a keypoint, as published.
const MIN_SCORE: f32 = 0.7;
/// Minimum width and height of an image at any scale, pixels.
const MIN_SIDE: usize = 32;
/// Image scales. The published program has eight, down to a quarter; three with a ratio of sqrt(2) take a fifth of the
/// time.
const SCALES: [f32; 3] = [1.0, std::f32::consts::FRAC_1_SQRT_2, 0.5];

/// The extractor `r2d2-1`; see the module documentation.
pub struct R2d2Extractor {
    network: R2d2Network,
    image: Map,
    scales: Vec<f32>,
}

impl R2d2Extractor {
    /// Loads the weights from the file `r2d2-1.safetensors` in a folder.
    ///
    /// # Errors
    /// [`WeightsError`]: the file is missing, damaged or of a different network.
    pub fn open(folder: &Path) -> Result<Self, WeightsError> {
        weights::open(folder, &R2D2, Self::from_weights)
    }

    /// Creates an extractor.
    ///
    /// # Errors
    /// [`StateDictError`] if a tensor is missing, not finite or has a wrong shape.
    pub fn from_weights(state: &StateDict) -> Result<Self, StateDictError> {
        Ok(Self { network: R2d2Network::new(state)?, image: Map::default(), scales: SCALES.to_vec() })
    }

    /// Sets the image scales, as fractions of the full resolution.
    #[must_use]
    pub fn with_scales(mut self, scales: &[f32]) -> Self {
        self.scales = scales.to_vec();
        self
    }

    /// Keypoints and descriptors at one scale.
    fn extract_scale(&mut self, image: &GrayImage) -> Vec<(Keypoint, [f32; DIMENSION])> {
        prepare(image, &mut self.image);
        let [descriptors, confidences] = self.network.run(&self.image);
        let repeatability = Heatmap::of_channel(confidences, 1);
        let mut candidates = Vec::new();
        for peak in repeatability.peaks::<PEAK_RADIUS>(MIN_SCORE) {
            let reliable = confidences.row(0, peak.y)[peak.x];
            if reliable > MIN_SCORE {
                let mut vector = std::array::from_fn(|channel| descriptors.row(channel, peak.y)[peak.x]);
                normalize(&mut vector);
                let pixel = repeatability.refine(peak, log);
                candidates.push((Keypoint { pixel, scale: 1.0, score: peak.heat * reliable }, vector));
            }
        }
        candidates
    }
}

impl FeatureExtractor for R2d2Extractor {
    fn name(&self) -> &str {
        R2D2.name
    }

    fn metric(&self) -> Metric {
        Metric::CosineInt8
    }

    fn width(&self) -> usize {
        DIMENSION
    }

    fn extract(
        &mut self,
        image: &GrayImage,
        mask: Option<&GrayImage>,
        max_features: usize,
    ) -> Result<ImageFeatures, ExtractError> {
        check_size(image, mask, MIN_SIDE)?;
        let mut candidates = Vec::new();
        for scale in self.scales.clone() {
            let size = |side: usize| (side as f32 * scale).round() as usize;
            let (width, height) = (size(image.width()), size(image.height()));
            if width < MIN_SIDE || height < MIN_SIDE {
                continue;
            }
            let found = if (width, height) == (image.width(), image.height()) {
                self.extract_scale(image)
            } else {
                self.extract_scale(&shrink(image, width, height))
            };
            let (fx, fy) = (image.width() as f32 / width as f32, image.height() as f32 / height as f32);
            candidates.extend(found.into_iter().map(|(mut keypoint, vector)| {
                let [u, v] = keypoint.pixel;
                keypoint.pixel = [(u + 0.5) * fx - 0.5, (v + 0.5) * fy - 0.5];
                keypoint.scale = fx;
                (keypoint, vector)
            }));
        }
        let (keypoints, vectors) = select_best(candidates, image, mask, max_features);
        Ok(quantized(keypoints, DIMENSION, vectors.iter().map(<[f32; DIMENSION]>::as_slice)))
    }
}

/// The image as three equal channels, normalized by mean and standard deviation of the training images.
fn prepare(image: &GrayImage, map: &mut Map) {
    map.reshape(3, image.height(), image.width());
    for (channel, (mean, deviation)) in COLOUR_MEAN.iter().zip(COLOUR_DEVIATION).enumerate() {
        for y in 0..image.height() {
            for (number, &pixel) in map.row_mut(channel, y).iter_mut().zip(image.row(y)) {
                *number = (f32::from(pixel) / 255.0 - mean) / deviation;
            }
        }
    }
}

/// Area downsampling: each pixel is the mean of the area that it covers.
fn shrink(image: &GrayImage, width: usize, height: usize) -> GrayImage {
    let columns = coverage(image.width(), width);
    let rows = coverage(image.height(), height);
    GrayImage::from_fn(width, height, |x, y| {
        let mut sum = 0.0;
        for &(row, row_weight) in &rows[y] {
            let line = image.row(row);
            let of_row: f32 =
                columns[x].iter().map(|&(column, weight)| weight * f32::from(line[column])).sum();
            sum += row_weight * of_row;
        }
        sum.round() as u8
    })
}

/// For each of `to` equal parts of `from` pixels, the pixels that it covers and their weights.
fn coverage(from: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let step = from as f32 / to as f32;
    let part = |index: usize| {
        let (start, end) = (index as f32 * step, (index as f32 + 1.0) * step);
        let pixels = start as usize..(end.ceil() as usize).min(from);
        pixels
            .map(|pixel| {
                let covered = end.min(pixel as f32 + 1.0) - start.max(pixel as f32);
                (pixel, covered.max(0.0) / step)
            })
            .collect()
    };
    (0..to).map(part).collect()
}
