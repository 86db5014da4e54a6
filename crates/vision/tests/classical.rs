//! Laws of the classical extractor, on rendered scenes.

use rand::{RngExt, SeedableRng, rngs::StdRng};
use vision::features::classical::{SiftExtractor, SiftOptions};
use vision::{ExtractError, FeatureExtractor, GrayImage, ImageFeatures, Metric, distance};

const SIDE: usize = 200;
const MIDDLE: f64 = 99.5;
/// Points that shrink below this scale (pixels) are finer than the finest level looked at.
const FINEST: f64 = 2.2;

/// Round blobs of many sizes on grey.
struct Scene(Vec<[f64; 4]>);

impl Scene {
    fn new(seed: u64) -> Self {
        let mut random = StdRng::seed_from_u64(seed);
        let mut between = |from: f64, to: f64| random.random_range(from..to);
        Self(
            (0..900)
                .map(|_| {
                    let place = [between(-40.0, 240.0), between(-40.0, 240.0)];
                    [place[0], place[1], between(1.2, 3.5), between(-60.0, 60.0)]
                })
                .collect(),
        )
    }

    /// Moved, and its grey levels `gain * value + offset`. A round blob stays one under every motion.
    fn render(&self, motion: &Motion, gain: f64, offset: f64) -> GrayImage {
        let mut values = vec![128.0; SIDE * SIDE];
        for &[u, v, sigma, height] in &self.0 {
            let (centre, sigma) = (motion.forth([u, v]), sigma * motion.scale);
            let span = |middle: f64| {
                let pixel = |at: f64| at.clamp(0.0, SIDE as f64) as usize;
                pixel(middle - 6.0 * sigma)..pixel(middle + 6.0 * sigma + 1.0)
            };
            let falloff = |at: usize, middle: f64| (-0.5 * ((at as f64 - middle) / sigma).powi(2)).exp();
            for y in span(centre[1]) {
                for x in span(centre[0]) {
                    values[y * SIDE + x] += height * falloff(x, centre[0]) * falloff(y, centre[1]);
                }
            }
        }
        GrayImage::from_fn(SIDE, SIDE, |x, y| {
            (gain * values[y * SIDE + x] + offset).round().clamp(0.0, 255.0) as u8
        })
    }
}

/// Turned by radians and enlarged about the middle of the image, then shifted by pixels.
#[derive(Clone, Copy)]
struct Motion {
    angle: f64,
    scale: f64,
    shift: [f64; 2],
}

const STAY: Motion = Motion { angle: 0.0, scale: 1.0, shift: [0.0; 2] };

impl Motion {
    fn forth(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sine, cosine) = self.angle.sin_cos();
        let (x, y) = (self.scale * (x - MIDDLE), self.scale * (y - MIDDLE));
        [cosine * x - sine * y + MIDDLE + self.shift[0], sine * x + cosine * y + MIDDLE + self.shift[1]]
    }
}

fn extract(image: &GrayImage, max_features: usize) -> ImageFeatures {
    SiftExtractor::default().extract(image, None, max_features).unwrap()
}

fn descriptor(features: &ImageFeatures, index: usize) -> &[u8] {
    &features.descriptors[index * features.width..][..features.width]
}

fn apart(a: [f64; 2], b: [f32; 2]) -> f64 {
    (a[0] - f64::from(b[0])).hypot(a[1] - f64::from(b[1]))
}

/// What became of the points that stay well inside of the image and are not too fine.
struct Comparison {
    /// Points that could be found again.
    inside: usize,
    /// For each that was, how far (pixels) from where it belongs, and how far its descriptor went.
    found: Vec<(f64, f32)>,
    /// Of those, whose descriptor is nearer than that of any other point.
    recognized: usize,
}

fn compare(before: &ImageFeatures, after: &ImageFeatures, motion: &Motion) -> Comparison {
    let mut comparison = Comparison { inside: 0, found: Vec::new(), recognized: 0 };
    for (index, point) in before.keypoints.iter().enumerate() {
        let scale = f64::from(point.scale) * motion.scale;
        let place = motion.forth(point.pixel.map(f64::from));
        let room = 6.0 * scale + 8.0;
        if scale < FINEST || place.iter().any(|&c| c < room || c > SIDE as f64 - 1.0 - room) {
            continue;
        }
        comparison.inside += 1;
        let same = |other: &usize| {
            let other = &after.keypoints[*other];
            apart(place, other.pixel) < 1.0 && (0.8..1.25).contains(&(f64::from(other.scale) / scale))
        };
        let Some(twin) = (0..after.keypoints.len()).find(same) else { continue };
        let to =
            |other: usize| distance(Metric::CosineInt8, descriptor(before, index), descriptor(after, other));
        comparison.found.push((apart(place, after.keypoints[twin].pixel), to(twin)));
        let rivals =
            (0..after.keypoints.len()).filter(|&other| apart(place, after.keypoints[other].pixel) > 3.0);
        comparison.recognized += usize::from(rivals.into_iter().all(|other| to(other) > to(twin)));
    }
    comparison
}

/// At least `share` of the points are found again, near where they belong, and recognized.
fn assert_survive(comparison: &Comparison, share: f64, near: f64, alike: f32) {
    let Comparison { inside, found, recognized } = comparison;
    assert!(*inside >= 30, "only {inside} points");
    let median = |mut numbers: Vec<f64>| {
        numbers.sort_by(f64::total_cmp);
        numbers[numbers.len() / 2]
    };
    assert!(found.len() as f64 >= share * *inside as f64, "{} of {inside} found", found.len());
    assert!(*recognized as f64 >= 0.85 * found.len() as f64, "{recognized} of {} recognized", found.len());
    let place = median(found.iter().map(|&(place, _)| place).collect());
    assert!(place <= near, "{place} pixels away");
    let change = median(found.iter().map(|&(_, change)| f64::from(change)).collect());
    assert!(change <= f64::from(alike), "descriptors {change} away");
}

fn survives(motion: Motion, share: f64, near: f64, alike: f32) {
    for seed in 0..3 {
        let scene = Scene::new(seed);
        let before = extract(&scene.render(&STAY, 0.6, 50.0), 150);
        let after = extract(&scene.render(&motion, 0.6, 50.0), 600);
        assert_survive(&compare(&before, &after, &motion), share, near, alike);
    }
}

#[test]
fn points_shift_with_the_image_by_fractions_of_a_pixel() {
    survives(Motion { shift: [7.3, -4.6], ..STAY }, 0.9, 0.1, 0.02);
}

#[test]
fn points_turn_with_the_image() {
    for degrees in [90.0_f64, 33.0, 180.0, -120.0] {
        survives(Motion { angle: degrees.to_radians(), ..STAY }, 0.9, 0.1, 0.03);
    }
}

#[test]
fn points_grow_and_shrink_with_the_image() {
    survives(Motion { scale: 1.3, ..STAY }, 0.8, 0.15, 0.03);
    survives(Motion { scale: 0.75, angle: 0.5, ..STAY }, 0.7, 0.15, 0.05);
}

#[test]
fn brighter_or_darker_images_have_the_same_features() {
    let scene = Scene::new(4);
    let before = extract(&scene.render(&STAY, 0.6, 50.0), 150);
    for (gain, offset) in [(0.6, 65.0), (0.3, 120.0), (0.2, 0.0)] {
        let after = extract(&scene.render(&STAY, gain, offset), 600);
        assert_survive(&compare(&before, &after, &STAY), 0.85, 0.1, 0.01);
    }
}

#[test]
fn a_blob_is_found_at_its_centre_with_its_size() {
    for (place, sigma) in [([90.3, 71.8], 3.0), ([101.5, 99.25], 6.0), ([60.0, 140.7], 12.0)] {
        let scene = Scene(vec![[place[0], place[1], sigma, 80.0]]);
        let best = extract(&scene.render(&STAY, 1.0, 0.0), 10).keypoints[0];
        assert!(apart(place, best.pixel) < 0.05, "{place:?}: {best:?}");
        assert!((f64::from(best.scale) / sigma - 1.0).abs() < 0.15, "{sigma}: {best:?}");
    }
}

#[test]
fn the_best_come_first_and_no_more_than_wanted() {
    let image = Scene::new(5).render(&STAY, 1.0, 0.0);
    let all = extract(&image, usize::MAX).keypoints.len();
    assert!(all > 100, "{all}");
    for wanted in [0, 1, 20, 100] {
        let features = extract(&image, wanted);
        assert_eq!(features.keypoints.len(), wanted);
        assert_eq!(features.descriptors.len(), wanted * features.width);
        assert!(features.keypoints.is_sorted_by(|a, b| a.score >= b.score));
    }
}

#[test]
fn no_point_lies_where_the_mask_is_zero_and_the_others_stay() {
    let image = Scene::new(6).render(&STAY, 1.0, 0.0);
    let mask = GrayImage::from_fn(SIDE, SIDE, |x, _| u8::from(x >= 80));
    let free = extract(&image, usize::MAX).keypoints;
    let masked = SiftExtractor::default().extract(&image, Some(&mask), usize::MAX).unwrap().keypoints;
    let expected: Vec<_> = free.iter().copied().filter(|point| point.pixel[0].round() >= 80.0).collect();
    assert!(!masked.is_empty() && expected.len() < free.len());
    assert_eq!(masked, expected);
}

#[test]
fn the_same_image_gives_the_same_features_whatever_was_seen_before() {
    let image = Scene::new(7).render(&STAY, 1.0, 0.0);
    let other = GrayImage::from_fn(331, 97, |x, y| ((x * x / 7 + 13 * y) % 251) as u8);
    for doubled in [false, true] {
        let mut extractor = SiftExtractor::new(SiftOptions { doubled, ..SiftOptions::default() });
        let first = extractor.extract(&image, None, 200).unwrap();
        extractor.extract(&other, None, 200).unwrap();
        assert_eq!(extractor.extract(&image, None, 200).unwrap(), first);
    }
}

#[test]
fn the_doubled_image_has_finer_points_at_the_same_places() {
    let scene = Scene::new(8);
    let image = scene.render(&STAY, 1.0, 0.0);
    let plain = extract(&image, 300);
    let options = SiftOptions { doubled: true, ..SiftOptions::default() };
    let doubled = SiftExtractor::new(options).extract(&image, None, usize::MAX).unwrap();
    assert_survive(&compare(&plain, &doubled, &STAY), 0.9, 0.15, 0.03);
    let finest = |features: &ImageFeatures| {
        features.keypoints.iter().map(|point| point.scale).fold(f32::INFINITY, f32::min)
    };
    assert!(finest(&doubled) < finest(&plain));
}

#[test]
fn an_image_without_contrast_has_no_features() {
    for grey in [0, 128, 255] {
        let features = extract(&GrayImage::from_fn(64, 48, |_, _| grey), 100);
        assert!(features.keypoints.is_empty() && features.descriptors.is_empty());
    }
}

#[test]
fn too_small_images_and_masks_of_another_size_are_refused() {
    let grey = |width, height| GrayImage::from_fn(width, height, |x, y| (x * y % 251) as u8);
    let mut extractor = SiftExtractor::default();
    for (width, height) in [(1, 1), (500, 23), (23, 500)] {
        let error = extractor.extract(&grey(width, height), None, 10).unwrap_err();
        assert!(matches!(error, ExtractError::TooSmall { min_side: 24, .. }), "{error}");
    }
    assert!(extractor.extract(&grey(24, 24), None, 10).is_ok());
    let error = extractor.extract(&grey(64, 48), Some(&grey(48, 64)), 10).unwrap_err();
    assert!(matches!(error, ExtractError::MaskSize { mask: (48, 64), image: (64, 48) }), "{error}");
}
