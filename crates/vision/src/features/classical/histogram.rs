//! Descriptor of a keypoint: histograms of gradient directions in cells around it.
//!
//! Source: Lowe, IJCV 2004, section 6; Arandjelovic & Zisserman, CVPR 2012 (square roots).

use super::patch::Gradients;
use super::plane::Plane;
use std::f32::consts::TAU;

/// Cells per side.
pub(super) const CELLS: usize = 4;
/// Directions per cell.
pub(super) const DIRECTIONS: usize = 8;
/// Numbers of a descriptor histogram.
pub(super) const NUMBERS: usize = CELLS * CELLS * DIRECTIONS;
/// Side of a cell in units of the keypoint's sigma; Lowe's.
const CELL_SIGMAS: f32 = 3.0;
/// Cells per side including a border of one cell for votes outside.
const WIDE: usize = CELLS + 2;
/// Gradients per side of a cell, 0.6 sigma apart, which the blur of the level permits.
const SAMPLES: usize = 5;
/// Gradients per side of the grid: half a cell beyond the outer cells contributes to them.
const SIDE: usize = (CELLS + 1) * SAMPLES;
/// Numbers are clipped at this fraction of the norm; Lowe's.
const CLIP: f32 = 0.2;

/// Computes descriptor histograms; buffers are reused.
pub(super) struct HistogramBuilder {
    /// For each sample along a side: the cell before it (starting at -1) and its interpolation weights in that cell and the
    /// next.
    cell_weights: Vec<(usize, f32, f32)>,
    weights: Vec<f32>,
    gradients: Gradients<{ (SIDE + 2).next_multiple_of(8) }>,
}

impl HistogramBuilder {
    pub(super) fn new() -> Self {
        let position = |k: usize| (k as f32 + 0.5) / SAMPLES as f32;
        let cell_weights = (0..SIDE)
            .map(|k| {
                let cell = position(k) as usize;
                let beyond = position(k) - cell as f32;
                (cell, 1.0 - beyond, beyond)
            })
            .collect();
        // Lowe: a standard deviation of half the descriptor's side.
        let half = 0.5 * CELLS as f32;
        let middle = 0.5 * (CELLS + 1) as f32;
        let falloff = |k: usize| (-0.5 * ((position(k) - middle) / half).powi(2)).exp();
        let weights = (0..SIDE * SIDE).map(|k| falloff(k % SIDE) * falloff(k / SIDE)).collect();
        Self { cell_weights, weights, gradients: Gradients::default() }
    }

    /// The histogram of a keypoint: rows of cells, columns of cells, directions; square roots, of norm 1 (zero in uniform
    /// image regions).
    pub(super) fn histogram(
        &mut self,
        plane: &Plane,
        centre: [f32; 2],
        sigma: f32,
        angle: f32,
    ) -> [f32; NUMBERS] {
        let step = CELL_SIGMAS * sigma / SAMPLES as f32;
        self.gradients.sample(plane, centre, step, angle, SIDE);
        let mut wide = [[[0.0_f32; DIRECTIONS]; WIDE]; WIDE];
        let bins_a_radian = DIRECTIONS as f32 / TAU;
        for row in 0..SIDE {
            let (cell_row, upper, lower) = self.cell_weights[row];
            for column in 0..SIDE {
                let k = row * SIDE + column;
                let (cell_column, left, right) = self.cell_weights[column];
                let length = self.gradients.lengths[k] * self.weights[k];
                let position = self.gradients.directions[k] * bins_a_radian;
                let bin = position as usize;
                let beyond = position - bin as f32;
                let (first, second) = (bin % DIRECTIONS, (bin + 1) % DIRECTIONS);
                let (in_first, in_second) = (length * (1.0 - beyond), length * beyond);
                for (r, c, weight) in [
                    (cell_row, cell_column, upper * left),
                    (cell_row, cell_column + 1, upper * right),
                    (cell_row + 1, cell_column, lower * left),
                    (cell_row + 1, cell_column + 1, lower * right),
                ] {
                    let cell = &mut wide[r][c];
                    cell[first] += weight * in_first;
                    cell[second] += weight * in_second;
                }
            }
        }
        let mut numbers = [0.0; NUMBERS];
        for (k, number) in numbers.iter_mut().enumerate() {
            let cell = k / DIRECTIONS;
            *number = wide[cell / CELLS + 1][cell % CELLS + 1][k % DIRECTIONS];
        }
        normalize(&mut numbers);
        numbers
    }
}

/// Clips at a fraction of the norm, then takes square roots of the L1-normalized numbers: L2 norm 1.
fn normalize(numbers: &mut [f32; NUMBERS]) {
    let norm = numbers.iter().map(|number| number * number).sum::<f32>().sqrt();
    let limit = CLIP * norm;
    for number in numbers.iter_mut() {
        *number = number.min(limit);
    }
    let sum = numbers.iter().sum::<f32>();
    if sum > 0.0 {
        for number in numbers {
            *number = (*number / sum).sqrt();
        }
    }
}
