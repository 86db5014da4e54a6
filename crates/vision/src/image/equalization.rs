//! Histogram equalization, global and local (CLAHE), so that corners are found in poor light.
//!
//! Source of the local variant (CLAHE): Zuiderveld, "Contrast limited adaptive histogram equalization",
//! Graphics Gems IV, 1994.

use super::gray::GrayImage;

/// Grey levels.
const LEVELS: usize = 256;
/// Fractional bits of the interpolation weights of [`equalize_locally`].
const WEIGHT_BITS: u32 = 7;

/// Contrast preprocessing of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Equalization {
    /// None.
    #[default]
    Off,
    /// One histogram for the whole image, see [`equalize`].
    Global,
    /// One histogram per tile with a contrast limit (CLAHE), see [`equalize_locally`].
    Local(LocalEqualization),
}

/// Settings of [`equalize_locally`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalEqualization {
    /// Tiles `[columns, rows]`.
    pub tiles: [usize; 2],
    /// Clip limit, as a multiple of the mean bin height: contrast grows by at most this factor.
    pub clip: f32,
}

impl Default for LocalEqualization {
    /// 8 x 5 tiles (square ones on a 752 x 480 image), contrast at most three times as large.
    fn default() -> Self {
        Self { tiles: [8, 5], clip: 3.0 }
    }
}

impl Equalization {
    /// Applies the setting to an image.
    pub fn apply(&self, image: GrayImage) -> GrayImage {
        match self {
            Self::Off => image,
            Self::Global => equalize_owned(image),
            Self::Local(options) => equalize_locally(&image, options),
        }
    }
}

/// Global histogram equalization.
///
/// The mapping of grey levels is monotonic; an image of one grey level is returned unchanged.
pub fn equalize(image: &GrayImage) -> GrayImage {
    equalize_owned(image.clone())
}

/// [`equalize`] in place.
fn equalize_owned(mut image: GrayImage) -> GrayImage {
    let histogram = histogram_of(image.pixels());
    let darkest = histogram.iter().copied().find(|count| *count > 0).unwrap_or(0);
    let rest = image.pixels().len() as u32 - darkest;
    if rest == 0 {
        return image;
    }
    let mut table = [0u8; LEVELS];
    let mut below = 0u32;
    for (level, count) in histogram.iter().enumerate() {
        below += count;
        let fraction = f64::from(below.saturating_sub(darkest)) / f64::from(rest);
        table[level] = (fraction * (LEVELS - 1) as f64).round() as u8;
    }
    for pixel in image.pixels_mut() {
        *pixel = table[usize::from(*pixel)];
    }
    image
}

/// Counts of the grey levels.
fn histogram_of(pixels: &[u8]) -> [u32; LEVELS] {
    /// Pixels counted apart: a count that was just written is read late, and neighbours are often equal.
    const APART: usize = 8;
    let mut histograms = [[0u32; LEVELS]; APART];
    let (groups, rest) = pixels.as_chunks::<APART>();
    for group in groups {
        for (histogram, pixel) in histograms.iter_mut().zip(group) {
            histogram[usize::from(*pixel)] += 1;
        }
    }
    let [mut sum, others @ ..] = histograms;
    for pixel in rest {
        sum[usize::from(*pixel)] += 1;
    }
    for other in &others {
        for (count, more) in sum.iter_mut().zip(other) {
            *count += more;
        }
    }
    sum
}

/// Contrast-limited adaptive histogram equalization (CLAHE).
///
/// Every tile has a lookup table from its clipped histogram; a pixel interpolates the tables of the four nearest tiles
/// bilinearly.
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
    let columns: Vec<TileInterpolation> =
        (0..width).map(|x| TileInterpolation::new(x, width, across)).collect();
    let mut pixels = Vec::with_capacity(width * height);
    for y in 0..height {
        let rows = TileInterpolation::new(y, height, down);
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

/// The two tiles between whose centres a row or column lies, with their weights in units of `2^-WEIGHT_BITS`.
#[derive(Clone, Copy)]
struct TileInterpolation {
    first: usize,
    second: usize,
    weights: [u32; 2],
}

impl TileInterpolation {
    fn new(at: usize, side: usize, tiles: usize) -> Self {
        let tile = (at as f32 + 0.5) * tiles as f32 / side as f32 - 0.5;
        let first = tile.max(0.0).floor() as usize;
        let second = (first + 1).min(tiles - 1);
        let one = 1u32 << WEIGHT_BITS;
        let weight = ((tile.max(0.0) - first as f32) * one as f32).round() as u32;
        Self { first, second, weights: [one - weight, weight] }
    }

    fn mix(&self, first: u8, second: u8) -> u32 {
        self.weights[0] * u32::from(first) + self.weights[1] * u32::from(second)
    }
}

/// The lookup table of one tile: cumulative histogram, with counts above the clip limit distributed over all levels.
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
        // The middle of the bin.
        let own = bin + excess / LEVELS as f32;
        *value = ((below + 0.5 * own) / pixels * (LEVELS - 1) as f32).round().min(255.0) as u8;
        below += own;
    }
    table
}
