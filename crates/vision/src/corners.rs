//! Corners to track, spread over the image.
//!
//! The image is cut into cells of a grid. Cells that have fewer points than their share are searched for places
//! where the image changes in two directions, and the best of each cell are taken, not too close to each other or to
//! what is tracked already.
//!
//! Source: Shi & Tomasi, "Good features to track", CVPR 1994: the score is the smaller eigenvalue of the mean of
//! `gradient * gradient'` over a small window.

use crate::image::GrayImage;
use crate::tracking::smaller_eigenvalue;
use nalgebra::Vector2;

/// Half the side of the window over which gradients are summed, pixels: 7 x 7.
const WINDOW: usize = 3;
/// No corner closer to the border than this, pixels: gradients, their window, the search for the maximum.
const BORDER: usize = WINDOW + 2;

/// Settings of [`detect_corners`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CornerOptions {
    /// Cells of the grid across and down.
    pub cells: [usize; 2],
    /// Smallest distance of two points, pixels.
    pub min_distance: f32,
    /// Score below which nothing is a corner, (grey levels / px)^2. Noise of one grey level scores about 0.3.
    pub min_score: f32,
    /// No corner closer to the border of the image than this, pixels: a patch around it would reach outside.
    pub margin: f32,
}

impl Default for CornerOptions {
    /// Square cells of 94 x 96 pixels on a 752 x 480 image.
    fn default() -> Self {
        Self { cells: [8, 5], min_distance: 16.0, min_score: 12.0, margin: 10.0 }
    }
}

/// A corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// Its position, refined to a fraction of a pixel.
    pub pixel: Vector2<f32>,
    /// Its score, (grey levels / px)^2.
    pub score: f32,
}

/// Finds corners beside those that there are, best first within each share.
///
/// Every cell of the grid has an equal share of `wanted`. Cells that lack points are filled up to their share; what
/// is then still missing, because other cells have nothing to offer, is taken from the best that was found.
///
/// # Arguments
/// * `existing`: points that are tracked already, pixels. They count for their cells.
/// * `mask`: no corner where it is zero; of the image's size, or it is not looked at.
/// * `wanted`: how many points there should be together with the existing ones.
pub fn detect_corners(
    image: &GrayImage,
    existing: &[Vector2<f32>],
    mask: Option<&GrayImage>,
    wanted: usize,
    options: &CornerOptions,
) -> Vec<Corner> {
    let missing = wanted.saturating_sub(existing.len());
    let (width, height) = (image.width(), image.height());
    if missing == 0 || width.min(height) <= 2 * BORDER {
        return Vec::new();
    }
    let mask = mask.filter(|mask| (mask.width(), mask.height()) == (width, height));
    let grid = Grid::new(image, options.cells);
    let share = wanted.div_ceil(grid.cells());
    let mut taken = vec![0usize; grid.cells()];
    let mut spacing = Spacing::new(image, options.min_distance);
    for point in existing {
        taken[grid.cell_of(*point)] += 1;
        spacing.insert(*point);
    }
    let mut scorer = Scorer::default();
    let mut candidates = Vec::new();
    for (cell, count) in taken.iter().enumerate() {
        if *count < share {
            scorer.search(image, &grid.range(cell), options, mask, &mut candidates);
        }
    }
    candidates.sort_by(|a: &Corner, b| b.score.total_cmp(&a.score));
    let mut chosen = Vec::with_capacity(missing);
    for limit in [share, usize::MAX] {
        candidates.retain(|candidate| {
            let cell = grid.cell_of(candidate.pixel);
            if chosen.len() == missing || taken[cell] >= limit {
                return true;
            }
            if spacing.is_free(candidate.pixel) {
                spacing.insert(candidate.pixel);
                taken[cell] += 1;
                chosen.push(*candidate);
            }
            false
        });
    }
    chosen
}

/// The cells of an image.
struct Grid {
    cells: [usize; 2],
    size: [usize; 2],
}

impl Grid {
    fn new(image: &GrayImage, cells: [usize; 2]) -> Self {
        let size = [image.width(), image.height()];
        Self { cells: [cells[0].clamp(1, size[0]), cells[1].clamp(1, size[1])], size }
    }

    fn cells(&self) -> usize {
        self.cells[0] * self.cells[1]
    }

    fn cell_of(&self, point: Vector2<f32>) -> usize {
        let index = |value: f32, axis: usize| {
            let pixel = (value.round().max(0.0) as usize).min(self.size[axis] - 1);
            (pixel * self.cells[axis] / self.size[axis]).min(self.cells[axis] - 1)
        };
        index(point.y, 1) * self.cells[0] + index(point.x, 0)
    }

    /// Pixels of a cell, `[x, y]`.
    fn range(&self, cell: usize) -> [std::ops::Range<usize>; 2] {
        let along = |index: usize, axis: usize| {
            let bound = |k: usize| (k * self.size[axis]).div_ceil(self.cells[axis]);
            bound(index)..bound(index + 1)
        };
        [along(cell % self.cells[0], 0), along(cell / self.cells[0], 1)]
    }
}

/// Points by place, to ask whether one is near.
pub(crate) struct Spacing {
    distance: f32,
    across: usize,
    bins: Vec<Vec<Vector2<f32>>>,
}

impl Spacing {
    /// For points at least `distance` pixels apart in an image.
    pub(crate) fn new(image: &GrayImage, distance: f32) -> Self {
        let distance = distance.max(1.0);
        let count = |side: usize| (side as f32 / distance) as usize + 1;
        let across = count(image.width());
        Self { distance, across, bins: vec![Vec::new(); across * count(image.height())] }
    }

    fn bin(&self, point: Vector2<f32>) -> [usize; 2] {
        let index = |value: f32, count: usize| ((value / self.distance).max(0.0) as usize).min(count - 1);
        [index(point.x, self.across), index(point.y, self.bins.len() / self.across)]
    }

    /// Adds a point.
    pub(crate) fn insert(&mut self, point: Vector2<f32>) {
        let [x, y] = self.bin(point);
        self.bins[y * self.across + x].push(point);
    }

    /// Whether no point is closer than the distance.
    pub(crate) fn is_free(&self, point: Vector2<f32>) -> bool {
        let [x, y] = self.bin(point);
        let down = self.bins.len() / self.across;
        for row in y.saturating_sub(1)..(y + 2).min(down) {
            for column in x.saturating_sub(1)..(x + 2).min(self.across) {
                let near =
                    |other: &Vector2<f32>| (other - point).norm_squared() < self.distance * self.distance;
                if self.bins[row * self.across + column].iter().any(near) {
                    return false;
                }
            }
        }
        true
    }
}

/// Scores the pixels of a cell; holds the memory for it.
#[derive(Default)]
struct Scorer {
    /// Products of the gradient, `xx`, `xy`, `yy`, of every pixel; then summed down the window.
    products: [Vec<f32>; 3],
    sums: [Vec<f32>; 3],
    scores: Vec<f32>,
}

impl Scorer {
    /// Appends the local maxima of the score in a cell.
    fn search(
        &mut self,
        image: &GrayImage,
        cell: &[std::ops::Range<usize>; 2],
        options: &CornerOptions,
        mask: Option<&GrayImage>,
        candidates: &mut Vec<Corner>,
    ) {
        let margin = (options.margin.max(0.0).ceil() as usize).max(BORDER);
        let inner = |range: &std::ops::Range<usize>, side: usize| {
            range.start.max(margin)..range.end.min(side.saturating_sub(margin))
        };
        let [x, y] = [inner(&cell[0], image.width()), inner(&cell[1], image.height())];
        if x.is_empty() || y.is_empty() {
            return;
        }
        self.score(image, &x, &y);
        // Scores reach one pixel beyond the cell on every side, for the comparison with the neighbours.
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

    /// Fills `scores` for the pixels of `x` and `y` and one more on each side.
    fn score(&mut self, image: &GrayImage, x: &std::ops::Range<usize>, y: &std::ops::Range<usize>) {
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
                // Quarters of integers below 2^24: adding and taking away again is exact.
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

    /// How far the top of a parabola through the scores is from the pixel, along each axis, within half a pixel.
    fn vertex(&self, at: usize, stride: usize) -> Vector2<f32> {
        let along = |step: usize| {
            let (before, own, after) = (self.scores[at - step], self.scores[at], self.scores[at + step]);
            let bend = before + after - 2.0 * own;
            if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
        };
        Vector2::new(along(1), along(stride))
    }
}

/// Products of the central differences in one row, from column `left` on.
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

/// Scores of one row from its products summed down the window, which still have to be summed across.
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
