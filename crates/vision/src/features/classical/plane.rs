//! Images in floating point and the filters of the scale space.

use crate::image::GrayImage;
use pulp::{Arch, NullaryFnOnce};

/// Kernel radius in standard deviations; 0.3 % of the weight is beyond.
const KERNEL_SIGMAS: f32 = 3.0;
/// Maximum radius of a kernel, pixels: above that of the last level of an octave.
const MAX_RADIUS: usize = 12;
/// Columns summed in parallel.
const LANES: usize = 32;

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
    pub(super) fn blur(&mut self, other: &Self, sigma: f32, difference: Option<&mut Self>) {
        self.resize(other.width, other.height);
        let mut none = Self::default();
        let difference = match difference {
            Some(difference) => {
                difference.resize(other.width, other.height);
                difference
            }
            None => &mut none,
        };
        let kernel = half_kernel(sigma);
        Arch::new().dispatch(Blur { result: self, difference, other, kernel: &kernel });
    }

    fn resize(&mut self, width: usize, height: usize) {
        (self.width, self.height) = (width, height);
        self.data.resize(width * height, 0.0);
    }

    /// Bilinear interpolation at the first `wanted` of `N` places; the border is replicated. The plane must have at least two
    /// rows and columns.
    #[inline(always)]
    pub(super) fn bilinear<const N: usize>(
        &self,
        xs: &[f32; N],
        ys: &[f32; N],
        wanted: usize,
        out: &mut [f32; N],
    ) {
        let [right, bottom] = [(self.width - 1) as f32, (self.height - 1) as f32];
        let (width, last_column, last_row) =
            (self.width as i32, self.width as i32 - 2, self.height as i32 - 2);
        let mut corners = [0i32; N];
        let mut fractions = [[0.0f32; N]; 2];
        for k in 0..N {
            let (x, y) = (xs[k].max(0.0).min(right), ys[k].max(0.0).min(bottom));
            let (column, row) = ((x as i32).min(last_column), (y as i32).min(last_row));
            fractions[0][k] = x - column as f32;
            fractions[1][k] = y - row as f32;
            corners[k] = row * width + column;
        }
        let mut squares = [[0.0f32; N]; 4];
        for k in 0..wanted.min(N) {
            let above = &self.data[corners[k] as usize..];
            let below = &above[self.width..self.width + 2];
            let above = &above[..2];
            (squares[0][k], squares[1][k]) = (above[0], above[1]);
            (squares[2][k], squares[3][k]) = (below[0], below[1]);
        }
        let [a, b, c, d] = &squares;
        let [fx, fy] = &fractions;
        for k in 0..N {
            let (top, bottom) = (a[k] + fx[k] * (b[k] - a[k]), c[k] + fx[k] * (d[k] - c[k]));
            out[k] = top + fy[k] * (bottom - top);
        }
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
    let radius = ((KERNEL_SIGMAS * sigma).ceil() as usize).min(MAX_RADIUS);
    let mut kernel: Vec<f32> = (0..=radius).map(|k| (-0.5 * (k as f32 / sigma).powi(2)).exp()).collect();
    let sum = 2.0 * kernel.iter().sum::<f32>() - kernel[0];
    for weight in &mut kernel {
        *weight /= sum;
    }
    kernel
}

/// See [`Plane::blur`].
struct Blur<'a> {
    result: &'a mut Plane,
    /// Without rows if it is not wanted.
    difference: &'a mut Plane,
    other: &'a Plane,
    kernel: &'a [f32],
}

impl NullaryFnOnce for Blur<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { result, difference, other, kernel } = self;
        let (width, last) = (other.width, other.height - 1);
        let radius = kernel.len() - 1;
        let mut padded = vec![0.0; width + 2 * radius];
        for y in 0..other.height {
            let mut pairs = [[&[][..]; 2]; MAX_RADIUS];
            for (k, pair) in pairs[..radius].iter_mut().enumerate() {
                *pair = [other.row(y.saturating_sub(k + 1)), other.row((y + k + 1).min(last))];
            }
            weighted_sum(&mut padded[radius..radius + width], other.row(y), &pairs[..radius], kernel);
            let (first, end) = (padded[radius], padded[radius + width - 1]);
            padded[..radius].fill(first);
            padded[radius + width..].fill(end);
            for (k, pair) in pairs[..radius].iter_mut().enumerate() {
                *pair = [radius - k - 1, radius + k + 1].map(|from| &padded[from..from + width]);
            }
            let out = &mut result.data[y * width..(y + 1) * width];
            weighted_sum(out, &padded[radius..radius + width], &pairs[..radius], kernel);
            if difference.height > 0 {
                let row = &mut difference.data[y * width..(y + 1) * width];
                for ((number, after), before) in row.iter_mut().zip(out).zip(other.row(y)) {
                    *number = *after - before;
                }
            }
        }
    }
}

/// `out = kernel[0] * centre + sum of kernel[k + 1] * (a + b)` for the `k`-th pair of rows `a`, `b`.
///
/// Blocked for registers: every row is read once, `out` written once.
#[inline(always)]
fn weighted_sum(out: &mut [f32], centre: &[f32], pairs: &[[&[f32]; 2]], kernel: &[f32]) {
    let mut start = 0;
    let (blocks, rest) = out.as_chunks_mut::<LANES>();
    for block in blocks {
        let end = start + LANES;
        let mut sums = [0.0; LANES];
        for (sum, value) in sums.iter_mut().zip(&centre[start..end]) {
            *sum = kernel[0] * value;
        }
        for ([left, right], &weight) in pairs.iter().zip(&kernel[1..]) {
            for ((sum, a), b) in sums.iter_mut().zip(&left[start..end]).zip(&right[start..end]) {
                *sum += weight * (a + b);
            }
        }
        *block = sums;
        start = end;
    }
    for (x, number) in (start..).zip(rest) {
        *number = kernel[0] * centre[x];
        for ([left, right], &weight) in pairs.iter().zip(&kernel[1..]) {
            *number += weight * (left[x] + right[x]);
        }
    }
}
