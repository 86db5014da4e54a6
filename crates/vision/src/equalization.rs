//! Histogram equalization: grey levels spread over the whole range, so that corners in poor light are seen.
//!
//! Source of the local variant (CLAHE): Zuiderveld, "Contrast limited adaptive histogram equalization",
//! Graphics Gems IV, 1994.

use crate::image::GrayImage;

/// Grey levels.
const LEVELS: usize = 256;
/// Fractional bits of the interpolation weights of [`equalize_locally`].
const WEIGHT_BITS: u32 = 7;

/// What is done to an image before anything is sought in it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Equalization {
    /// Nothing.
    #[default]
    Off,
    /// One histogram for the whole image, see [`equalize`].
    Global,
    /// One histogram a tile, with a limit on the contrast, see [`equalize_locally`].
    Local(LocalEqualization),
}

/// Settings of [`equalize_locally`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalEqualization {
    /// Tiles across and down.
    pub tiles: [usize; 2],
    /// The most by which contrast grows: a bin holds at most this many times the pixels of an even histogram.
    pub clip: f32,
}

impl Default for LocalEqualization {
    /// 8 x 5 tiles (square ones on a 752 x 480 image), contrast at most three times as large.
    fn default() -> Self {
        Self { tiles: [8, 5], clip: 3.0 }
    }
}

impl Equalization {
    /// The image as this setting wants it.
    pub fn apply(&self, image: GrayImage) -> GrayImage {
        match self {
            Self::Off => image,
            Self::Global => equalize(&image),
            Self::Local(options) => equalize_locally(&image, options),
        }
    }
}

/// Spreads the grey levels so that each part of the range holds as many pixels as any other.
///
/// A brighter pixel never becomes darker than one that it outshone; an image of one grey level stays as it is.
pub fn equalize(image: &GrayImage) -> GrayImage {
    let mut histogram = [0u32; LEVELS];
    for pixel in image.pixels() {
        histogram[usize::from(*pixel)] += 1;
    }
    let darkest = histogram.iter().copied().find(|count| *count > 0).unwrap_or(0);
    let rest = image.pixels().len() as u32 - darkest;
    if rest == 0 {
        return image.clone();
    }
    let mut table = [0u8; LEVELS];
    let mut below = 0u32;
    for (level, count) in histogram.iter().enumerate() {
        below += count;
        let share = f64::from(below.saturating_sub(darkest)) / f64::from(rest);
        table[level] = (share * (LEVELS - 1) as f64).round() as u8;
    }
    let pixels = image.pixels().iter().map(|pixel| table[usize::from(*pixel)]).collect();
    GrayImage::from_parts(image.width(), image.height(), pixels)
}

/// Equalizes every part of the image by the histogram of its surroundings, without raising contrast (and noise)
/// by more than a limit.
///
/// The image is cut into tiles; each has a table of its own, and a pixel takes the tables of the four tiles around
/// it, by distance.
pub fn equalize_locally(image: &GrayImage, options: &LocalEqualization) -> GrayImage {
    let (width, height) = (image.width(), image.height());
    let across = options.tiles[0].clamp(1, width);
    let down = options.tiles[1].clamp(1, height);
    let mut tables = Vec::with_capacity(across * down);
    for row in 0..down {
        for column in 0..across {
            let x = column * width / across..(column + 1) * width / across;
            let y = row * height / down..(row + 1) * height / down;
            tables.push(clipped_table(image, x, y, options.clip));
        }
    }
    let columns: Vec<Between> = (0..width).map(|x| Between::new(x, width, across)).collect();
    let mut pixels = Vec::with_capacity(width * height);
    for y in 0..height {
        let rows = Between::new(y, height, down);
        let upper = &tables[rows.first * across..(rows.first + 1) * across];
        let lower = &tables[rows.second * across..(rows.second + 1) * across];
        pixels.extend(image.row(y).iter().zip(&columns).map(|(pixel, at)| {
            let level = usize::from(*pixel);
            let top = at.mix(upper[at.first][level], upper[at.second][level]);
            let bottom = at.mix(lower[at.first][level], lower[at.second][level]);
            let sum = top * rows.weights[0] + bottom * rows.weights[1];
            ((sum + (1 << (2 * WEIGHT_BITS - 1))) >> (2 * WEIGHT_BITS)) as u8
        }));
    }
    GrayImage::from_parts(width, height, pixels)
}

/// The two tiles between whose centres a row or column lies, with their weights in `2^-WEIGHT_BITS`.
#[derive(Clone, Copy)]
struct Between {
    first: usize,
    second: usize,
    weights: [u32; 2],
}

impl Between {
    fn new(at: usize, side: usize, tiles: usize) -> Self {
        let tile = (at as f32 + 0.5) * tiles as f32 / side as f32 - 0.5;
        let first = tile.max(0.0).floor() as usize;
        let second = (first + 1).min(tiles - 1);
        let one = 1u32 << WEIGHT_BITS;
        let share = ((tile.max(0.0) - first as f32) * one as f32).round() as u32;
        Self { first, second, weights: [one - share, share] }
    }

    fn mix(&self, first: u8, second: u8) -> u32 {
        self.weights[0] * u32::from(first) + self.weights[1] * u32::from(second)
    }
}

/// The table of one tile: its cumulated histogram, with what exceeds the limit spread over all levels.
fn clipped_table(
    image: &GrayImage,
    x: std::ops::Range<usize>,
    y: std::ops::Range<usize>,
    clip: f32,
) -> [u8; LEVELS] {
    let mut histogram = [0f32; LEVELS];
    let mut counts = [0u32; LEVELS];
    let pixels = (x.len() * y.len()) as f32;
    for row in y {
        for pixel in &image.row(row)[x.clone()] {
            counts[usize::from(*pixel)] += 1;
        }
    }
    let limit = clip.max(1.0) * pixels / LEVELS as f32;
    let mut excess = 0.0;
    for (bin, count) in histogram.iter_mut().zip(counts) {
        *bin = (count as f32).min(limit);
        excess += count as f32 - *bin;
    }
    let mut table = [0u8; LEVELS];
    let mut below = 0.0;
    for (value, bin) in table.iter_mut().zip(histogram) {
        // The middle of the bin, so that black stays black only if black is all there is below.
        let own = bin + excess / LEVELS as f32;
        *value = ((below + 0.5 * own) / pixels * (LEVELS - 1) as f32).round().min(255.0) as u8;
        below += own;
    }
    table
}
