//! The network computes what PyTorch computes with the same weights (`goldens/goldens.py`).
#![allow(clippy::float_cmp)]

use super::*;

/// Rounding errors of a sum of some hundred products.
const TOLERANCE: f32 = 1e-4;

struct Goldens(StateDict);

impl Goldens {
    fn read() -> Self {
        Self(StateDict::read(include_bytes!("goldens/goldens.safetensors")).unwrap())
    }

    fn numbers<const AXES: usize>(&self, name: &str) -> ([usize; AXES], &[f32]) {
        let shape = self.0.shape(name).unwrap();
        (shape, self.0.get(name, &shape).unwrap())
    }

    /// The upper left part of the picture.
    fn image(&self, width: usize, height: usize) -> GrayImage {
        let ([_, columns], pixels) = self.numbers::<2>("image");
        GrayImage::from_fn(width, height, |x, y| pixels[y * columns + x] as u8)
    }

    fn assert_map(&self, name: &str, map: &crate::features::layers::Map) {
        let ([channels, rows, columns], numbers) = self.numbers::<3>(name);
        assert_eq!([map.channels(), map.rows(), map.columns()], [channels, rows, columns], "{name}");
        for (at, expected) in numbers.chunks_exact(columns).enumerate() {
            let row = map.row(at / rows, at % rows);
            for (number, expected) in row.iter().zip(expected) {
                assert!((number - expected).abs() < TOLERANCE, "{name}: {number}, not {expected}");
            }
        }
    }

    /// Keypoints and descriptors as published.
    fn assert_features(&self, prefix: &str, image: &GrayImage) {
        let ([count, _], points) = self.numbers::<2>(&format!("{prefix}points"));
        let ([_, width], expected) = self.numbers::<2>(&format!("{prefix}descriptors"));
        let mut extractor = EdgePointExtractor::new().unwrap().with_refinement(false);
        let (keypoints, descriptors) = extractor.extract_floats(image, None, 60).unwrap();
        assert_eq!(keypoints.len(), count);
        for (at, keypoint) in keypoints.iter().enumerate() {
            let &[x, y, score] = &points[3 * at..3 * at + 3] else { panic!("three numbers") };
            assert_eq!(keypoint.pixel, [x, y]);
            assert!((keypoint.score - score).abs() < TOLERANCE);
            let of = |numbers: &[f32]| numbers[at * width..(at + 1) * width].to_vec();
            let cosine: f32 = of(&descriptors).iter().zip(of(expected)).map(|(a, b)| a * b).sum();
            assert!(cosine > 0.99999, "{cosine}");
        }
    }
}

#[test]
fn every_layer_equals_that_of_pytorch() {
    let goldens = Goldens::read();
    let mut extractor = EdgePointExtractor::new().unwrap();
    extractor.extract_floats(&goldens.image(96, 64), None, 60).unwrap();
    let maps = &extractor.maps;
    for (name, map) in ["x1", "x2", "x3"].into_iter().zip(&maps.features) {
        goldens.assert_map(name, map);
    }
    goldens.assert_map("quarter", &maps.quarter);
    let ([_, _, columns], scores) = goldens.numbers::<3>("scores");
    for (y, expected) in scores.chunks_exact(columns).enumerate() {
        for (number, expected) in extractor.scores.row(y).iter().zip(expected) {
            assert!((number - expected).abs() < TOLERANCE, "{number}, not {expected}");
        }
    }
}

#[test]
fn keypoints_and_descriptors_equal_those_of_pytorch() {
    let goldens = Goldens::read();
    goldens.assert_features("", &goldens.image(96, 64));
    goldens.assert_features("odd_", &goldens.image(83, 53));
}

#[test]
fn refinement_moves_a_keypoint_within_its_pixel() {
    let image = Goldens::read().image(96, 64);
    let extract = |refines| {
        let mut extractor = EdgePointExtractor::new().unwrap().with_refinement(refines);
        extractor.extract_floats(&image, None, 60).unwrap().0
    };
    let mut moved = 0;
    for (whole, refined) in extract(false).iter().zip(extract(true)) {
        assert_eq!(whole.score, refined.score);
        assert!(whole.pixel.iter().zip(refined.pixel).all(|(a, b)| (a - b).abs() <= 0.5));
        moved += usize::from(whole.pixel != refined.pixel);
    }
    assert!(moved > 50, "{moved}");
}
