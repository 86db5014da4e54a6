//! Dominant orientation of a keypoint: peak of the histogram of gradient directions.
//!
//! Source: Lowe, IJCV 2004, section 5.

use super::patch::Gradients;
use super::plane::Plane;
use std::f32::consts::TAU;

/// Gradients per side of the grid.
const SIDE: usize = 15;
/// Spacing of the gradients in units of the keypoint's sigma: the grid extends 4.2 sigma to each side.
const STEP: f32 = 0.6;
/// Standard deviation of the weights in units of the keypoint's sigma; Lowe's.
const WINDOW_SIGMA: f32 = 1.5;
/// Bins of the histogram: 10 degrees each; Lowe's.
const BINS: usize = 36;
/// Passes of smoothing the histogram with [1 1 1]/3.
const SMOOTHINGS: usize = 4;

/// Estimates orientations; buffers are reused.
pub(super) struct OrientationEstimator {
    weights: Vec<f32>,
    gradients: Gradients<{ (SIDE + 2).next_multiple_of(8) }>,
}

impl OrientationEstimator {
    pub(super) fn new() -> Self {
        let middle = 0.5 * (SIDE - 1) as f32;
        let falloff = |k: usize| (-0.5 * ((k as f32 - middle) * STEP / WINDOW_SIGMA).powi(2)).exp();
        let weights = (0..SIDE * SIDE).map(|k| falloff(k % SIDE) * falloff(k / SIDE)).collect();
        Self { weights, gradients: Gradients::default() }
    }

    /// The direction (radians, x towards y) of the highest peak of the histogram.
    pub(super) fn orientation(&mut self, plane: &Plane, centre: [f32; 2], sigma: f32) -> f32 {
        self.gradients.sample(plane, centre, STEP * sigma, 0.0, SIDE);
        let mut histogram = [0.0; BINS];
        let bins_a_radian = BINS as f32 / TAU;
        let gradients = self.gradients.lengths.iter().zip(&self.gradients.directions);
        for ((&length, &direction), &weight) in gradients.zip(&self.weights) {
            let position = direction * bins_a_radian;
            let bin = position as usize;
            let beyond = position - bin as f32;
            histogram[bin % BINS] += (1.0 - beyond) * weight * length;
            histogram[(bin + 1) % BINS] += beyond * weight * length;
        }
        for _ in 0..SMOOTHINGS {
            let last = histogram;
            for bin in 0..BINS {
                histogram[bin] = (last[(bin + BINS - 1) % BINS] + last[bin] + last[(bin + 1) % BINS]) / 3.0;
            }
        }
        highest(&histogram)
    }
}

/// The direction of the highest bin, interpolated by a parabola; 0 where the image is flat.
fn highest(histogram: &[f32; BINS]) -> f32 {
    let bin = (0..BINS).fold(0, |best, bin| if histogram[bin] > histogram[best] { bin } else { best });
    let (left, right) = (histogram[(bin + BINS - 1) % BINS], histogram[(bin + 1) % BINS]);
    let curvature = left + right - 2.0 * histogram[bin];
    let shift = if curvature < 0.0 { 0.5 * (left - right) / curvature } else { 0.0 };
    (bin as f32 + shift) * TAU / BINS as f32
}
