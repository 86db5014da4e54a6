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

use super::block::{Block, Grid};
use super::inverse::invert_positive;
use super::patch::{HALF, Patch, SAMPLES, SIDE, ZERO, dot, mean, subtract, total};
use crate::detection::score::smaller_eigenvalue;
use crate::image::GrayImage;
use nalgebra::Vector2;
use pulp::{Arch, NullaryFnOnce};

/// Smallest eigenvalue of the normal matrix of the translation, per sample: (grey levels / px)^2. Below it the
/// position is not observable (edge or uniform patch). Noise of one grey level gives 0.5.
const MIN_STRUCTURE: f32 = 1.0;
/// Minimum contrast of the other image relative to the template.
const MIN_GAIN: f32 = 0.05;
/// Rows of the samples that gradients are taken from.
const ROWS: usize = SIDE + 2;
/// Samples in such a row: one more on each side is needed, the others fill the last vector.
const COLUMNS: usize = SIDE + 8;
/// Parameters of a warp: two of the translation, then the linear part row by row.
pub(super) const PARAMETERS: usize = 6;

/// A patch of an image with the columns of its Jacobian; memory is reused for the next patch.
#[derive(Clone)]
pub(super) struct Template {
    /// The patch with one sample more on each side.
    samples: [[f32; COLUMNS]; ROWS],
    /// The patch without its mean.
    pub(super) centred: Patch,
    /// Squared norm of `centred`.
    energy: f32,
    /// Columns, orthogonal to brightness changes.
    jacobian: [Patch; PARAMETERS],
    /// Inverse of the normal matrix of the translation: its diagonal and what is beside it.
    translation: [f32; 3],
    /// Inverse of the normal matrix of all parameters, prior included.
    inverse: [[f32; PARAMETERS]; PARAMETERS],
    /// Weight of the prior on the linear part.
    prior: f32,
}

impl Template {
    pub(super) fn new() -> Self {
        Self {
            samples: [[0.0; COLUMNS]; ROWS],
            centred: ZERO,
            energy: 0.0,
            jacobian: [ZERO; PARAMETERS],
            translation: [0.0; 3],
            inverse: [[0.0; PARAMETERS]; PARAMETERS],
            prior: 0.0,
        }
    }

    /// Sets to the patch around a pixel position of an image, for the translation only.
    ///
    /// `None` if the patch is outside the image or has no gradients in two directions.
    pub(super) fn set(&mut self, image: &GrayImage, at: Vector2<f32>, block: &mut Block) -> Option<()> {
        Arch::new().dispatch(Set { template: self, image, at, block })
    }

    /// Adds the columns of the linear part.
    ///
    /// `prior` is the weight of the prior on each element of the linear part: (noise in grey levels / its standard
    /// deviation)^2. `None` if the normal matrix is singular.
    pub(super) fn add_linear_part(&mut self, prior: f32) -> Option<()> {
        Arch::new().dispatch(AddLinearPart { template: self, prior })
    }

    /// The Gauss-Newton step of the translation alone for the samples of a grid in another image.
    #[inline(always)]
    pub(super) fn grid_step(&self, grid: &Grid) -> Result<[f32; 2], NoContrast> {
        let mut sums = [[0.0f32; SIDE]; 3];
        let mut upper = grid.row::<SIDE>(0);
        for k in 0..SIDE {
            let lower = grid.row::<SIDE>(k + 1);
            for i in 0..SIDE {
                let sample = upper[i] + grid.fy * (lower[i] - upper[i]);
                sums[0][i] += self.jacobian[0][k][i] * sample;
                sums[1][i] += self.jacobian[1][k][i] * sample;
                sums[2][i] += self.centred[k][i] * sample;
            }
            upper = lower;
        }
        let [right_x, right_y, along] = sums.map(total);
        self.translation_step(right_x, right_y, along)
    }

    /// The Gauss-Newton step of the translation alone for a patch of another image.
    #[inline(always)]
    pub(super) fn step(&self, seen: &Patch) -> Result<[f32; 2], NoContrast> {
        let [right_x, right_y] = [0, 1].map(|i| dot(&self.jacobian[i], seen));
        self.translation_step(right_x, right_y, dot(&self.centred, seen))
    }

    #[inline(always)]
    fn translation_step(&self, right_x: f32, right_y: f32, along: f32) -> Result<[f32; 2], NoContrast> {
        let gain = along / self.energy;
        if gain.is_nan() || gain < MIN_GAIN {
            return Err(NoContrast);
        }
        let [xx, xy, yy] = self.translation;
        Ok([(xx * right_x + xy * right_y) / gain, (xy * right_x + yy * right_y) / gain])
    }

    /// The Gauss-Newton step for a patch of another image: the increment of the template warp, `(dx, dy | D row by row)`,
    /// in the template's pixels. `deviation` is the difference of the linear part from its prior, row by row.
    #[inline(always)]
    pub(super) fn linear_step(
        &self,
        seen: &Patch,
        deviation: &[f32; 4],
    ) -> Result<[f32; PARAMETERS], NoContrast> {
        let gain = dot(&self.centred, seen) / self.energy;
        if gain.is_nan() || gain < MIN_GAIN {
            return Err(NoContrast);
        }
        let mut right = [0.0; PARAMETERS];
        for (i, value) in right.iter_mut().enumerate() {
            *value = dot(&self.jacobian[i], seen) / gain;
            if i >= 2 {
                *value += self.prior * deviation[i - 2];
            }
        }
        let mut step = [0.0; PARAMETERS];
        for (row, factor) in self.inverse.iter().zip(right) {
            for i in 0..PARAMETERS {
                step[i] += row[i] * factor;
            }
        }
        Ok(step)
    }

    /// Correlation coefficient of the template with a patch of another image, -1 to 1.
    #[inline(always)]
    pub(super) fn correlation(&self, seen: &Patch) -> f32 {
        let mut centred = *seen;
        centre(&mut centred);
        let energy = dot(&centred, &centred);
        if energy <= 0.0 { 0.0 } else { dot(&self.centred, &centred) / (self.energy * energy).sqrt() }
    }

    /// Makes a column orthogonal to brightness changes.
    #[inline(always)]
    fn project(&mut self, column: usize) {
        let column = &mut self.jacobian[column];
        let along = dot(column, &self.centred) / self.energy;
        subtract(column, mean(column), along, &self.centred);
    }
}

/// A patch that has no contrast in common with the template.
pub(super) struct NoContrast;

/// See [`Template::set`].
struct Set<'a> {
    template: &'a mut Template,
    image: &'a GrayImage,
    at: Vector2<f32>,
    block: &'a mut Block,
}

impl NullaryFnOnce for Set<'_> {
    type Output = Option<()>;

    #[inline(always)]
    fn call(self) -> Option<()> {
        let Self { template, image, at, block } = self;
        let grid = block.grid(image, at.add_scalar(-HALF - 1.0), ROWS, COLUMNS)?;
        let mut upper = grid.row::<COLUMNS>(0);
        for (k, samples) in template.samples.iter_mut().enumerate() {
            let lower = grid.row::<COLUMNS>(k + 1);
            for i in 0..COLUMNS {
                samples[i] = upper[i] + grid.fy * (lower[i] - upper[i]);
            }
            upper = lower;
        }
        for y in 0..SIDE {
            template.centred[y].copy_from_slice(&template.samples[y + 1][1..=SIDE]);
        }
        centre(&mut template.centred);
        template.energy = dot(&template.centred, &template.centred);
        if template.energy <= 0.0 {
            return None;
        }
        for column in 0..2 {
            gradient(&template.samples, column, &mut template.jacobian[column]);
            template.project(column);
        }
        let [x, y] = [&template.jacobian[0], &template.jacobian[1]];
        let (xx, xy, yy) = (dot(x, x), dot(x, y), dot(y, y));
        if smaller_eigenvalue(xx, xy, yy) < MIN_STRUCTURE * SAMPLES {
            return None;
        }
        let scale = 1.0 / (xx * yy - xy * xy);
        template.translation = [yy * scale, -xy * scale, xx * scale];
        Some(())
    }
}

/// See [`Template::add_linear_part`].
struct AddLinearPart<'a> {
    template: &'a mut Template,
    prior: f32,
}

impl NullaryFnOnce for AddLinearPart<'_> {
    type Output = Option<()>;

    #[inline(always)]
    fn call(self) -> Option<()> {
        let Self { template, prior } = self;
        for column in 2..PARAMETERS {
            gradient(&template.samples, (column - 2) / 2, &mut template.jacobian[column]);
            times_offset(&mut template.jacobian[column], column % 2 == 0);
            template.project(column);
        }
        let mut normal = [[0.0; PARAMETERS]; PARAMETERS];
        for (i, column) in template.jacobian.iter().enumerate() {
            for (j, other) in template.jacobian[..=i].iter().enumerate() {
                let product = dot(column, other);
                normal[i][j] = product;
                normal[j][i] = product;
            }
        }
        for (i, row) in normal.iter_mut().enumerate().skip(2) {
            row[i] += prior;
        }
        template.prior = prior;
        template.inverse = invert_positive(normal)?;
        Some(())
    }
}

/// Central differences, to the right or down (`axis` 0 or 1).
#[inline(always)]
fn gradient(samples: &[[f32; COLUMNS]; ROWS], axis: usize, out: &mut Patch) {
    for y in 0..SIDE {
        let (before, after) = if axis == 0 {
            (&samples[y + 1][..SIDE], &samples[y + 1][2..SIDE + 2])
        } else {
            (&samples[y][1..=SIDE], &samples[y + 2][1..=SIDE])
        };
        for x in 0..SIDE {
            out[y][x] = 0.5 * (after[x] - before[x]);
        }
    }
}

/// Multiplies each sample by its offset from the centre, to the right or down.
#[inline(always)]
fn times_offset(patch: &mut Patch, right: bool) {
    for (y, row) in patch.iter_mut().enumerate() {
        let down = y as f32 - HALF;
        for (x, value) in row.iter_mut().enumerate() {
            *value *= if right { x as f32 - HALF } else { down };
        }
    }
}

/// Subtracts the mean from every sample.
#[inline(always)]
fn centre(patch: &mut Patch) {
    let mean = mean(patch);
    for row in patch {
        for value in row {
            *value -= mean;
        }
    }
}
