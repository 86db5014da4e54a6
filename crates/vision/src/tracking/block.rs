//! A square block of an image in floating point, from which patches are sampled.
//!
//! Alignment samples the same few hundred pixels repeatedly. They are converted once, with the image border replicated,
//! so that every access lies inside a square of fixed size.

use crate::image::GrayImage;
use nalgebra::{Matrix2, Vector2};

/// Samples per side of a patch. Over rendered motions 97.0, 99.9 and 100 % of the points are within 0.2 px with
/// 12, 16 and 20; over warped EuRoC images 93, 96 and 97 %. An image takes 4.7, 6.2 and 10.1 ms.
pub(super) const SIDE: usize = 16;
/// Pixels per side of a block: the warped patch and a margin for it to move. A power of two.
const BLOCK: usize = 32;
/// Half the distance between the outer samples of a patch, pixels.
pub(super) const HALF: f32 = (SIDE as f32 - 1.0) / 2.0;

/// The samples of a patch, row after row.
pub(super) type Patch = [[f32; SIDE]; SIDE];

/// A square block of an image.
pub(super) struct Block {
    pixels: [f32; BLOCK * BLOCK],
    /// Image coordinates of `pixels[0]`.
    origin: [i32; 2],
}

impl Block {
    /// The block around `centre`; `None` if the centre is not finite or far outside the image.
    pub(super) fn around(image: &GrayImage, centre: Vector2<f32>) -> Option<Self> {
        let [width, height] = [image.width() as i32, image.height() as i32];
        let inside =
            |value: f32, side: i32| value >= -(BLOCK as f32) && value <= (side + BLOCK as i32) as f32;
        if !(inside(centre.x, width) && inside(centre.y, height)) {
            return None;
        }
        let half = BLOCK as i32 / 2 - 1;
        let origin = [centre.x.floor() as i32 - half, centre.y.floor() as i32 - half];
        let mut pixels = [0.0; BLOCK * BLOCK];
        let whole = origin[0] >= 0 && origin[0] + BLOCK as i32 <= width;
        for (y, out) in (origin[1]..).zip(pixels.chunks_exact_mut(BLOCK)) {
            let row = image.row(y.clamp(0, height - 1) as usize);
            if whole {
                let from = &row[origin[0] as usize..origin[0] as usize + BLOCK];
                for (value, pixel) in out.iter_mut().zip(from) {
                    *value = f32::from(*pixel);
                }
            } else {
                for (x, value) in (origin[0]..).zip(out) {
                    *value = f32::from(row[x.clamp(0, width - 1) as usize]);
                }
            }
        }
        Some(Self { pixels, origin })
    }

    /// `N` x `N` samples one pixel apart, the first at the pixel position `first` (bilinear); `None` if they leave
    /// the block.
    #[inline]
    pub(super) fn grid<const N: usize>(&self, first: Vector2<f32>) -> Option<[[f32; N]; N]> {
        let x = first.x - self.origin[0] as f32;
        let y = first.y - self.origin[1] as f32;
        let limit = (BLOCK - N - 1) as f32;
        if !(x >= 0.0 && y >= 0.0 && x < limit && y < limit) {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let mut out = [[0.0; N]; N];
        // Vertical interpolation of N + 1 samples first.
        let mut blended = [0.0f32; BLOCK];
        for (k, samples) in out.iter_mut().enumerate() {
            let at = (row + k) * BLOCK + column;
            let upper = &self.pixels[at..=at + N];
            let lower = &self.pixels[at + BLOCK..=at + BLOCK + N];
            for (value, (a, b)) in blended[..=N].iter_mut().zip(upper.iter().zip(lower)) {
                *value = a + fy * (b - a);
            }
            for (i, sample) in samples.iter_mut().enumerate() {
                *sample = blended[i] + fx * (blended[i + 1] - blended[i]);
            }
        }
        Some(out)
    }

    /// The samples of a patch whose grid is warped by `linear` and centred at `centre` (pixels); `None` if they leave the
    /// block.
    #[inline]
    pub(super) fn warped(&self, centre: Vector2<f32>, linear: &Matrix2<f32>) -> Option<Patch> {
        let x = centre.x - self.origin[0] as f32;
        let y = centre.y - self.origin[1] as f32;
        let reach_x = HALF * (linear.m11.abs() + linear.m12.abs());
        let reach_y = HALF * (linear.m21.abs() + linear.m22.abs());
        let limit = (BLOCK - 2) as f32;
        if !(x - reach_x >= 0.0 && y - reach_y >= 0.0 && x + reach_x < limit && y + reach_y < limit) {
            return None;
        }
        let mut out = [[0.0; SIDE]; SIDE];
        for (k, samples) in out.iter_mut().enumerate() {
            let down = k as f32 - HALF;
            let row_x = x + linear.m12 * down - linear.m11 * HALF;
            let row_y = y + linear.m22 * down - linear.m21 * HALF;
            let mut at = [0usize; SIDE];
            let mut fractions = [[0.0f32; SIDE]; 2];
            for i in 0..SIDE {
                let sample_x = row_x + linear.m11 * i as f32;
                let sample_y = row_y + linear.m21 * i as f32;
                let (column, row) = (sample_x as i32, sample_y as i32);
                fractions[0][i] = sample_x - column as f32;
                fractions[1][i] = sample_y - row as f32;
                at[i] = (row * BLOCK as i32 + column) as usize;
            }
            for (i, sample) in samples.iter_mut().enumerate() {
                let pixel = |offset: usize| self.pixels[(at[i] + offset) & (BLOCK * BLOCK - 1)];
                let (fx, fy) = (fractions[0][i], fractions[1][i]);
                let upper = pixel(0) + fx * (pixel(1) - pixel(0));
                let lower = pixel(BLOCK) + fx * (pixel(BLOCK + 1) - pixel(BLOCK));
                *sample = upper + fy * (lower - upper);
            }
        }
        Some(out)
    }
}

/// Scalar product of two patches. Sixteen independent sums, which the compiler vectorizes.
#[inline]
pub(super) fn dot(a: &Patch, b: &Patch) -> f32 {
    let mut sums = [0.0f32; SIDE];
    for (row_a, row_b) in a.iter().zip(b) {
        for i in 0..SIDE {
            sums[i] += row_a[i] * row_b[i];
        }
    }
    sums.iter().sum()
}

/// Mean of the samples.
#[inline]
pub(super) fn mean(patch: &Patch) -> f32 {
    let mut sums = [0.0f32; SIDE];
    for row in patch {
        for i in 0..SIDE {
            sums[i] += row[i];
        }
    }
    sums.iter().sum::<f32>() / (SIDE * SIDE) as f32
}

/// `target - factor * other`, sample by sample.
#[inline]
pub(super) fn subtract(target: &mut Patch, factor: f32, other: &Patch) {
    for (row, row_other) in target.iter_mut().zip(other) {
        for i in 0..SIDE {
            row[i] -= factor * row_other[i];
        }
    }
}

/// Subtracts the mean from every sample.
#[inline]
pub(super) fn centre(patch: &mut Patch) {
    let mean = mean(patch);
    for row in patch {
        for value in row {
            *value -= mean;
        }
    }
}
