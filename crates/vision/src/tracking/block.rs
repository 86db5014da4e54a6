//! A square block of an image, from which patches are sampled.
//!
//! Alignment samples the same few hundred pixels repeatedly. They are copied once, with the image border replicated, so that
//! every access lies inside a square of fixed size.

use super::patch::{HALF, Patch, SIDE};
use crate::image::GrayImage;
use nalgebra::{Matrix2, Vector2};

/// Pixels per side of a block: the warped patch and a margin for it to move. A power of two.
const BLOCK: usize = 32;
/// Pixels of a block.
const PIXELS: usize = BLOCK * BLOCK;
/// Fractional bits of the positions of warped samples.
const FRACTION_BITS: u32 = 20;
/// One pixel in these units.
const ONE: f32 = (1u32 << FRACTION_BITS) as f32;

/// A square block of an image.
pub(super) struct Block {
    pixels: [u8; PIXELS],
    /// Image coordinates of `pixels[0]`.
    origin: [i32; 2],
    /// The pixels with their neighbours, see [`Block::pack`].
    squares: [u32; PIXELS],
}

impl Block {
    pub(super) fn new() -> Self {
        Self { pixels: [0; PIXELS], origin: [0; 2], squares: [0; PIXELS] }
    }

    /// Copies the block around `centre`; `None` if the centre is not finite or far outside the image.
    #[inline(always)]
    pub(super) fn load(&mut self, image: &GrayImage, centre: Vector2<f32>) -> Option<()> {
        let [width, height] = [image.width() as i32, image.height() as i32];
        let inside =
            |value: f32, side: i32| value >= -(BLOCK as f32) && value <= (side + BLOCK as i32) as f32;
        if !(inside(centre.x, width) && inside(centre.y, height)) {
            return None;
        }
        let half = BLOCK as i32 / 2 - 1;
        let [left, top] = [centre.x.floor() as i32 - half, centre.y.floor() as i32 - half];
        self.origin = [left, top];
        let whole = left >= 0 && left + BLOCK as i32 <= width;
        for (y, out) in (top..).zip(self.pixels.as_chunks_mut::<BLOCK>().0) {
            let row = image.row(y.clamp(0, height - 1) as usize);
            if whole {
                out.copy_from_slice(&row[left as usize..left as usize + BLOCK]);
            } else {
                for (x, pixel) in (left..).zip(out) {
                    *pixel = row[x.clamp(0, width - 1) as usize];
                }
            }
        }
        Some(())
    }

    /// Prepares [`Block::warped`]: a number for each pixel with its right, lower and lower right neighbour in its bytes,
    /// so that a sample between them takes one access.
    #[inline(always)]
    pub(super) fn pack(&mut self) {
        const LAST: usize = PIXELS - BLOCK - 1;
        let here = &self.pixels[..LAST];
        let right = &self.pixels[1..=LAST];
        let lower = &self.pixels[BLOCK..BLOCK + LAST];
        let lower_right = &self.pixels[BLOCK + 1..];
        for (at, square) in self.squares[..LAST].iter_mut().enumerate() {
            let upper = u32::from(here[at]) | u32::from(right[at]) << 8;
            *square = upper | u32::from(lower[at]) << 16 | u32::from(lower_right[at]) << 24;
        }
    }

    /// Where a grid of `size` samples per side lies whose first is at an image position; `None` if it leaves the block.
    #[inline(always)]
    pub(super) fn cell(&self, first: Vector2<f32>, size: usize) -> Option<Cell> {
        let x = first.x - self.origin[0] as f32;
        let y = first.y - self.origin[1] as f32;
        let limit = (BLOCK - size - 1) as f32;
        if !(x >= 0.0 && y >= 0.0 && x < limit && y < limit) {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        Some(Cell { at: row * BLOCK + column, fx: x - column as f32, fy: y - row as f32 })
    }

    /// `N` samples one pixel apart in the `row`-th row of pixels below `cell`, interpolated along the row only.
    #[inline(always)]
    pub(super) fn row<const N: usize>(&self, cell: &Cell, row: usize) -> [f32; N] {
        let at = cell.at + row * BLOCK;
        let pixels = &self.pixels[at..=at + N];
        let mut out = [0.0; N];
        for i in 0..N {
            let (left, right) = (f32::from(pixels[i]), f32::from(pixels[i + 1]));
            out[i] = left + cell.fx * (right - left);
        }
        out
    }

    /// The samples of a patch whose grid is warped by `linear` and centred at `centre` (pixels); `None` if they leave the
    /// block. It must be packed.
    #[inline(always)]
    pub(super) fn warped(&self, centre: Vector2<f32>, linear: &Matrix2<f32>, out: &mut Patch) -> Option<()> {
        let x = centre.x - self.origin[0] as f32;
        let y = centre.y - self.origin[1] as f32;
        let reach_x = HALF * (linear.m11.abs() + linear.m12.abs());
        let reach_y = HALF * (linear.m21.abs() + linear.m22.abs());
        let limit = (BLOCK - 2) as f32;
        if !(x - reach_x >= 0.0 && y - reach_y >= 0.0 && x + reach_x < limit && y + reach_y < limit) {
            return None;
        }
        let step = [(linear.m11 * ONE) as i32, (linear.m21 * ONE) as i32];
        for (k, samples) in out.iter_mut().enumerate() {
            let down = k as f32 - HALF;
            let row_x = x + linear.m12 * down - linear.m11 * HALF;
            let row_y = y + linear.m22 * down - linear.m21 * HALF;
            *samples = self.warped_row([(row_x * ONE) as i32, (row_y * ONE) as i32], step);
        }
        Some(())
    }

    /// Samples (bilinear) from `start` on, `step` apart, in units of `2^-FRACTION_BITS` pixels of the block.
    #[inline(always)]
    fn warped_row(&self, start: [i32; 2], step: [i32; 2]) -> [f32; SIDE] {
        const MASK: i32 = (1 << FRACTION_BITS) - 1;
        let mut at = [0i32; SIDE];
        let mut fractions = [[0.0f32; SIDE]; 2];
        for i in 0..SIDE {
            let x = start[0] + step[0] * i as i32;
            let y = start[1] + step[1] * i as i32;
            at[i] = (y >> FRACTION_BITS) * BLOCK as i32 + (x >> FRACTION_BITS);
            fractions[0][i] = (x & MASK) as f32 * (1.0 / ONE);
            fractions[1][i] = (y & MASK) as f32 * (1.0 / ONE);
        }
        let mut squares = [0u32; SIDE];
        for i in 0..SIDE {
            squares[i] = self.squares[at[i] as usize & (PIXELS - 1)];
        }
        let mut out = [0.0; SIDE];
        for i in 0..SIDE {
            let pixel = |shift: u32| (squares[i] >> shift & 255) as i32 as f32;
            let (fx, fy) = (fractions[0][i], fractions[1][i]);
            let upper = pixel(0) + fx * (pixel(8) - pixel(0));
            let lower = pixel(16) + fx * (pixel(24) - pixel(16));
            out[i] = upper + fy * (lower - upper);
        }
        out
    }
}

/// A position in a block.
pub(super) struct Cell {
    /// Index of the pixel at its upper left.
    at: usize,
    fx: f32,
    /// Weight of the lower of two rows.
    pub(super) fy: f32,
}
