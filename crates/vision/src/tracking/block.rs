//! The pixels that patches are sampled from.
//!
//! Where a patch is well inside the image they are those of the image. At its border they are a square block, copied once
//! with the border replicated. Warped samples are taken from a block in any case, in which a pixel and its neighbours are one
//! number.

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

/// Blocks of an image.
pub(super) struct Block {
    /// The pixels, the border of the image replicated; one row and one pixel more than a block.
    pixels: [u8; PIXELS + BLOCK + 1],
    /// Image coordinates of `pixels[0]`; `None` before anything of the present image is there.
    origin: Option<[i32; 2]>,
    /// The pixels with their neighbours, see [`Block::pack`].
    squares: [u32; PIXELS],
    /// Image coordinates of `squares[0]`; `None` before anything of the present image is there.
    squares_origin: Option<[i32; 2]>,
}

impl Block {
    pub(super) fn new() -> Self {
        Self { pixels: [0; PIXELS + BLOCK + 1], origin: None, squares: [0; PIXELS], squares_origin: None }
    }

    /// Forgets what was copied, before another image.
    #[inline(always)]
    pub(super) fn clear(&mut self) {
        self.origin = None;
        self.squares_origin = None;
    }

    /// The pixels of a grid of `size` samples per side, one pixel apart, whose first is at an image position; `None` if it
    /// is too far outside the image.
    ///
    /// `lanes`: samples that [`Grid::row`] is asked for.
    #[inline(always)]
    pub(super) fn grid<'a>(
        &'a mut self,
        image: &'a GrayImage,
        first: Vector2<f32>,
        size: usize,
        lanes: usize,
    ) -> Option<Grid<'a>> {
        let inside = [image.width(), image.height()];
        if let Some((at, fx, fy)) = corner([first.x, first.y], inside, lanes, image.width()) {
            return Some(Grid { pixels: image.pixels(), stride: image.width(), at, fx, fy });
        }
        let in_block = |origin: [i32; 2]| {
            let position = [first.x - origin[0] as f32, first.y - origin[1] as f32];
            corner(position, [BLOCK; 2], size, BLOCK)
        };
        if self.origin.and_then(in_block).is_none() {
            let centre = first.add_scalar(0.5 * (size - 1) as f32);
            self.load(image, origin_around(image, centre)?);
        }
        let (at, fx, fy) = in_block(self.origin?)?;
        Some(Grid { pixels: &self.pixels, stride: BLOCK, at, fx, fy })
    }

    /// Copies the block from `origin` on.
    #[inline(always)]
    fn load(&mut self, image: &GrayImage, origin: [i32; 2]) {
        let [left, top] = origin;
        let [width, height] = [image.width() as i32, image.height() as i32];
        self.origin = Some(origin);
        // Columns of the block that the image has.
        let before = (-left).clamp(0, BLOCK as i32);
        let end = (width - left).clamp(before, BLOCK as i32);
        let first = (left + before).clamp(0, width) as usize;
        let (before, end) = (before as usize, end as usize);
        for (y, out) in (top..).zip(self.pixels.chunks_exact_mut(BLOCK)) {
            let row = image.row(y.clamp(0, height - 1) as usize);
            out[..before].fill(row[0]);
            out[before..end].copy_from_slice(&row[first..first + end - before]);
            out[end..].fill(row[row.len() - 1]);
        }
    }

    /// Prepares [`Block::warped`] around `centre`: a number for each pixel with its right, lower and lower right neighbour in
    /// its bytes, so that a sample between them takes one access. `None` if the centre is too far outside the image.
    #[inline(always)]
    pub(super) fn pack(&mut self, image: &GrayImage, centre: Vector2<f32>) -> Option<()> {
        let origin = origin_around(image, centre)?;
        self.squares_origin = Some(origin);
        let [left, top] = origin;
        let last = |from: i32| from + BLOCK as i32;
        let whole = left >= 0 && top >= 0 && last(left) < image.width() as i32;
        if whole && last(top) < image.height() as i32 {
            let first = top as usize * image.width() + left as usize;
            pack_squares(&image.pixels()[first..], image.width(), &mut self.squares);
        } else {
            self.load(image, origin);
            pack_squares(&self.pixels, BLOCK, &mut self.squares);
        }
        Some(())
    }

    /// The samples of a patch whose grid is warped by `linear` and centred at `centre` (pixels); `None` if they leave what
    /// is packed.
    #[inline(always)]
    pub(super) fn warped(&self, centre: Vector2<f32>, linear: &Matrix2<f32>, out: &mut Patch) -> Option<()> {
        let [left, top] = self.squares_origin?;
        let (x, y) = (centre.x - left as f32, centre.y - top as f32);
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

/// Pixels of a grid of samples.
pub(super) struct Grid<'a> {
    pixels: &'a [u8],
    stride: usize,
    /// Index of the pixel at its upper left.
    at: usize,
    fx: f32,
    /// Weight of the lower of two rows.
    pub(super) fy: f32,
}

impl Grid<'_> {
    /// `N` samples one pixel apart in the `row`-th row of pixels, interpolated along the row only.
    #[inline(always)]
    pub(super) fn row<const N: usize>(&self, row: usize) -> [f32; N] {
        let pixels = &self.pixels[self.at + row * self.stride..][..=N];
        let mut out = [0.0; N];
        for i in 0..N {
            let (left, right) = (f32::from(pixels[i]), f32::from(pixels[i + 1]));
            out[i] = left + self.fx * (right - left);
        }
        out
    }
}

/// Index of the pixel before a position and the fractions beyond it; `None` if `length` samples and one more pixel do not fit
/// from there on.
#[inline(always)]
fn corner(
    [x, y]: [f32; 2],
    [width, height]: [usize; 2],
    length: usize,
    stride: usize,
) -> Option<(usize, f32, f32)> {
    let limit = |side: usize| side as f32 - length as f32 - 1.0;
    if !(x >= 0.0 && y >= 0.0 && x < limit(width) && y < limit(height)) {
        return None;
    }
    let (column, row) = (x as usize, y as usize);
    Some((row * stride + column, x - column as f32, y - row as f32))
}

/// The first pixel of a block around `centre`; `None` if that is not finite or far outside the image.
#[inline(always)]
fn origin_around(image: &GrayImage, centre: Vector2<f32>) -> Option<[i32; 2]> {
    const HALF_BLOCK: i32 = BLOCK as i32 / 2 - 1;
    let inside = |value: f32, side: usize| value >= -(BLOCK as f32) && value <= (side + BLOCK) as f32;
    (inside(centre.x, image.width()) && inside(centre.y, image.height()))
        .then(|| [centre.x.floor() as i32 - HALF_BLOCK, centre.y.floor() as i32 - HALF_BLOCK])
}

/// See [`Block::pack`]; the neighbours of the last column may be any.
#[inline(always)]
fn pack_squares(pixels: &[u8], stride: usize, squares: &mut [u32; PIXELS]) {
    for (y, out) in squares.as_chunks_mut::<BLOCK>().0.iter_mut().enumerate() {
        let upper = &pixels[y * stride..][..=BLOCK];
        let lower = &pixels[(y + 1) * stride..][..=BLOCK];
        for x in 0..BLOCK {
            let above = u32::from(upper[x]) | u32::from(upper[x + 1]) << 8;
            out[x] = above | u32::from(lower[x]) << 16 | u32::from(lower[x + 1]) << 24;
        }
    }
}
