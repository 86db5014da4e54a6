//! XFeat: keypoints and 64 numbers each, from a small network.
//!
//! Differences from the published program, each of which keeps pixels exact: images whose sides are no multiples of 32
//! are continued at the right and at the bottom by their last column and row instead of being resampled; descriptors
//! are read where the keypoint is in the map of cells (`(u - 3.5) / 8`); keypoints lie between the pixels
//! (parabola through the logarithm of the heat).
//!
//! Source: Potje, Cadar, Araujo, Martins & Nascimento, CVPR 2024.

use super::best;
use super::dense::{Descriptors, Heat};
use super::network::{Engine, Network, NetworkError};
use super::quantize::quantize;
use super::state_dict::{StateDict, Tensor};
use super::weights::{self, WeightsError};
use super::xfeat_network::{self, CELL, DIMENSION, INPUT, KEYPOINT_CHANNELS, MULTIPLE, OUTPUTS};
use crate::features::check_size;
use crate::features::weights::XFEAT;
use crate::{ExtractError, FeatureExtractor, GrayImage, ImageFeatures, Keypoint, Metric};
use std::path::Path;

/// Places of the heat map that a keypoint excels on every side (5 x 5), as published.
const NEIGHBOURHOOD: usize = 2;
/// Least heat of a keypoint, as published.
const MIN_HEAT: f32 = 0.05;
/// Added to the variance of the image's brightness (0 to 1), as in the training.
const EPSILON: f32 = 1e-5;

/// See the module.
pub struct XfeatExtractor {
    network: Network,
}

impl XfeatExtractor {
    /// The extractor with the published weights, from the file `xfeat.pt` in a folder.
    ///
    /// # Errors
    /// [`WeightsError`]: no such file, or it is not the published one.
    pub fn open(folder: &Path) -> Result<Self, WeightsError> {
        let path = folder.join(XFEAT.file);
        let bytes = weights::read_checked(&path, &XFEAT)?;
        let unusable = |reason: String| WeightsError::unusable(&path, &XFEAT, reason);
        let state = StateDict::read(&bytes).map_err(|error| unusable(error.to_string()))?;
        Self::from_weights(&state, Engine::best()).map_err(|error| unusable(error.to_string()))
    }

    /// The extractor with other weights.
    ///
    /// # Errors
    /// [`NetworkError::Load`] where a tensor is missing or has another shape.
    pub fn from_weights(state: &StateDict, engine: Engine) -> Result<Self, NetworkError> {
        let onnx = xfeat_network::write(state).map_err(|error| NetworkError::Load(error.to_string()))?;
        Ok(Self { network: Network::load(onnx, INPUT, &OUTPUTS, engine)? })
    }

    /// Keypoints in no order, and the map of descriptors.
    fn detect(&mut self, image: &GrayImage) -> Result<(Vec<(Keypoint, ())>, Descriptors), NetworkError> {
        let (rows, columns, numbers) = prepare(image);
        let (cell_rows, cell_columns) = (rows / CELL, columns / CELL);
        let outputs = self.network.run([1, 1, rows, columns], numbers)?;
        let [descriptors, keypoints, reliability] = <[Tensor; 3]>::try_from(outputs)
            .map_err(|outputs| NetworkError::Run(format!("{} outputs", outputs.len())))?;
        let descriptors =
            Descriptors::from_output(OUTPUTS[0], &descriptors, DIMENSION, cell_rows, cell_columns)?;
        let heat = heat_of_pixels(&keypoints, cell_rows, cell_columns)?;
        let reliability = Heat::from_output(OUTPUTS[2], reliability, cell_rows, cell_columns)?;
        let peaks = heat.peaks(NEIGHBOURHOOD, MIN_HEAT);
        // Beyond the image is only its continuation.
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

    /// Keypoints with descriptors of norm 1, before these become bytes; best first.
    ///
    /// # Errors
    /// [`ExtractError`].
    pub fn extract_floats(
        &mut self,
        image: &GrayImage,
        mask: Option<&GrayImage>,
        max_features: usize,
    ) -> Result<(Vec<Keypoint>, Vec<[f32; DIMENSION]>), ExtractError> {
        check_size(image, mask, MULTIPLE)?;
        let (candidates, map) =
            self.detect(image).map_err(|error| ExtractError::Network(error.to_string()))?;
        let (keypoints, _) = best(candidates, image, mask, max_features);
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
        Ok(ImageFeatures {
            keypoints,
            metric: Metric::CosineInt8,
            width: DIMENSION,
            descriptors,
            global: None,
        })
    }
}

/// Where a pixel lies in the map of cells: the centre of the first cell is between its eight pixels.
fn cell_of_pixel(pixel: f32) -> f32 {
    (pixel - (CELL - 1) as f32 / 2.0) / CELL as f32
}

/// The image with mean 0 and variance 1, continued to rows and columns that are multiples of 32.
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

/// How likely each pixel is a keypoint: the softmax of the 65 numbers of its cell.
fn heat_of_pixels(keypoints: &Tensor, cell_rows: usize, cell_columns: usize) -> Result<Heat, NetworkError> {
    let needed = vec![1, KEYPOINT_CHANNELS, cell_rows, cell_columns];
    if keypoints.shape != needed {
        let (name, found) = (OUTPUTS[1].to_owned(), keypoints.shape.clone());
        return Err(NetworkError::Shape { name, found, needed });
    }
    let (width, height, cells) = (cell_columns * CELL, cell_rows * CELL, cell_rows * cell_columns);
    let mut data = vec![0.0; width * height];
    let mut likely = [0.0; KEYPOINT_CHANNELS];
    for cell in 0..cells {
        let logits = keypoints.data[cell..].iter().step_by(cells);
        let largest = logits.clone().fold(f32::NEG_INFINITY, |largest, &logit| largest.max(logit));
        for (value, logit) in likely.iter_mut().zip(logits) {
            *value = (logit - largest).exp();
        }
        let sum: f32 = likely.iter().sum();
        let corner = cell / cell_columns * CELL * width + cell % cell_columns * CELL;
        for (row, values) in likely.as_chunks::<CELL>().0.iter().enumerate() {
            for (column, value) in values.iter().enumerate() {
                data[corner + row * width + column] = value / sum;
            }
        }
    }
    Ok(Heat { width, height, data })
}
