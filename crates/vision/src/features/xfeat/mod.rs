//! XFeat: keypoints with descriptors of 64 numbers, from a small network.
//!
//! Differences from the published program, which keep pixels exact: images whose sides are not multiples of 32 are padded
//! on the right and at the bottom by replication instead of being resampled; descriptors are interpolated at the position
//! of the keypoint in the map of cells (`(u - 3.5) / 8`); keypoints have sub-pixel positions (parabola through the
//! logarithm of the heatmap).
//!
//! An image of 736 x 480 pixels takes 30 ms in one thread with AVX2 (`rten` 0.27 took 39 ms, ONNX Runtime 1.31 with AVX-512 20 ms).
//!
//! # Match quality
//! `images/v1_01_keyframes` of `target/data`: the left images of even number (1000 features) against the landmarks
//! of the odd ones (1500 features, 656 triangulated from the stereo pair). Correct: within 5 px of the reprojection of
//! the landmark by the true poses, for the 194 pairs within 1 m and 35 degrees. Elsewhere: pairs more than 2 m or 100
//! degrees apart, all wrong. Mutual matches per pair:
//!
//! | max_distance | ratio | correct, signed bytes (`f32`) | wrong | elsewhere |
//! |---|---|---|---|---|
//! | 0.1 | none | 148.9 (148.9) | 66.7 | 4.1 |
//! | 0.2 | none | 184.3 (184.4) | 134.1 | 65.8 |
//! | 0.3 | none | 186.3 (186.4) | 152.7 | 168.8 |
//! | 0.3 | 0.9 | 174.3 (174.3) | 117.6 | 76.0 |
//! | 0.3 | 0.8 | 157.4 (157.3) | 87.8 | 28.7 |
//! | **0.2** | **0.8** | **157.0 (156.9)** | **85.9** | **22.2** |
//! | 0.15 | 0.8 | 153.3 (153.3) | 77.5 | 11.1 |
//! | 0.3 | 0.64 | 120.4 (120.5) | 50.8 | 5.7 |
//!
//! Quantization has no measurable cost. Distances of correct matches: median 0.057, 90 % below 0.13, 99 % below
//! 0.20. The ratio test matters more than the distance.
//!
//! Images of even number localized against that map (the four keyframes with most matches, RANSAC at 3 px): number of 49
//! within 5 cm and 1 degree, and, with degraded images, within 10 cm and 2 degrees. Differences of two are not
//! significant:
//!
//! | map, query, max_distance (ratio 0.8) | original | gamma 2.5 | blur of 2 px | 0.4 of the brightness, noise of 8 |
//! |---|---|---|---|---|
//! | 2000, 1000, 0.2 | 47 | 48 | 49 | 47 |
//! | 2000, 1000, 0.3 | 47 | 48 | 49 | 45 |
//! | 1500, 1000, 0.2 | 46 | 47 | 49 | 46 |
//! | 1500, 1000, 0.3 | 48 | 47 | 49 | 44 |
//! | 1000, 500, 0.3 | 42 | 47 | 47 | 42 |
//!
//! Keypoint refinement (1500, 1000, 0.3): parabola 48, centre of mass of 3 x 3 pixels 47, of 5 x 5 pixels 45, whole
//! pixels 45. The median error is 1 cm and 0.2 degrees.
//!
//! Source: Potje, Cadar, Araujo, Martins & Nascimento, CVPR 2024.

mod descriptors;
mod network;

use super::heatmap::{Heatmap, log};
use super::layers::Map;
use super::layers::reader::EPSILON;
use super::quantize::quantized;
use super::selection::select_best;
use super::state_dict::{StateDict, StateDictError};
use super::weights::{self, WeightsError, XFEAT};
use crate::features::extractor::{ExtractError, FeatureExtractor, ImageFeatures, Keypoint, check_size};
use crate::image::GrayImage;
use crate::matching::Metric;
use descriptors::Descriptors;
pub use network::XfeatNetwork;
use network::{CELL, DIMENSION, KEYPOINT_CHANNELS, MULTIPLE};
use std::path::Path;

/// Radius of non-maximum suppression in the heatmap (5 x 5), as published.
const PEAK_RADIUS: usize = 2;
/// Minimum score of a keypoint, as published.
const MIN_SCORE: f32 = 0.05;

/// The extractor `xfeat-1`; see the module documentation.
pub struct XfeatExtractor {
    network: XfeatNetwork,
    image: Map,
}

impl XfeatExtractor {
    /// Loads the published weights from the file `xfeat.safetensors` in a folder.
    ///
    /// # Errors
    /// [`WeightsError`]: the file is missing, or its checksum is not that of the published weights.
    pub fn open(folder: &Path) -> Result<Self, WeightsError> {
        weights::open(folder, &XFEAT, Self::from_weights)
    }

    /// Creates an extractor with other weights, for example of a network that you trained.
    ///
    /// # Errors
    /// [`StateDictError`] if a tensor is missing, not finite or has a wrong shape.
    pub fn from_weights(state: &StateDict) -> Result<Self, StateDictError> {
        Ok(Self { network: XfeatNetwork::new(state)?, image: Map::default() })
    }

    /// Keypoints (unsorted), and the map of descriptors.
    fn detect(&mut self, image: &GrayImage) -> (Vec<(Keypoint, ())>, Descriptors) {
        prepare(image, &mut self.image);
        let [descriptors, keypoints, reliability] = self.network.run(&self.image);
        let descriptors = Descriptors::of_map(descriptors);
        let heat = heat_of_pixels(keypoints);
        let reliability = Heatmap::of_channel(reliability, 0);
        let peaks = heat.peaks::<PEAK_RADIUS>(MIN_SCORE);
        // Ignores the padding.
        let inside = peaks.into_iter().filter(|peak| peak.x < image.width() && peak.y < image.height());
        let candidates = inside.map(|peak| {
            let [u, v] = heat.refine(peak, log);
            let pixel = [u.min((image.width() - 1) as f32), v.min((image.height() - 1) as f32)];
            let [x, y] = pixel.map(cell_of_pixel);
            let score = peak.heat * reliability.bilinear(x, y);
            (Keypoint { pixel, scale: CELL as f32, score }, ())
        });
        (candidates.collect(), descriptors)
    }

    /// Extracts keypoints with `f32` descriptors of norm 1, before quantization; best first.
    ///
    /// # Errors
    /// As [`FeatureExtractor::extract`].
    pub fn extract_floats(
        &mut self,
        image: &GrayImage,
        mask: Option<&GrayImage>,
        max_features: usize,
    ) -> Result<(Vec<Keypoint>, Vec<[f32; DIMENSION]>), ExtractError> {
        check_size(image, mask, MULTIPLE)?;
        let (candidates, map) = self.detect(image);
        let (keypoints, _) = select_best(candidates, image, mask, max_features);
        let descriptors = keypoints.iter().map(|keypoint| {
            let [x, y] = keypoint.pixel.map(cell_of_pixel);
            let mut vector = [0.0; DIMENSION];
            map.bicubic(x, y, &mut vector);
            vector
        });
        let descriptors = descriptors.collect();
        Ok((keypoints, descriptors))
    }
}

impl FeatureExtractor for XfeatExtractor {
    fn name(&self) -> &str {
        XFEAT.name
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
        let (keypoints, vectors) = self.extract_floats(image, mask, max_features)?;
        Ok(quantized(keypoints, DIMENSION, vectors.iter().map(<[f32; DIMENSION]>::as_slice)))
    }
}

/// Coordinate of a pixel in the map of cells: the centre of a cell lies between its eight pixels.
fn cell_of_pixel(pixel: f32) -> f32 {
    (pixel - (CELL - 1) as f32 / 2.0) / CELL as f32
}

/// The image normalized to mean 0 and variance 1, padded to multiples of 32 rows and columns.
fn prepare(image: &GrayImage, map: &mut Map) {
    let rows = image.height().next_multiple_of(MULTIPLE);
    let columns = image.width().next_multiple_of(MULTIPLE);
    map.reshape(1, rows, columns);
    let count = image.pixels().len() as f64;
    let (sum, squares) = image.pixels().iter().fold((0_u64, 0_u64), |(sum, squares), &pixel| {
        let pixel = u64::from(pixel);
        (sum + pixel, squares + pixel * pixel)
    });
    let mean = sum as f64 / count;
    let variance = (squares as f64 / count - mean * mean).max(0.0) / (255.0 * 255.0);
    let scale = 1.0 / (255.0 * (variance as f32 + EPSILON).sqrt());
    let offset = -(mean as f32) * scale;
    for y in 0..rows {
        let pixels = image.row(y.min(image.height() - 1));
        let (own, padding) = map.row_mut(0, y).split_at_mut(pixels.len());
        for (number, &pixel) in own.iter_mut().zip(pixels) {
            *number = f32::from(pixel) * scale + offset;
        }
        padding.fill(own[own.len() - 1]);
    }
}

/// Keypoint probability of each pixel: softmax over the 65 channels of its cell.
fn heat_of_pixels(keypoints: &Map) -> Heatmap {
    let (width, height) = (keypoints.columns() * CELL, keypoints.rows() * CELL);
    let mut data = vec![0.0; width * height];
    let mut probabilities = [0.0; KEYPOINT_CHANNELS];
    for (y, rows) in data.chunks_exact_mut(CELL * width).enumerate() {
        for x in 0..keypoints.columns() {
            let logits = (0..KEYPOINT_CHANNELS).map(|channel| keypoints.row(channel, y)[x]);
            let largest = logits.clone().fold(f32::NEG_INFINITY, f32::max);
            for (value, logit) in probabilities.iter_mut().zip(logits) {
                *value = (logit - largest).exp();
            }
            let sum: f32 = probabilities.iter().sum();
            for (row, values) in rows.chunks_exact_mut(width).zip(probabilities.as_chunks::<CELL>().0) {
                for (heat, value) in row[x * CELL..].iter_mut().zip(values) {
                    *heat = value / sum;
                }
            }
        }
    }
    Heatmap { width, height, data }
}
