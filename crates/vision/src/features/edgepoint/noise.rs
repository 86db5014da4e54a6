//! Images of little light, in which noise is as strong as what they show, are smoothed before the network sees them: its first layers
//! have the resolution of the image and were trained on images without much noise.
//!
//! Noise over contrast (the standard deviations of both, grey levels) is 0.005 to 0.03 in the images of EuRoC and in rendered ones by day,
//! and 0.07 to 0.3 by night. Fine texture can have as much. But noise is white: its differences are as large from pixel to pixel as over two
//! pixels (0.5 in JPEG files by night, 0.95 before), those of texture are smaller (0.25 for one of 2 pixels; 0.28 to 0.32 by day).

use crate::image::{GrayImage, second_differences};
use pulp::{Arch, NullaryFnOnce};
use std::borrow::Cow;

/// From this noise over contrast on, an image is smoothed.
const MAX_NOISE: f64 = 0.05;
/// An image is smoothed only where its second differences from pixel to pixel are more than this part of those over two pixels.
const MIN_WHITENESS: f64 = 0.42;
/// The binomial kernel of six steps, in 64ths: a standard deviation of 1.22 pixels, which leaves a quarter of white noise.
const KERNEL: [u32; 7] = [1, 6, 15, 20, 15, 6, 1];
const REACH: usize = KERNEL.len() / 2;
/// Standard deviation of white noise over the mean magnitude of the second mixed differences, whose weights have the norm 6.
const DEVIATION_OF_MEAN: f64 = 1.253_314 / 6.0;

/// The image, smoothed where it is noisy.
pub(super) fn without_noise(image: &GrayImage) -> Cow<'_, GrayImage> {
    Arch::new().dispatch(Reduce(image))
}

struct Reduce<'a>(&'a GrayImage);

impl<'a> NullaryFnOnce for Reduce<'a> {
    type Output = Cow<'a, GrayImage>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        let is_noisy = noise_over_contrast(self.0) > MAX_NOISE && whiteness(self.0) > MIN_WHITENESS;
        if is_noisy { Cow::Owned(smoothed(self.0)) } else { Cow::Borrowed(self.0) }
    }
}

/// The sum of magnitudes of second mixed differences over one pixel as a part of those over two; 1 for white noise. Zero for an image
/// without any or of less than 5 by 5 pixels.
#[inline(always)]
fn whiteness(image: &GrayImage) -> f64 {
    let (width, height) = (image.width(), image.height());
    if width < 5 || height < 5 {
        return 0.0;
    }
    let mut columns = vec![0; width];
    let mut over = |step: usize| -> u64 {
        let rows = 2..height - 2;
        rows.map(|y| magnitudes([y - step, y, y + step].map(|y| image.row(y)), step, &mut columns)).sum()
    };
    let (one, two) = (over(1), over(2));
    if two > 0 { one as f64 / two as f64 } else { 0.0 }
}

/// Sum of the magnitudes of [`second_differences`].
#[inline(always)]
fn magnitudes(rows: [&[u8]; 3], step: usize, columns: &mut [i16]) -> u64 {
    let differences = second_differences(rows, step, columns);
    u64::from(differences.map(|difference| u32::from(difference.unsigned_abs())).sum::<u32>())
}

/// The standard deviation of white noise in an image over that of its grey levels. Zero for an image without contrast or of less than 3
/// by 3 pixels.
///
/// Source: Immerkaer, "Fast noise variance estimation", Computer Vision and Image Understanding 1996.
#[inline(always)]
fn noise_over_contrast(image: &GrayImage) -> f64 {
    let (width, height) = (image.width(), image.height());
    if width < 3 || height < 3 {
        return 0.0;
    }
    let (mut differences, mut sum, mut squares) = (0_u64, 0_u64, 0_u64);
    let mut columns = vec![0; width];
    for y in 1..height - 1 {
        let row = image.row(y);
        differences += magnitudes([image.row(y - 1), row, image.row(y + 1)], 1, &mut columns);
        sum += u64::from(row.iter().map(|&pixel| u32::from(pixel)).sum::<u32>());
        squares += u64::from(row.iter().map(|&pixel| u32::from(pixel) * u32::from(pixel)).sum::<u32>());
    }
    let rows = (height - 2) as f64;
    let count = width as f64 * rows;
    let mean = sum as f64 / count;
    let contrast = (squares as f64 / count - mean * mean).max(0.0).sqrt();
    let noise = DEVIATION_OF_MEAN * differences as f64 / ((width - 2) as f64 * rows);
    if contrast > 0.0 { noise / contrast } else { 0.0 }
}

/// An image convolved with [`KERNEL`] in both directions; the border is replicated.
#[inline(always)]
fn smoothed(image: &GrayImage) -> GrayImage {
    let (width, height) = (image.width(), image.height());
    let mut pixels = Vec::with_capacity(width * height);
    let mut sums = vec![0_u32; width + 2 * REACH];
    for y in 0..height {
        sums.fill(0);
        for (step, weight) in KERNEL.iter().enumerate() {
            let row = image.row((y + step).saturating_sub(REACH).min(height - 1));
            for (sum, &pixel) in sums[REACH..].iter_mut().zip(row) {
                *sum += weight * u32::from(pixel);
            }
        }
        let (first, last) = (sums[REACH], sums[REACH + width - 1]);
        sums[..REACH].fill(first);
        sums[REACH + width..].fill(last);
        let total =
            |window: &[u32]| -> u32 { window.iter().zip(KERNEL).map(|(sum, weight)| sum * weight).sum() };
        // The weights of both directions sum to 4096.
        pixels.extend(sums.windows(KERNEL.len()).map(|window| ((total(window) + 2048) >> 12) as u8));
    }
    GrayImage::from_parts(width, height, pixels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    /// Broad waves of a contrast, with noise (standard deviations, grey levels).
    fn waves(contrast: f64, noise: f64) -> GrayImage {
        let mut random = StdRng::seed_from_u64(7);
        GrayImage::from_fn(161, 97, |x, y| {
            let wave = (x as f64 / 9.0).sin() * (y as f64 / 7.0).cos();
            let normal: f64 = (0..12).map(|_| random.random::<f64>() - 0.5).sum();
            (100.0 + 2.0 * contrast * wave + noise * normal).round().clamp(0.0, 255.0) as u8
        })
    }

    fn mean_difference(a: &GrayImage, b: &GrayImage) -> f64 {
        let differences = a.pixels().iter().zip(b.pixels()).map(|(a, b)| f64::from(a.abs_diff(*b)));
        differences.sum::<f64>() / a.pixels().len() as f64
    }

    #[test]
    fn noise_is_measured_whatever_the_contrast() {
        for (contrast, noise) in [(40.0, 2.0), (40.0, 8.0), (10.0, 3.0)] {
            let total = f64::hypot(contrast, noise);
            let found = noise_over_contrast(&waves(contrast, noise));
            assert!((found * total / noise - 1.0).abs() < 0.1, "{contrast} {noise}: {found}");
        }
        assert!(noise_over_contrast(&GrayImage::from_fn(20, 20, |_, _| 9)).abs() < 1e-12);
        assert!(noise_over_contrast(&GrayImage::from_fn(2, 20, |_, y| y as u8)).abs() < 1e-12);
    }

    #[test]
    fn only_noisy_images_are_smoothed_and_are_nearer_to_what_they_show() {
        let clear = waves(40.0, 1.0);
        assert!(matches!(without_noise(&clear), Cow::Borrowed(_)));
        let (noisy, shown) = (waves(10.0, 4.0), waves(10.0, 0.0));
        let reduced = without_noise(&noisy);
        assert!(matches!(reduced, Cow::Owned(_)));
        assert!(mean_difference(&reduced, &shown) < 0.4 * mean_difference(&noisy, &shown));
    }

    #[test]
    fn fine_texture_is_no_noise() {
        let texture = GrayImage::from_fn(160, 120, |x, y| {
            (128.0 + 60.0 * (1.4 * x as f64).sin() * (1.3 * y as f64).sin()).round() as u8
        });
        assert!(noise_over_contrast(&texture) > MAX_NOISE);
        assert!(matches!(without_noise(&texture), Cow::Borrowed(_)));
    }

    #[test]
    fn smoothing_keeps_ramps_and_constant_images_up_to_their_border() {
        let constant = GrayImage::from_fn(9, 5, |_, _| 77);
        assert_eq!(smoothed(&constant), constant);
        let ramp = GrayImage::from_fn(40, 30, |x, y| (2 * x + 3 * y) as u8);
        let found = smoothed(&ramp);
        for (x, y) in (3..37).flat_map(|x| (3..27).map(move |y| (x, y))) {
            assert_eq!(found.get(x, y), ramp.get(x, y));
        }
        assert_eq!((smoothed(&GrayImage::from_fn(1, 1, |_, _| 5))).pixels(), [5]);
    }
}
