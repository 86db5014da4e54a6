//! The noise of an image, and the corners that stand out of it where light or contrast are low.

use super::corner::CornerOptions;
use crate::image::{GrayImage, second_differences};

/// Score of white noise of one grey level, about.
const SCORE_OF_NOISE: f32 = 0.3;
/// A corner of an image of little light has so many times the score of its noise.
const LEAST_OVER_NOISE: f32 = 2.0;
/// Smallest score of a corner in an image without noise: a patch of less has no position.
const LEAST_SCORE: f32 = 2.0;
/// So many rows are looked at in an image of any size.
const ROWS: usize = 60;
/// Second mixed differences have magnitudes up to this.
const MAX_MAGNITUDE: usize = 8 * 255;
/// Standard deviation of white noise over the median magnitude of its second mixed differences, whose weights have the norm 6.
const DEVIATION_OF_MEDIAN: f32 = 1.482_6 / 6.0;

impl CornerOptions {
    /// With the smallest score that stands out of the noise of an image, where that is less.
    pub(crate) fn for_little_light(self, image: &GrayImage) -> CornerOptions {
        let of_noise = LEAST_OVER_NOISE * SCORE_OF_NOISE * noise(image).powi(2);
        CornerOptions { min_score: self.min_score.min(of_noise.max(LEAST_SCORE)), ..self }
    }
}

/// Standard deviation of the white noise of an image, grey levels: by the median magnitude of second mixed differences, of which edges
/// and texture make few large. Zero for an image of less than 3 by 3 pixels.
///
/// The differences are those of Immerkaer, "Fast noise variance estimation", Computer Vision and Image Understanding 1996, who
/// takes their mean.
fn noise(image: &GrayImage) -> f32 {
    let (width, height) = (image.width(), image.height());
    if width < 3 || height < 3 {
        return 0.0;
    }
    let mut counts = [0_u32; MAX_MAGNITUDE + 1];
    let mut columns = vec![0_i16; width];
    let step = (height - 2).div_ceil(ROWS);
    for y in (1..height - 1).step_by(step) {
        for difference in second_differences([y - 1, y, y + 1].map(|y| image.row(y)), 1, &mut columns) {
            counts[usize::from(difference.unsigned_abs())] += 1;
        }
    }
    median(&counts) * DEVIATION_OF_MEDIAN
}

/// The median of whole numbers by their counts, as if each were spread evenly over the numbers that are rounded to it.
fn median(counts: &[u32]) -> f32 {
    let half = 0.5 * counts.iter().sum::<u32>() as f32;
    let mut below = 0.0;
    for (number, &count) in counts.iter().enumerate() {
        let count = count as f32;
        if count > 0.0 && below + count >= half {
            let (first, width) = if number == 0 { (0.0, 0.5) } else { (number as f32 - 0.5, 1.0) };
            return first + width * (half - below) / count;
        }
        below += count;
    }
    0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    /// Broad waves with noise, and a part that is covered with edges.
    fn waves(deviation: f32, edges: usize) -> GrayImage {
        let mut random = StdRng::seed_from_u64(7);
        GrayImage::from_fn(161, 97, |x, y| {
            let wave = 40.0 * (x as f32 / 9.0).sin() * (y as f32 / 7.0).cos();
            let edge = if x < edges && (x / 3 + y / 3) % 2 == 0 { 60.0 } else { 0.0 };
            let normal: f32 = (0..12).map(|_| random.random::<f32>() - 0.5).sum();
            (100.0 + wave + edge + deviation * normal).round().clamp(0.0, 255.0) as u8
        })
    }

    #[test]
    fn noise_is_measured_whatever_the_image_shows() {
        for deviation in [1.0, 2.5, 8.0] {
            for (edges, most) in [(0, 0.1), (40, 0.6)] {
                let found = noise(&waves(deviation, edges));
                assert!((-0.1..most).contains(&(found / deviation - 1.0)), "{deviation} {edges}: {found}");
            }
        }
    }

    #[test]
    fn images_without_noise_have_little() {
        // Rounding to grey levels has a deviation of 0.3.
        assert!(noise(&waves(0.0, 0)) < 0.4);
        assert!(noise(&GrayImage::from_fn(20, 20, |_, _| 9)) < 0.1);
        assert!(noise(&GrayImage::from_fn(2, 20, |_, y| y as u8)).abs() < 1e-9);
    }

    #[test]
    fn the_score_is_lowered_in_little_light_and_never_raised() {
        let options = CornerOptions::default();
        let score = |deviation: f32| options.for_little_light(&waves(deviation, 0)).min_score;
        assert!(score(0.0) < 3.0 && (2.0..8.0).contains(&score(2.5)));
        assert!((score(8.0) - options.min_score).abs() < 1e-6);
    }
}
