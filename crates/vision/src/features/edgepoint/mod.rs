//! EdgePoint2: keypoints with descriptors of 32 to 64 numbers, from a network that is small enough for one processor.
//!
//! | module | what |
//! |---|---|
//! | `noise` | images of little light are smoothed |
//! | `image` | normalization, and the 2x2 phases of the image |
//! | `network` | feature maps and scores |
//! | `describer` | descriptors at keypoints |
//!
//! Differences from the published program: an image whose sides are not multiples of 32 is continued on the right and at the bottom by its
//! last pixels instead of being resampled, so that pixels stay exact; keypoints have sub-pixel positions (parabola through the scores), which lowers the
//! median error of localization from 8.6 to 7.5 mm (V1_01 of EuRoC); an image whose noise exceeds a twentieth of its contrast is smoothed first; of equal scores in one neighbourhood the first is a keypoint. Without refinement, keypoints of
//! a VGA image are those of PyTorch with every published variant, and cosines of their descriptors above 0.999999.
//!
//! The variant S64 is part of the program: of those that take less than 10 ms for a VGA image it localized best. Its weights: 46,276 numbers, 190 kB.
//!
//! Source: Yao, He, Hao & Chen, "EdgePoint2: Compact Descriptors for Superior Efficiency and Accuracy", arXiv 2504.17280; the published
//! weights, under the MIT licence (`LICENSE` in this folder).

mod describer;
mod image;
mod network;
mod noise;
#[cfg(test)]
mod tests;

use super::extractor::{ExtractError, FeatureExtractor, ImageFeatures, Keypoint, check_size};
use super::heatmap::Heatmap;
use super::quantize::quantized;
use super::selection::select_best;
use super::state_dict::{StateDict, StateDictError};
use crate::image::GrayImage;
use crate::matching::Metric;
use describer::Describer;
use image::MULTIPLE;
use network::{Maps, Network};

/// Name of the extractor.
pub const NAME: &str = "edgepoint2-1";
/// The published weights of the variant S64, converted by `torch_to_safetensors.py` of `driftless weights`.
const WEIGHTS: &[u8] = include_bytes!("s64.safetensors");
/// Radius of non-maximum suppression (5 x 5), as published.
const PEAK_RADIUS: usize = 2;
/// Least score of a keypoint, as published.
const MIN_SCORE: f32 = -5.0;
/// No keypoint is nearer to a side of the image, pixels, as published.
const BORDER: usize = 4;

/// The extractor `edgepoint2-1`; see the module documentation.
///
/// # Example
/// ```
/// use vision::features::EdgePointExtractor;
/// use vision::{FeatureExtractor, GrayImage};
///
/// let checks = GrayImage::from_fn(160, 120, |x, y| if (x / 20 + y / 20) % 2 == 0 { 60 } else { 200 });
/// let features = EdgePointExtractor::new()?.extract(&checks, None, 50)?;
/// assert!(!features.keypoints.is_empty() && features.keypoints.len() <= 50);
/// assert_eq!(features.descriptors.len(), 64 * features.keypoints.len());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct EdgePointExtractor {
    name: String,
    network: Network,
    describer: Describer,
    maps: Maps,
    scores: Heatmap,
    refines: bool,
}

impl EdgePointExtractor {
    /// Creates an extractor with the weights of the variant S64, which are part of the program.
    ///
    /// # Errors
    /// [`StateDictError`], which only a damaged program has.
    pub fn new() -> Result<Self, StateDictError> {
        Self::from_weights(NAME, &StateDict::read(WEIGHTS)?)
    }

    /// Creates an extractor with other weights, of any published variant (T32 to E64) or of your own training.
    ///
    /// # Arguments
    /// * `name`: of the extractor; another one than [`NAME`], since descriptors of different weights cannot be compared.
    ///
    /// # Errors
    /// [`StateDictError`] if a tensor is missing, not finite or has a wrong shape.
    pub fn from_weights(name: &str, weights: &StateDict) -> Result<Self, StateDictError> {
        let (network, describer) = (Network::new(weights)?, Describer::new(weights)?);
        let (maps, scores) = (Maps::default(), Heatmap::default());
        Ok(Self { name: name.to_owned(), network, describer, maps, scores, refines: true })
    }

    /// Sets whether keypoints have sub-pixel positions; without, they are whole pixels, as published.
    pub fn with_refinement(mut self, refines: bool) -> Self {
        self.refines = refines;
        self
    }

    /// Extracts keypoints with `f32` descriptors of length 1, before quantization; best first.
    ///
    /// # Returns
    /// Keypoints, and their descriptors one after the other.
    ///
    /// # Errors
    /// As [`FeatureExtractor::extract`].
    pub fn extract_floats(
        &mut self,
        image: &GrayImage,
        mask: Option<&GrayImage>,
        max_features: usize,
    ) -> Result<(Vec<Keypoint>, Vec<f32>), ExtractError> {
        check_size(image, mask, MULTIPLE)?;
        image::prepare(&noise::without_noise(image), &mut self.maps.image);
        self.network.run(&mut self.maps);
        self.scores.fill(&self.maps.scores);
        let peaks = self.scores.peaks::<PEAK_RADIUS>(MIN_SCORE);
        let (columns, rows) = (BORDER..image.width() - BORDER, BORDER..image.height() - BORDER);
        let inside = peaks.into_iter().filter(|peak| columns.contains(&peak.x) && rows.contains(&peak.y));
        let candidates = inside.map(|peak| {
            let pixel = [peak.x as f32, peak.y as f32];
            (Keypoint { pixel, scale: 1.0, score: peak.heat }, peak)
        });
        let (mut keypoints, peaks) = select_best(candidates.collect(), image, mask, max_features);
        if self.refines {
            for (keypoint, &peak) in keypoints.iter_mut().zip(&peaks) {
                keypoint.pixel = self.scores.refine(peak, |score| score);
            }
        }
        let pixels: Vec<[f32; 2]> = keypoints.iter().map(|keypoint| keypoint.pixel).collect();
        let descriptors = self.describer.describe(&self.maps, &pixels);
        Ok((keypoints, descriptors))
    }
}

impl FeatureExtractor for EdgePointExtractor {
    fn name(&self) -> &str {
        &self.name
    }

    fn metric(&self) -> Metric {
        Metric::CosineInt8
    }

    fn width(&self) -> usize {
        self.describer.dimension()
    }

    fn extract(
        &mut self,
        image: &GrayImage,
        mask: Option<&GrayImage>,
        max_features: usize,
    ) -> Result<ImageFeatures, ExtractError> {
        let (keypoints, numbers) = self.extract_floats(image, mask, max_features)?;
        Ok(quantized(keypoints, self.width(), numbers.chunks_exact(self.width())))
    }
}
