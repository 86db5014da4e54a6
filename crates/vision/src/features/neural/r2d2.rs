//! R2D2: repeatable and reliable keypoints with descriptors of 128 numbers.
//!
//! The published weights are for non-commercial use and not distributed here. To use them, convert them once with PyTorch
//! in the folder of the published program (github.com/naver/r2d2):
//!
//! ```text
//! python3 - <<'END'
//! import torch
//! from extract import load_network
//! class Maps(torch.nn.Module):
//!     def __init__(self, net):
//!         super().__init__(); self.net = net
//!     def forward(self, image):
//!         maps = self.net(imgs=[image])
//!         return tuple(maps[name][0] for name in ('descriptors', 'repeatability', 'reliability'))
//! names = ['descriptors', 'repeatability', 'reliability']
//! torch.onnx.export(Maps(load_network('models/r2d2_WASF_N16.pt').eval()), torch.zeros(1, 3, 480, 640), 'r2d2.onnx',
//!     input_names=['image'], output_names=names, opset_version=13, dynamo=False,
//!     dynamic_axes={name: {2: 'rows', 3: 'columns'} for name in ['image'] + names})
//! END
//! driftless weights r2d2 --from r2d2.onnx
//! ```
//!
//! Source: Revaud, Weinzaepfel, De Souza & Humenberger, "R2D2: Repeatable and Reliable Detector and Descriptor",
//! NeurIPS 2019.

use super::dense_maps::{Descriptors, Heatmap};
use super::network::{Engine, Network, NetworkError};
use super::weights::{self, WeightsError};
use crate::features::extractor::{ExtractError, FeatureExtractor, ImageFeatures, Keypoint, check_size};
use crate::features::quantize::quantize;
use crate::features::selection::select_best;
use crate::features::tensor::Tensor;
use crate::features::weights::R2D2;
use crate::image::GrayImage;
use crate::matching::Metric;
use std::path::Path;

/// Numbers of a descriptor.
const DIMENSION: usize = 128;
const INPUT: &str = "image";
const OUTPUTS: [&str; 3] = ["descriptors", "repeatability", "reliability"];
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
    network: Network,
    scales: Vec<f32>,
}

impl R2d2Extractor {
    /// Loads the network from the file `r2d2-1.onnx` in a folder.
    ///
    /// # Errors
    /// [`WeightsError`]: the file is missing, damaged or a different network.
    pub fn open(folder: &Path) -> Result<Self, WeightsError> {
        let path = folder.join(R2D2.file);
        let bytes = weights::read_checked(&path, &R2D2)?;
        Self::from_onnx(bytes, Engine::best()).map_err(|error| WeightsError::unusable(&path, &R2D2, error))
    }

    /// Creates an extractor from the bytes of an ONNX file: its input is `image` `[1, 3, rows, columns]`, its outputs are
    /// `descriptors` `[1, 128, rows, columns]`, `repeatability` and `reliability` `[1, 1, rows, columns]`.
    ///
    /// # Errors
    /// [`NetworkError`]; the network is tested on a small image.
    pub fn from_onnx(onnx: Vec<u8>, engine: Engine) -> Result<Self, NetworkError> {
        let network = Network::load(onnx, INPUT, &OUTPUTS, engine)?;
        let mut extractor = Self { network, scales: SCALES.to_vec() };
        // Rows and columns differ from each other and from those of the conversion.
        extractor.extract_scale(&GrayImage::from_fn(40, MIN_SIDE, |x, y| (x * y) as u8))?;
        Ok(extractor)
    }

    /// Sets the image scales, as fractions of the full resolution.
    #[must_use]
    pub fn with_scales(mut self, scales: &[f32]) -> Self {
        self.scales = scales.to_vec();
        self
    }

    /// Keypoints and descriptors at one scale.
    fn extract_scale(
        &mut self,
        image: &GrayImage,
    ) -> Result<Vec<(Keypoint, [f32; DIMENSION])>, NetworkError> {
        let (width, height) = (image.width(), image.height());
        let outputs = self.network.run([1, 3, height, width], prepare(image))?;
        let [descriptors, repeatability, reliability] = <[Tensor; 3]>::try_from(outputs)
            .map_err(|outputs| NetworkError::Outputs { found: outputs.len(), needed: OUTPUTS.len() })?;
        let descriptors = Descriptors::from_output(OUTPUTS[0], &descriptors, DIMENSION, height, width)?;
        let repeatability = Heatmap::from_output(OUTPUTS[1], repeatability, height, width)?;
        let reliability = Heatmap::from_output(OUTPUTS[2], reliability, height, width)?;
        let mut candidates = Vec::new();
        for peak in repeatability.peaks(PEAK_RADIUS, MIN_SCORE) {
            let (x, y) = (peak.x as f32, peak.y as f32);
            let reliable = reliability.bilinear(x, y);
            if reliable > MIN_SCORE {
                let mut vector = [0.0; DIMENSION];
                descriptors.nearest(x, y, &mut vector);
                let pixel = repeatability.refine(peak);
                candidates.push((Keypoint { pixel, scale: 1.0, score: peak.heat * reliable }, vector));
            }
        }
        Ok(candidates)
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
            let found = found.map_err(|error| ExtractError::Extractor(error.into()))?;
            let (fx, fy) = (image.width() as f32 / width as f32, image.height() as f32 / height as f32);
            candidates.extend(found.into_iter().map(|(mut keypoint, vector)| {
                let [u, v] = keypoint.pixel;
                keypoint.pixel = [(u + 0.5) * fx - 0.5, (v + 0.5) * fy - 0.5];
                keypoint.scale = fx;
                (keypoint, vector)
            }));
        }
        let (keypoints, vectors) = select_best(candidates, image, mask, max_features);
        let mut descriptors = Vec::with_capacity(vectors.len() * DIMENSION);
        for vector in &vectors {
            quantize(vector, &mut descriptors);
        }
        Ok(ImageFeatures { keypoints, metric: Metric::CosineInt8, width: DIMENSION, descriptors })
    }
}

/// The image as three equal channels, normalized by mean and standard deviation of the training images.
fn prepare(image: &GrayImage) -> Vec<f32> {
    let mut numbers = Vec::with_capacity(3 * image.pixels().len());
    for (mean, deviation) in COLOUR_MEAN.iter().zip(COLOUR_DEVIATION) {
        numbers.extend(image.pixels().iter().map(|&pixel| (f32::from(pixel) / 255.0 - mean) / deviation));
    }
    numbers
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
