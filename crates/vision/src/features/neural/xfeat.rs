//! XFeat: keypoints with descriptors of 64 numbers, from a small network.
//!
//! Differences from the published program, which keep pixels exact: images whose sides are not multiples of 32 are padded
//! on the right and at the bottom by replication instead of being resampled; descriptors are interpolated at the position
//! of the keypoint in the map of cells (`(u - 3.5) / 8`); keypoints have sub-pixel positions (parabola through the
//! logarithm of the heatmap).
//!
//! Source: Potje, Cadar, Araujo, Martins & Nascimento, CVPR 2024.

use super::dense_maps::{Descriptors, Heatmap};
use super::network::{Engine, Network, NetworkError};
use super::weights::{self, WeightsError};
use super::xfeat_network::{self, CELL, DIMENSION, INPUT, KEYPOINT_CHANNELS, MULTIPLE, OUTPUTS};
use crate::features::extractor::{ExtractError, FeatureExtractor, ImageFeatures, Keypoint, check_size};
use crate::features::quantize::quantize;
use crate::features::selection::select_best;
use crate::features::state_dict::StateDict;
use crate::features::tensor::Tensor;
use crate::features::weights::XFEAT;
use crate::image::GrayImage;
use crate::matching::Metric;
use std::path::Path;

/// Radius of non-maximum suppression in the heatmap (5 x 5), as published.
const PEAK_RADIUS: usize = 2;
/// Minimum score of a keypoint, as published.
const MIN_SCORE: f32 = 0.05;
/// Added to the variance of the image's brightness (0 to 1), as in the training.
const EPSILON: f32 = 1e-5;

/// The extractor `xfeat-1`; see the module documentation.
pub struct XfeatExtractor {
    network: Network,
}

impl XfeatExtractor {
    /// Loads the published weights from the file `xfeat.safetensors` in a folder.
    ///
    /// # Errors
    /// [`WeightsError`]: the file is missing, or its checksum is not that of the published weights.
    pub fn open(folder: &Path) -> Result<Self, WeightsError> {
        let path = folder.join(XFEAT.file);
        let bytes = weights::read_checked(&path, &XFEAT)?;
        let unusable = |error: NetworkError| WeightsError::unusable(&path, &XFEAT, error);
        let state = StateDict::read(&bytes).map_err(|error| unusable(error.into()))?;
        Self::from_weights(&state, Engine::best()).map_err(unusable)
    }

    /// Creates an extractor with other weights, for example of a network that you trained.
    ///
    /// # Errors
    /// [`NetworkError::Weights`] if a tensor is missing, not finite or has a wrong shape; [`NetworkError::Load`].
    pub fn from_weights(state: &StateDict, engine: Engine) -> Result<Self, NetworkError> {
        let onnx = xfeat_network::write(state)?;
        Ok(Self { network: Network::load(onnx, INPUT, &OUTPUTS, engine)? })
    }

    /// Keypoints (unsorted), and the map of descriptors.
    fn detect(&mut self, image: &GrayImage) -> Result<(Vec<(Keypoint, ())>, Descriptors), NetworkError> {
        let (rows, columns, numbers) = prepare(image);
        let (cell_rows, cell_columns) = (rows / CELL, columns / CELL);
        let outputs = self.network.run([1, 1, rows, columns], numbers)?;
        let [descriptors, keypoints, reliability] = <[Tensor; 3]>::try_from(outputs)
            .map_err(|outputs| NetworkError::Outputs { found: outputs.len(), needed: OUTPUTS.len() })?;
        let descriptors =
            Descriptors::from_output(OUTPUTS[0], &descriptors, DIMENSION, cell_rows, cell_columns)?;
        let heat = heat_of_pixels(&keypoints, cell_rows, cell_columns)?;
        let reliability = Heatmap::from_output(OUTPUTS[2], reliability, cell_rows, cell_columns)?;
        let peaks = heat.peaks(PEAK_RADIUS, MIN_SCORE);
        // Ignores the padding.
        let inside = peaks.into_iter().filter(|peak| peak.x < image.width() && peak.y < image.height());
        let candidates = inside.map(|peak| {
            let [u, v] = heat.refine(peak);
            let pixel = [u.min((image.width() - 1) as f32), v.min((image.height() - 1) as f32)];
            let [x, y] = pixel.map(cell_of_pixel);
            let score = peak.heat * reliability.bilinear(x, y);
            (Keypoint { pixel, scale: CELL as f32, score }, ())
        });
        Ok((candidates.collect(), descriptors))
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
        let (candidates, map) = self.detect(image).map_err(|error| ExtractError::Extractor(error.into()))?;
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
        let mut descriptors = Vec::with_capacity(keypoints.len() * DIMENSION);
        for vector in &vectors {
            quantize(vector, &mut descriptors);
        }
        Ok(ImageFeatures { keypoints, metric: Metric::CosineInt8, width: DIMENSION, descriptors })
    }
}

/// Coordinate of a pixel in the map of cells: the centre of a cell lies between its eight pixels.
fn cell_of_pixel(pixel: f32) -> f32 {
    (pixel - (CELL - 1) as f32 / 2.0) / CELL as f32
}

/// The image normalized to mean 0 and variance 1, padded to multiples of 32 rows and columns.
fn prepare(image: &GrayImage) -> (usize, usize, Vec<f32>) {
    let rows = image.height().next_multiple_of(MULTIPLE);
    let columns = image.width().next_multiple_of(MULTIPLE);
    let count = image.pixels().len() as f64;
    let (sum, squares) = image.pixels().iter().fold((0_u64, 0_u64), |(sum, squares), &pixel| {
        let pixel = u64::from(pixel);
        (sum + pixel, squares + pixel * pixel)
    });
    let mean = sum as f64 / count;
    let variance = (squares as f64 / count - mean * mean).max(0.0) / (255.0 * 255.0);
    let scale = 1.0 / (255.0 * (variance as f32 + EPSILON).sqrt());
    let offset = -(mean as f32) * scale;
    let mut numbers = Vec::with_capacity(rows * columns);
    for y in 0..rows {
        let row = image.row(y.min(image.height() - 1));
        numbers.extend(row.iter().map(|&pixel| f32::from(pixel) * scale + offset));
        let last = f32::from(row[row.len() - 1]) * scale + offset;
        numbers.resize((y + 1) * columns, last);
    }
    (rows, columns, numbers)
}

/// Keypoint probability of each pixel: softmax over the 65 channels of its cell.
fn heat_of_pixels(
    keypoints: &Tensor,
    cell_rows: usize,
    cell_columns: usize,
) -> Result<Heatmap, NetworkError> {
    let needed = vec![1, KEYPOINT_CHANNELS, cell_rows, cell_columns];
    if keypoints.shape != needed {
        let (name, found) = (OUTPUTS[1].to_owned(), keypoints.shape.clone());
        return Err(NetworkError::Shape { name, found, needed });
    }
    let (width, height, cells) = (cell_columns * CELL, cell_rows * CELL, cell_rows * cell_columns);
    let mut data = vec![0.0; width * height];
    let mut probabilities = [0.0; KEYPOINT_CHANNELS];
    for cell in 0..cells {
        let logits = keypoints.data[cell..].iter().step_by(cells);
        let largest = logits.clone().fold(f32::NEG_INFINITY, |largest, &logit| largest.max(logit));
        for (value, logit) in probabilities.iter_mut().zip(logits) {
            *value = (logit - largest).exp();
        }
        let sum: f32 = probabilities.iter().sum();
        let corner = cell / cell_columns * CELL * width + cell % cell_columns * CELL;
        for (row, values) in probabilities.as_chunks::<CELL>().0.iter().enumerate() {
            for (column, value) in values.iter().enumerate() {
                data[corner + row * width + column] = value / sum;
            }
        }
    }
    Ok(Heatmap { width, height, data })
}
