//! Gaussian image pyramids: the image at half, quarter, ... the resolution, low-pass filtered before subsampling.
//!
//! The centre of pixel `(x, y)` of level `l` is the centre of pixel `(x, y) * 2^l` of the image: pixel positions scale
//! by a factor of two from level to level, without offset.
//!
//! Source: Burt & Adelson, "The Laplacian pyramid as a compact image code", IEEE Trans. Communications 1983; the
//! kernel is its binomial one, `[1 4 6 4 1] / 16` in both directions.

use super::gray::GrayImage;
use pulp::{Arch, NullaryFnOnce};

/// Minimum width and height of a level, pixels: a tracked patch must fit.
const MIN_SIDE: usize = 16;

/// An image and its subsampled copies.
///
/// # Example
/// ```
/// let image = vision::GrayImage::from_fn(64, 48, |x, _| x as u8);
/// let pyramid = vision::Pyramid::new(image, 2);
/// assert_eq!(pyramid.levels(), 2);
/// assert_eq!((pyramid.level(1).width(), pyramid.level(1).height()), (32, 24));
/// assert_eq!(pyramid.level(1).get(10, 5), 20);
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pyramid {
    levels: Vec<GrayImage>,
}

impl Pyramid {
    /// Builds the pyramid with up to `levels` levels, the image itself included (at least one); fewer if the next level
    /// would have fewer than 16 columns or rows.
    pub fn new(image: GrayImage, levels: usize) -> Self {
        let mut all = vec![image];
        for level in 1..levels {
            let finer = &all[level - 1];
            if finer.width().min(finer.height()).div_ceil(2) < MIN_SIDE {
                break;
            }
            let coarser = halve(finer);
            all.push(coarser);
        }
        Self { levels: all }
    }

    /// Number of levels.
    pub fn levels(&self) -> usize {
        self.levels.len()
    }

    /// The image at level `level`; 0 is the image itself.
    ///
    /// # Panics
    /// If `level >= levels()`.
    pub fn level(&self, level: usize) -> &GrayImage {
        &self.levels[level]
    }

    /// The image itself.
    pub fn base(&self) -> &GrayImage {
        &self.levels[0]
    }
}

/// An image of half the size (rounded up): low-pass filtered, then every second pixel. Border pixels are replicated.
pub fn halve(image: &GrayImage) -> GrayImage {
    Arch::new().dispatch(Halve(image))
}

/// See [`halve`].
struct Halve<'a>(&'a GrayImage);

impl NullaryFnOnce for Halve<'_> {
    type Output = GrayImage;

    #[inline(always)]
    fn call(self) -> GrayImage {
        let Self(image) = self;
        let (width, height) = (image.width(), image.height());
        let (out_width, out_height) = (width.div_ceil(2), height.div_ceil(2));
        let mut pixels = vec![0; out_width * out_height];
        // One row of vertical sums with two replicated pixels on the left and on the right, to an even number.
        let mut sums = vec![0u16; 2 * out_width + 4];
        for (y, out) in pixels.chunks_exact_mut(out_width).enumerate() {
            let row = |offset: usize| image.row((2 * y + offset).saturating_sub(2).min(height - 1));
            add_rows([row(0), row(1), row(2), row(3), row(4)], &mut sums[2..width + 2]);
            let first = sums[2];
            sums[..2].fill(first);
            let last = sums[width + 1];
            sums[width + 2..].fill(last);
            let pairs = sums.as_chunks::<2>().0;
            let (before, own, after) = (&pairs[..out_width], &pairs[1..=out_width], &pairs[2..]);
            for (x, value) in out.iter_mut().enumerate() {
                let outer = before[x][0] + after[x][0];
                let inner = before[x][1] + own[x][1];
                *value = ((outer + 4 * inner + 6 * own[x][0] + 128) >> 8) as u8;
            }
        }
        GrayImage::from_parts(out_width, out_height, pixels)
    }
}

/// The vertical pass of the kernel: at most 16 * 255 per pixel.
#[inline(always)]
fn add_rows(rows: [&[u8]; 5], sums: &mut [u16]) {
    let n = sums.len();
    let [a, b, c, d, e] = rows.map(|row| &row[..n]);
    for x in 0..n {
        let outer = u16::from(a[x]) + u16::from(e[x]);
        let inner = u16::from(b[x]) + u16::from(d[x]);
        sums[x] = outer + 4 * inner + 6 * u16::from(c[x]);
    }
}
