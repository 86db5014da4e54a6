//! The template of a patch for inverse compositional alignment.
//!
//! Gradients and normal matrix belong to the template and are computed once. A brightness change
//! `I = gain * T + bias` is projected out instead of being estimated: the columns of the Jacobian are made orthogonal to
//! the constant and to the template, so that neither bias nor gain affects the step; the gain that scales the step is a
//! projection.
//!
//! ```text
//! I(c + A x) ~ gain T(x + D x + d) + bias,    J = [ gx gy | gx x  gx y  gy x  gy y ],    Jp = (1 - projections) J
//! (d, D) = (Jp' Jp)^-1 Jp' I / gain
//! ```
//!
//! Sources: Baker & Matthews, "Lucas-Kanade 20 years on", IJCV 2004 (inverse composition); Hager & Belhumeur,
//! "Efficient region tracking", PAMI 1998 (projecting out linear appearance change).

use super::block::{Block, HALF, Patch, SIDE, centre, dot, subtract};
use crate::detection::score::smaller_eigenvalue;
use crate::image::GrayImage;
use nalgebra::{SMatrix, SVector, Vector2};

/// Smallest eigenvalue of the normal matrix of the translation, per sample: (grey levels / px)^2. Below it the
/// position is not observable (edge or uniform patch). Noise of one grey level gives 0.5.
const MIN_STRUCTURE: f32 = 1.0;

/// A patch of an image with its `P` Jacobian columns: 2 for translation, 6 with the linear part.
pub(super) struct Template<const P: usize> {
    /// Columns, orthogonal to brightness changes.
    jacobian: [Patch; P],
    /// The patch without its mean.
    centred: Patch,
    /// Squared norm of `centred`.
    energy: f32,
    /// Inverse of the normal matrix, prior included.
    inverse: SMatrix<f32, P, P>,
    /// Weight of the prior on the linear part.
    prior: f32,
}

impl<const P: usize> Template<P> {
    /// The template around a pixel position of an image.
    ///
    /// `prior` is the weight of the prior on each element of the linear part: (noise in grey levels / its standard
    /// deviation)^2. `None` if the patch is outside the image or has no gradients in two directions.
    pub(super) fn new(image: &GrayImage, at: Vector2<f32>, prior: f32) -> Option<Box<Self>> {
        const APRON: usize = SIDE + 2;
        let block = Block::around(image, at)?;
        let samples = block.grid::<APRON>(at.add_scalar(-HALF - 1.0))?;
        // Boxed and filled in place: several kilobytes.
        let mut template = Box::new(Self {
            jacobian: [[[0.0; SIDE]; SIDE]; P],
            centred: [[0.0; SIDE]; SIDE],
            energy: 0.0,
            inverse: SMatrix::zeros(),
            prior,
        });
        let Self { jacobian, centred, .. } = &mut *template;
        for y in 0..SIDE {
            for x in 0..SIDE {
                centred[y][x] = samples[y + 1][x + 1];
                jacobian[0][y][x] = 0.5 * (samples[y + 1][x + 2] - samples[y + 1][x]);
                jacobian[1][y][x] = 0.5 * (samples[y + 2][x + 1] - samples[y][x + 1]);
            }
        }
        for column in 2..P {
            let (gradient, products) = jacobian.split_at_mut(2);
            times_offset(&gradient[(column - 2) / 2], column % 2 == 0, &mut products[column - 2]);
        }
        centre(centred);
        let energy = dot(centred, centred);
        if energy <= 0.0 {
            return None;
        }
        for column in &mut *jacobian {
            centre(column);
            let along = dot(column, centred) / energy;
            subtract(column, along, centred);
        }
        let mut normal = SMatrix::<f32, P, P>::zeros();
        for i in 0..P {
            for j in 0..=i {
                let product = dot(&jacobian[i], &jacobian[j]);
                normal[(i, j)] = product;
                normal[(j, i)] = product;
            }
        }
        if smaller_eigenvalue(normal[(0, 0)], normal[(0, 1)], normal[(1, 1)])
            < MIN_STRUCTURE * (SIDE * SIDE) as f32
        {
            return None;
        }
        for i in 2..P {
            normal[(i, i)] += prior;
        }
        template.energy = energy;
        template.inverse = normal.try_inverse()?;
        Some(template)
    }

    /// The Gauss-Newton step for samples of another image: the increment of the template warp, `(dx, dy | D row by row)`, in
    /// the template's pixels. `deviation` is the difference of the linear part from its prior, row by row.
    ///
    /// `None` if the samples have no contrast in common with the template.
    #[inline]
    pub(super) fn step(&self, seen: &Patch, deviation: &[f32; 4]) -> Option<SVector<f32, P>> {
        /// Minimum contrast relative to the template.
        const MIN_GAIN: f32 = 0.05;
        let gain = dot(&self.centred, seen) / self.energy;
        if gain < MIN_GAIN {
            return None;
        }
        let mut right = SVector::<f32, P>::zeros();
        for i in 0..P {
            right[i] = dot(&self.jacobian[i], seen) / gain;
        }
        for i in 2..P {
            right[i] += self.prior * deviation[i - 2];
        }
        Some(self.inverse * right)
    }

    /// Correlation coefficient of the template with samples of another image, -1 to 1.
    pub(super) fn correlation(&self, mut seen: Patch) -> f32 {
        centre(&mut seen);
        let energy = dot(&seen, &seen);
        if energy <= 0.0 { 0.0 } else { dot(&self.centred, &seen) / (self.energy * energy).sqrt() }
    }
}

/// A component of the gradient times the offset of each sample from the centre, to the right or down.
fn times_offset(gradient: &Patch, right: bool, out: &mut Patch) {
    for y in 0..SIDE {
        let down = y as f32 - HALF;
        for x in 0..SIDE {
            out[y][x] = gradient[y][x] * if right { x as f32 - HALF } else { down };
        }
    }
}
