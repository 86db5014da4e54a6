//! SIFT.

mod compress;
mod histogram;
mod orientation;
mod patch;
mod plane;
mod scale_space;
mod spread;

use super::{ExtractError, FeatureExtractor, ImageFeatures, Keypoint};
use crate::GrayImage;
use crate::descriptors::Metric;
use histogram::{Describer, NUMBERS};
use orientation::Orienter;
use plane::Plane;
use scale_space::{Extremum, Octave};

/// Fewest pixels a side of an image: less has no room for a point and what surrounds it.
const LEAST_SIDE: usize = 24;

/// How [`SiftExtractor`] looks for points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SiftOptions {
    /// Whether to look in the image at twice its size too.
    pub doubled: bool,
    /// Weakest response as a part of the image's contrast.
    pub least_contrast: f32,
    /// Weakest response, grey levels.
    pub least_response: f32,
    /// Largest distance that points are kept apart.
    pub largest_distance: f32,
    /// Peaks of the orientation histogram from this share of the highest on make features of their own.
    pub second_orientation: f32,
}

impl Default for SiftOptions {
    fn default() -> Self {
        Self { doubled: true, least_contrast: 0.01, least_response: 0.5, largest_distance: 30.0, second_orientation: 2.0 }
    }
}

/// The classical extractor.
pub struct SiftExtractor {
    options: SiftOptions,
    orienter: Orienter,
    describer: Describer,
}

impl SiftExtractor {
    pub fn new(options: SiftOptions) -> Self {
        Self { options, orienter: Orienter::new(), describer: Describer::new() }
    }

    pub fn histograms(
        &mut self,
        image: &GrayImage,
        mask: Option<&GrayImage>,
        max_features: usize,
    ) -> Result<(Vec<Keypoint>, Vec<[f32; NUMBERS]>), ExtractError> {
        let (width, height) = (image.width(), image.height());
        if width.min(height) < LEAST_SIDE {
            return Err(ExtractError::TooSmall { width, height, least: LEAST_SIDE });
        }
        if let Some(mask) = mask {
            let size = (mask.width(), mask.height());
            if size != (width, height) {
                return Err(ExtractError::MaskSize { mask: size, image: (width, height) });
            }
        }
        let plane = Plane::of_image(image);
        let threshold = (self.options.least_contrast * deviation(&plane)).max(self.options.least_response);
        let octaves = scale_space::octaves(plane, self.options.doubled);
        let mut found: Vec<Extremum> = Vec::new();
        for octave in 0..octaves.len() {
            found.extend(scale_space::extrema(&octaves, octave, threshold));
        }
        found.retain(|extremum| is_wanted(mask, pixel_of(&octaves, extremum)));
        found.sort_by(|a, b| b.response.total_cmp(&a.response));
        let pixels: Vec<[f32; 2]> = found.iter().map(|extremum| pixel_of(&octaves, extremum)).collect();
        let chosen = spread::spread(&pixels, max_features, width as f32, height as f32, self.options.largest_distance);
        let mut keypoints = Vec::new();
        let mut histograms = Vec::new();
        for index in chosen {
            let extremum = &found[index];
            let octave = &octaves[extremum.octave];
            let plane = &octave.levels[extremum.level];
            let (centre, sigma) = (extremum.position, extremum.sigma);
            for angle in self.orienter.orientations(plane, centre, sigma, self.options.second_orientation.min(1.0)) {
                if keypoints.len() == max_features { break; }
                keypoints.push(Keypoint { pixel: pixels[index], scale: sigma * octave.pixel_size, score: extremum.response });
                histograms.push(self.describer.histogram(plane, centre, sigma, angle));
                if self.options.second_orientation > 1.0 { break; }
            }
        }
        Ok((keypoints, histograms))
    }
}

/// Where an extremum is in the image.
fn pixel_of(octaves: &[Octave], extremum: &Extremum) -> [f32; 2] {
    extremum.position.map(|coordinate| coordinate * octaves[extremum.octave].pixel_size)
}

fn is_wanted(mask: Option<&GrayImage>, pixel: [f32; 2]) -> bool {
    mask.is_none_or(|mask| {
        let [x, y] = pixel.map(|coordinate| coordinate.round().max(0.0) as usize);
        mask.get(x.min(mask.width() - 1), y.min(mask.height() - 1)) != 0
    })
}

/// Standard deviation of the grey levels.
fn deviation(plane: &Plane) -> f32 {
    let count = plane.data.len() as f64;
    let mean = plane.data.iter().map(|&v| f64::from(v)).sum::<f64>() / count;
    let variance = plane.data.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / count;
    variance.sqrt() as f32
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
        let (keypoints, histograms) = self.histograms(image, mask, max_features)?;
        let descriptors = histograms.iter().flat_map(compress::compress).collect();
        Ok(ImageFeatures { keypoints, metric: self.metric(), width: self.width(), descriptors, global: None })
    }
}
