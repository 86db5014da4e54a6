//! Corner scores of the pixels of a grid cell, and their local maxima.

use super::corner::{Corner, CornerOptions};
use crate::image::{GrayImage, marked};
use nalgebra::Vector2;
use pulp::{Arch, NullaryFnOnce};
use std::ops::Range;

/// Half the side of the window over which gradients are summed, pixels: 7 x 7.
const WINDOW: usize = 3;
/// Border without corners, pixels: the window, the gradient, and the comparison of neighbours.
pub(super) const BORDER: usize = WINDOW + 2;

/// Sides of the window, pixels.
const SIDE: usize = 2 * WINDOW + 1;

/// Computes corner scores of grid cells; its buffers are reused.
#[derive(Default)]
pub(super) struct Scorer {
    /// Gradient products `xx`, `xy`, `yy` summed over the rows of the window, for each column.
    sums: [Vec<f32>; 3],
    scores: Vec<f32>,
    /// Pixels of a row that may be local maxima.
    marks: Vec<bool>,
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
        Arch::new().dispatch(Score { scorer: self, image, x: x.clone(), y: y.clone() });
        // Scores extend one pixel beyond the cell on every side, for the comparison with neighbours.
        let stride = x.len() + 2;
        for row in 0..y.len() {
            let mask_row = mask.map(|mask| &mask.row(y.start + row)[x.clone()]);
            Arch::new().dispatch(Mark { scorer: self, row: row + 1, stride, least: options.min_score });
            for column in marked(&self.marks) {
                let at = (row + 1) * stride + column + 1;
                if !self.is_maximum(at, stride) || mask_row.is_some_and(|mask| mask[column] == 0) {
                    continue;
                }
                let pixel = Vector2::new((x.start + column) as f32, (y.start + row) as f32);
                let score = self.scores[at];
                candidates.push(Corner { pixel: pixel + self.vertex(at, stride), score });
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

/// Computes the scores of the pixels of `x` and `y`, extended by one pixel on each side.
struct Score<'a> {
    scorer: &'a mut Scorer,
    image: &'a GrayImage,
    x: Range<usize>,
    y: Range<usize>,
}

impl NullaryFnOnce for Score<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let reach = WINDOW + 1;
        let (columns, rows) = (self.x.len() + 2 * reach, self.y.len() + 2 * reach);
        let (left, top) = (self.x.start - reach, self.y.start - reach);
        let width = self.x.len() + 2;
        let Scorer { sums, scores, .. } = self.scorer;
        for sums in &mut *sums {
            sums.clear();
            sums.resize(columns, 0.0);
        }
        scores.resize(width * (self.y.len() + 2), 0.0);
        for row in 0..rows {
            // Integers below 2^24: a running sum is exact.
            add_row(&GradientRow::new(self.image, left, top + row, columns), 1.0, sums);
            if row >= SIDE {
                add_row(&GradientRow::new(self.image, left, top + row - SIDE, columns), -1.0, sums);
            }
            if row >= SIDE - 1 {
                let first = (row + 1 - SIDE) * width;
                score_row(sums, &mut scores[first..first + width]);
            }
        }
    }
}

/// The pixels from which the gradients of a row are taken.
struct GradientRow<'a> {
    left: &'a [u8],
    right: &'a [u8],
    upper: &'a [u8],
    lower: &'a [u8],
}

impl<'a> GradientRow<'a> {
    /// Of `columns` pixels of row `y` from column `left` on.
    #[inline(always)]
    fn new(image: &'a GrayImage, left: usize, y: usize, columns: usize) -> Self {
        let row = image.row(y);
        Self {
            left: &row[left - 1..][..columns],
            right: &row[left + 1..][..columns],
            upper: &image.row(y - 1)[left..][..columns],
            lower: &image.row(y + 1)[left..][..columns],
        }
    }
}

/// Adds the products of the gradients, in units of (half a grey level / px)^2, times `sign`.
#[inline(always)]
fn add_row(row: &GradientRow, sign: f32, sums: &mut [Vec<f32>; 3]) {
    let n = row.left.len();
    let GradientRow { left, right, upper, lower } = *row;
    let (right, upper, lower) = (&right[..n], &upper[..n], &lower[..n]);
    let [xx, xy, yy] = sums;
    let (xx, xy, yy) = (&mut xx[..n], &mut xy[..n], &mut yy[..n]);
    for i in 0..n {
        let gx = f32::from(i16::from(right[i]) - i16::from(left[i]));
        let gy = f32::from(i16::from(lower[i]) - i16::from(upper[i]));
        let (signed_x, signed_y) = (sign * gx, sign * gy);
        xx[i] += signed_x * gx;
        xy[i] += signed_x * gy;
        yy[i] += signed_y * gy;
    }
}

/// Scores of one row from products summed over the rows of the window; sums over its columns here.
#[inline(always)]
fn score_row(sums: &[Vec<f32>; 3], scores: &mut [f32]) {
    /// Gradients are twice central differences.
    const SCALE: f32 = 1.0 / (4 * SIDE * SIDE) as f32;
    let n = scores.len();
    let [xx, xy, yy] = [&sums[0][..n + SIDE - 1], &sums[1][..n + SIDE - 1], &sums[2][..n + SIDE - 1]];
    for (i, score) in scores.iter_mut().enumerate() {
        *score = smaller_eigenvalue(across(xx, i), across(xy, i), across(yy, i)) * SCALE;
    }
}

/// The sum over the columns of the window.
#[inline(always)]
fn across(values: &[f32], i: usize) -> f32 {
    let pairs = (values[i] + values[i + 1]) + (values[i + 2] + values[i + 3]);
    pairs + (values[i + 4] + values[i + 5]) + values[i + 6]
}

/// Marks the pixels of a row of scores that are at least `least` and not below their four neighbours.
struct Mark<'a> {
    scorer: &'a mut Scorer,
    row: usize,
    stride: usize,
    least: f32,
}

impl NullaryFnOnce for Mark<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Scorer { scores, marks, .. } = self.scorer;
        let n = self.stride - 2;
        let start = self.row * self.stride;
        marks.resize(n, false);
        let marks = &mut marks[..n];
        let (before, own, after) =
            (&scores[start..][..n], &scores[start + 1..][..n], &scores[start + 2..][..n]);
        let upper = &scores[start + 1 - self.stride..][..n];
        let lower = &scores[start + 1 + self.stride..][..n];
        for i in 0..n {
            // One comparison, so that the compiler vectorizes.
            let most = before[i].max(after[i]).max(upper[i].max(lower[i]));
            marks[i] = own[i] >= most.max(self.least);
        }
    }
}

/// The smaller eigenvalue of the symmetric matrix `[a b; b c]`.
#[inline(always)]
pub(crate) fn smaller_eigenvalue(a: f32, b: f32, c: f32) -> f32 {
    let half = 0.5 * (a - c);
    0.5 * (a + c) - (half * half + b * b).sqrt()
}
