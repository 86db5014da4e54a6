//! Planes of numbers, and the filters that a scale space is made of.

use crate::GrayImage;

/// A kernel reaches this many standard deviations to each side; beyond lie 0.3 % of its weight.
const KERNEL_SIGMAS: f32 = 3.0;

/// A grey image in floating point, row after row.
#[derive(Clone, Debug, Default)]
pub(super) struct Plane {
    /// Columns.
    pub(super) width: usize,
    /// Rows.
    pub(super) height: usize,
    /// `width * height` numbers.
    pub(super) data: Vec<f32>,
}

impl Plane {
    /// The grey levels of an image.
    pub(super) fn of_image(image: &GrayImage) -> Self {
        let data = image.pixels().iter().map(|&pixel| f32::from(pixel)).collect();
        Self { width: image.width(), height: image.height(), data }
    }

    /// The numbers of row `y`.
    pub(super) fn row(&self, y: usize) -> &[f32] {
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// Twice the pixels a side, interpolated; pixel `(x, y)` becomes `(2 x, 2 y)`.
    pub(super) fn doubled(&self) -> Self {
        let width = 2 * self.width;
        let mut data = Vec::with_capacity(4 * self.data.len());
        for y in 0..self.height {
            let here = self.row(y);
            let below = self.row((y + 1).min(self.height - 1));
            push_doubled(&mut data, here.iter().copied());
            push_doubled(&mut data, here.iter().zip(below).map(|(a, b)| 0.5 * (a + b)));
        }
        Self { width, height: 2 * self.height, data }
    }

    /// Every second pixel of every second row; pixel `(2 x, 2 y)` becomes `(x, y)`.
    pub(super) fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            data.extend(self.row(2 * y).chunks_exact(2).map(|pair| pair[0]));
        }
        Self { width, height, data }
    }

    /// `self - other`, number by number.
    pub(super) fn minus(&self, other: &Self) -> Self {
        let data = self.data.iter().zip(&other.data).map(|(a, b)| a - b).collect();
        Self { width: self.width, height: self.height, data }
    }

    /// Convolved with a Gaussian of standard deviation `sigma` pixels; the border repeats.
    pub(super) fn blurred(&self, sigma: f32) -> Self {
        let kernel = half_kernel(sigma);
        let radius = kernel.len() - 1;
        let last = self.height - 1;
        let mut padded = vec![0.0; self.width + 2 * radius];
        let mut data = vec![0.0; self.data.len()];
        for (y, out) in data.chunks_exact_mut(self.width).enumerate() {
            let column_sums = &mut padded[radius..radius + self.width];
            scale_row(column_sums, self.row(y), kernel[0]);
            for (k, &weight) in kernel.iter().enumerate().skip(1) {
                add_rows(column_sums, self.row(y.saturating_sub(k)), self.row((y + k).min(last)), weight);
            }
            let (first, end) = (padded[radius], padded[radius + self.width - 1]);
            padded[..radius].fill(first);
            padded[radius + self.width..].fill(end);
            scale_row(out, &padded[radius..], kernel[0]);
            for (k, &weight) in kernel.iter().enumerate().skip(1) {
                add_rows(out, &padded[radius - k..], &padded[radius + k..], weight);
            }
        }
        Self { width: self.width, height: self.height, data }
    }

    /// The value between four pixels; the border repeats. The plane must have two rows and columns.
    pub(super) fn bilinear(&self, x: f32, y: f32) -> f32 {
        let (x, y) = (x.clamp(0.0, (self.width - 1) as f32), y.clamp(0.0, (self.height - 1) as f32));
        let (column, row) = ((x as usize).min(self.width - 2), (y as usize).min(self.height - 2));
        let (fx, fy) = (x - column as f32, y - row as f32);
        let above = &self.data[row * self.width + column..];
        let (a, b, c, d) = (above[0], above[1], above[self.width], above[self.width + 1]);
        let (top, bottom) = (a + fx * (b - a), c + fx * (d - c));
        top + fy * (bottom - top)
    }
}

/// Appends a row and the means between its neighbours.
fn push_doubled(data: &mut Vec<f32>, mut row: impl Iterator<Item = f32>) {
    let Some(mut left) = row.next() else { return };
    for right in row {
        data.extend([left, 0.5 * (left + right)]);
        left = right;
    }
    data.extend([left, left]);
}

/// The centre and one side of a Gaussian kernel whose whole sums to 1.
fn half_kernel(sigma: f32) -> Vec<f32> {
    let radius = (KERNEL_SIGMAS * sigma).ceil() as usize;
    let mut kernel: Vec<f32> =
        (0..=radius).map(|k| (-0.5 * (k as f32 / sigma).powi(2)).exp()).collect();
    let sum = 2.0 * kernel.iter().sum::<f32>() - kernel[0];
    kernel.iter_mut().for_each(|weight| *weight /= sum);
    kernel
}

fn scale_row(out: &mut [f32], row: &[f32], weight: f32) {
    for (sum, &value) in out.iter_mut().zip(row) {
        *sum = weight * value;
    }
}

fn add_rows(out: &mut [f32], left: &[f32], right: &[f32], weight: f32) {
    for ((sum, &a), &b) in out.iter_mut().zip(left).zip(right) {
        *sum += weight * (a + b);
    }
}
