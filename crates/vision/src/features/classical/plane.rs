//! Images in floating point and the filters of the scale space.

use crate::image::GrayImage;

/// Kernel radius in standard deviations; 0.3 % of the weight is beyond.
const KERNEL_SIGMAS: f32 = 3.0;
/// Columns summed in parallel.
const LANES: usize = 16;

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
    /// Copies the grey levels of an image.
    pub(super) fn copy_image(&mut self, image: &GrayImage) {
        (self.width, self.height) = (image.width(), image.height());
        self.data.clear();
        self.data.extend(image.pixels().iter().map(|&pixel| f32::from(pixel)));
    }

    /// The numbers of row `y`.
    pub(super) fn row(&self, y: usize) -> &[f32] {
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// Sets to `other` upsampled by two with interpolation; pixel `(x, y)` becomes `(2 x, 2 y)`.
    pub(super) fn double(&mut self, other: &Self) {
        (self.width, self.height) = (2 * other.width, 2 * other.height);
        self.data.clear();
        for y in 0..other.height {
            let here = other.row(y);
            let below = other.row((y + 1).min(other.height - 1));
            push_doubled(&mut self.data, here.iter().copied());
            push_doubled(&mut self.data, here.iter().zip(below).map(|(a, b)| 0.5 * (a + b)));
        }
    }

    /// Sets to every second pixel of every second row of `other`; pixel `(2 x, 2 y)` becomes `(x, y)`.
    pub(super) fn halve(&mut self, other: &Self) {
        (self.width, self.height) = (other.width / 2, other.height / 2);
        self.data.clear();
        for y in 0..self.height {
            self.data.extend(other.row(2 * y).chunks_exact(2).map(|pair| pair[0]));
        }
    }

    /// Sets to `other` convolved with a Gaussian of standard deviation `sigma` pixels; the border is replicated.
    ///
    /// # Arguments
    /// * `difference`: set to the result minus `other`.
    pub(super) fn blur(&mut self, other: &Self, sigma: f32, mut difference: Option<&mut Self>) {
        let (width, last) = (other.width, other.height - 1);
        let kernel = half_kernel(sigma);
        let radius = kernel.len() - 1;
        self.resize(width, other.height);
        if let Some(difference) = &mut difference {
            difference.resize(width, other.height);
        }
        let mut padded = vec![0.0; width + 2 * radius];
        for y in 0..other.height {
            weighted_sum(&mut padded[radius..radius + width], other.row(y), &kernel, |k| {
                (other.row(y.saturating_sub(k)), other.row((y + k).min(last)))
            });
            let (first, end) = (padded[radius], padded[radius + width - 1]);
            padded[..radius].fill(first);
            padded[radius + width..].fill(end);
            let out = &mut self.data[y * width..(y + 1) * width];
            weighted_sum(out, &padded[radius..], &kernel, |k| (&padded[radius - k..], &padded[radius + k..]));
            if let Some(difference) = &mut difference {
                let row = &mut difference.data[y * width..(y + 1) * width];
                for ((number, after), before) in row.iter_mut().zip(out).zip(other.row(y)) {
                    *number = *after - before;
                }
            }
        }
    }

    fn resize(&mut self, width: usize, height: usize) {
        (self.width, self.height) = (width, height);
        self.data.resize(width * height, 0.0);
    }

    /// Bilinear interpolation; the border is replicated. The plane must have at least two rows and columns.
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

/// Appends a row with the means of neighbours in between.
fn push_doubled(data: &mut Vec<f32>, mut row: impl Iterator<Item = f32>) {
    let Some(mut left) = row.next() else { return };
    for right in row {
        data.extend([left, 0.5 * (left + right)]);
        left = right;
    }
    data.extend([left, left]);
}

/// Centre and one side of a normalized Gaussian kernel.
fn half_kernel(sigma: f32) -> Vec<f32> {
    let radius = (KERNEL_SIGMAS * sigma).ceil() as usize;
    let mut kernel: Vec<f32> = (0..=radius).map(|k| (-0.5 * (k as f32 / sigma).powi(2)).exp()).collect();
    let sum = 2.0 * kernel.iter().sum::<f32>() - kernel[0];
    for weight in &mut kernel {
        *weight /= sum;
    }
    kernel
}

/// `out = kernel[0] * centre + sum of kernel[k] * (a + b)` for the two rows `a`, `b` that `pair` gives for `k` from 1 on.
///
/// Blocked for registers: every row is read once, `out` written once.
fn weighted_sum<'a>(
    out: &mut [f32],
    centre: &[f32],
    kernel: &[f32],
    pair: impl Fn(usize) -> (&'a [f32], &'a [f32]),
) {
    let mut start = 0;
    let (blocks, rest) = out.as_chunks_mut::<LANES>();
    for block in blocks {
        let end = start + LANES;
        let mut sums = [0.0; LANES];
        for (sum, value) in sums.iter_mut().zip(&centre[start..end]) {
            *sum = kernel[0] * value;
        }
        for (k, &weight) in kernel.iter().enumerate().skip(1) {
            let (left, right) = pair(k);
            for ((sum, a), b) in sums.iter_mut().zip(&left[start..end]).zip(&right[start..end]) {
                *sum += weight * (a + b);
            }
        }
        *block = sums;
        start = end;
    }
    for (x, number) in (start..).zip(rest) {
        *number = kernel[0] * centre[x];
        for (k, &weight) in kernel.iter().enumerate().skip(1) {
            let (left, right) = pair(k);
            *number += weight * (left[x] + right[x]);
        }
    }
}
