//! Corner scores of the pixels of a grid cell, and their local maxima.

use super::corner::{Corner, CornerOptions};
use crate::image::GrayImage;
use nalgebra::Vector2;
use std::ops::Range;

/// Half the side of the window over which gradients are summed, pixels: 7 x 7.
const WINDOW: usize = 3;
/// Border without corners, pixels: the window, the gradient, and the comparison of neighbours.
pub(super) const BORDER: usize = WINDOW + 2;

/// Computes corner scores of grid cells; its buffers are reused.
#[derive(Default)]
pub(super) struct Scorer {
    /// Gradient products `xx`, `xy`, `yy` of every pixel.
    products: [Vec<f32>; 3],
    /// The same summed over the rows of the window.
    sums: [Vec<f32>; 3],
    scores: Vec<f32>,
}

impl Scorer {
    /// Appends the local maxima of the score in a cell (pixel ranges `[x, y]`).
    pub(super) fn search(
        &mut self,
        image: &GrayImage,
        cell: &[Range<usize>; 2],
        options: &CornerOptions,
        mask: Option<&GrayImage>,
        candidates: &mut Vec<Corner>,
    ) {
        let margin = (options.margin.max(0.0).ceil() as usize).max(BORDER);
        let inner = |range: &Range<usize>, side: usize| {
            range.start.max(margin)..range.end.min(side.saturating_sub(margin))
        };
        let [x, y] = [inner(&cell[0], image.width()), inner(&cell[1], image.height())];
        if x.is_empty() || y.is_empty() {
            return;
        }
        self.score(image, &x, &y);
        // Scores extend one pixel beyond the cell on every side, for the comparison with neighbours.
        let stride = x.len() + 2;
        for row in 0..y.len() {
            let mask_row = mask.map(|mask| &mask.row(y.start + row)[x.clone()]);
            for column in 0..x.len() {
                let at = (row + 1) * stride + column + 1;
                let score = self.scores[at];
                if score < options.min_score || !self.is_maximum(at, stride) {
                    continue;
                }
                if mask_row.is_some_and(|mask| mask[column] == 0) {
                    continue;
                }
                let pixel = Vector2::new((x.start + column) as f32, (y.start + row) as f32);
                candidates.push(Corner { pixel: pixel + self.vertex(at, stride), score });
            }
        }
    }

    /// Computes `scores` for the pixels of `x` and `y`, extended by one pixel on each side.
    fn score(&mut self, image: &GrayImage, x: &Range<usize>, y: &Range<usize>) {
        let reach = WINDOW + 1;
        let (columns, rows) = (x.len() + 2 * reach, y.len() + 2 * reach);
        let (left, top) = (x.start - reach, y.start - reach);
        for product in &mut self.products {
            product.resize(columns * rows, 0.0);
        }
        let [xx, xy, yy] = &mut self.products;
        for row in 0..rows {
            let at = row * columns..(row + 1) * columns;
            let out = [&mut xx[at.clone()], &mut xy[at.clone()], &mut yy[at]];
            gradient_products(image, left, top + row, out);
        }
        let width = x.len() + 2;
        for sums in &mut self.sums {
            sums.clear();
            sums.resize(columns, 0.0);
        }
        self.scores.resize(width * (y.len() + 2), 0.0);
        let row_of = |row: usize| row * columns..(row + 1) * columns;
        for row in 0..rows {
            for (sums, products) in self.sums.iter_mut().zip(&self.products) {
                // Quarters of integers below 2^24: a running sum is exact.
                add_row(sums, &products[row_of(row)]);
                if row > 2 * WINDOW {
                    subtract_row(sums, &products[row_of(row - 2 * WINDOW - 1)]);
                }
            }
            if row >= 2 * WINDOW {
                let first = (row - 2 * WINDOW) * width;
                score_row(&self.sums, &mut self.scores[first..first + width]);
            }
        }
    }

    fn is_maximum(&self, at: usize, stride: usize) -> bool {
        let own = self.scores[at];
        let before = [at - stride - 1, at - stride, at - stride + 1, at - 1];
        let after = [at + 1, at + stride - 1, at + stride, at + stride + 1];
        before.iter().all(|other| self.scores[*other] < own)
            && after.iter().all(|other| self.scores[*other] <= own)
    }

    /// Sub-pixel offset of the maximum: vertex of a parabola through the scores along each axis, within half a pixel.
    fn vertex(&self, at: usize, stride: usize) -> Vector2<f32> {
        let along = |step: usize| {
            let (before, own, after) = (self.scores[at - step], self.scores[at], self.scores[at + step]);
            let bend = before + after - 2.0 * own;
            if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
        };
        Vector2::new(along(1), along(stride))
    }
}

/// Gradient products (central differences) of one row, starting at column `left`.
fn gradient_products(image: &GrayImage, left: usize, y: usize, out: [&mut [f32]; 3]) {
    let n = out[0].len();
    let middle = &image.row(y)[left - 1..=left + n];
    let upper = &image.row(y - 1)[left..left + n];
    let lower = &image.row(y + 1)[left..left + n];
    let [xx, xy, yy] = out;
    for i in 0..n {
        let gx = 0.5 * f32::from(i16::from(middle[i + 2]) - i16::from(middle[i]));
        let gy = 0.5 * f32::from(i16::from(lower[i]) - i16::from(upper[i]));
        xx[i] = gx * gx;
        xy[i] = gx * gy;
        yy[i] = gy * gy;
    }
}

fn add_row(sums: &mut [f32], row: &[f32]) {
    for (sum, value) in sums.iter_mut().zip(row) {
        *sum += value;
    }
}

fn subtract_row(sums: &mut [f32], row: &[f32]) {
    for (sum, value) in sums.iter_mut().zip(row) {
        *sum -= value;
    }
}

/// Scores of one row from products summed over the rows of the window; sums over its columns here.
fn score_row(sums: &[Vec<f32>; 3], scores: &mut [f32]) {
    const SIDE: usize = 2 * WINDOW + 1;
    let n = scores.len();
    let [xx, xy, yy] = [&sums[0][..n + SIDE - 1], &sums[1][..n + SIDE - 1], &sums[2][..n + SIDE - 1]];
    let across = |values: &[f32], i: usize| {
        values[i]
            + values[i + 1]
            + values[i + 2]
            + values[i + 3]
            + values[i + 4]
            + values[i + 5]
            + values[i + 6]
    };
    for (i, score) in scores.iter_mut().enumerate() {
        let eigenvalue = smaller_eigenvalue(across(xx, i), across(xy, i), across(yy, i));
        *score = eigenvalue * (1.0 / (SIDE * SIDE) as f32);
    }
}

/// The smaller eigenvalue of the symmetric matrix `[a b; b c]`.
pub(crate) fn smaller_eigenvalue(a: f32, b: f32, c: f32) -> f32 {
    let half = 0.5 * (a - c);
    0.5 * (a + c) - (half * half + b * b).sqrt()
}
