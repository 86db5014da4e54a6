//! The extractors find points where they are, with networks made for the purpose.

use super::published_networks::{R2D2_LAYERS, r2d2_shapes, xfeat_shapes};
use super::state;
use crate::reference::Tensors;
use rand::{RngExt as _, SeedableRng as _, rngs::Xoshiro256PlusPlus};
use vision::features::quantize::quantize;
use vision::features::{R2d2Extractor, XfeatExtractor};
use vision::{ExtractError, FeatureExtractor, GrayImage, Metric, distance};

/// XFeat's tensors such that a pixel is a keypoint where it is much brighter than the mean; descriptors are the mean
/// brightness around, in all numbers.
fn bright_dots() -> Tensors {
    let mut tensors: Tensors = xfeat_shapes()
        .into_iter()
        .map(|(name, shape)| {
            let fill = if name.ends_with("running_var") { 1.0 } else { 0.0 };
            let count = shape.iter().product();
            (name, (shape, vec![fill; count]))
        })
        .collect();
    let names =
        ["0.layer.0", "1.layer.0", "2.layer.0", "3"].map(|name| format!("keypoint_head.{name}.weight"));
    for name in names {
        let weights = &mut tensors.get_mut(&name).unwrap().1;
        for channel in 0..64 {
            weights[channel * 65] = 1.0;
        }
    }
    tensors.get_mut("keypoint_head.3.bias").unwrap().1[64] = 8.0;
    tensors.get_mut("block_fusion.2.bias").unwrap().1.fill(1.0);
    tensors
}

/// Bright dots on dark grey.
fn dots(width: usize, height: usize, places: &[[usize; 2]]) -> GrayImage {
    GrayImage::from_fn(width, height, |x, y| if places.contains(&[x, y]) { 255 } else { 40 })
}

fn pixels(
    extractor: &mut dyn FeatureExtractor,
    image: &GrayImage,
    mask: Option<&GrayImage>,
) -> Vec<[f32; 2]> {
    let features = extractor.extract(image, mask, 100).unwrap();
    assert_eq!(features.descriptors.len(), features.keypoints.len() * extractor.width());
    assert_eq!((features.metric, features.width), (Metric::CosineInt8, extractor.width()));
    assert!(features.keypoints.is_sorted_by(|a, b| a.score >= b.score));
    features.keypoints.iter().map(|keypoint| keypoint.pixel).collect()
}

fn assert_found(found: &[[f32; 2]], places: &[[usize; 2]], tolerance: f32) {
    assert_eq!(found.len(), places.len(), "{found:?} for {places:?}");
    for place in places {
        let near =
            |pixel: &[f32; 2]| (0..2).all(|axis| (pixel[axis] - place[axis] as f32).abs() <= tolerance);
        assert!(found.iter().any(near), "{place:?} is not among {found:?}");
    }
}

#[test]
fn xfeat_finds_dots_where_they_are_in_images_of_any_size() {
    let mut extractor = XfeatExtractor::from_weights(&state(&bright_dots())).unwrap();
    // In the middle of cells: the neighbours are alike, so nothing moves the point.
    let inside = [[4, 4], [43, 20], [66, 61], [52, 36]];
    for (width, height) in [(96, 64), (70, 65), (95, 63), (101, 97)] {
        let places: Vec<_> =
            inside.into_iter().filter(|place| place[0] < width && place[1] < height).collect();
        assert_found(&pixels(&mut extractor, &dots(width, height, &places), None), &places, 1e-3);
    }
    // In the last column, in the last row, and at the corner of a cell: to half a pixel.
    let border = [[69, 20], [30, 64], [16, 8]];
    assert_found(&pixels(&mut extractor, &dots(70, 65, &border), None), &border, 0.5);
}

#[test]
fn a_mask_hides_points_and_the_number_is_bounded() {
    let places = [[12, 12], [43, 20], [66, 61]];
    let image = dots(96, 64, &places);
    let mut extractor = XfeatExtractor::from_weights(&state(&bright_dots())).unwrap();
    let mask = GrayImage::from_fn(96, 64, |x, _| if x < 40 { 0 } else { 255 });
    assert_found(&pixels(&mut extractor, &image, Some(&mask)), &places[1..], 0.5);
    assert_eq!(extractor.extract(&image, None, 2).unwrap().keypoints.len(), 2);
    let flat = GrayImage::from_fn(96, 64, |_, _| 9);
    assert!(extractor.extract(&flat, None, 9).unwrap().keypoints.is_empty());
    let mask = GrayImage::from_fn(95, 64, |_, _| 1);
    assert!(matches!(extractor.extract(&image, Some(&mask), 9), Err(ExtractError::MaskSize { .. })));
    let small = GrayImage::from_fn(31, 64, |_, _| 1);
    assert!(matches!(extractor.extract(&small, None, 9), Err(ExtractError::TooSmall { .. })));
}

/// R2D2's tensors such that a pixel is repeatable where it is brighter than what is around it, and reliable everywhere.
pub fn blobs() -> Tensors {
    let zeros = |(name, shape): (String, Vec<usize>)| {
        let fill = if name.ends_with("running_var") { 1.0 } else { 0.0 };
        let count = shape.iter().product();
        (name, (shape, vec![fill; count]))
    };
    let mut tensors: Tensors = r2d2_shapes().into_iter().map(zeros).collect();
    let mut set = |name: &str, at: usize, number: f32| tensors.get_mut(name).unwrap().1[at] = number;
    for at in 0..27 {
        set("ops.0.weight", at, if at % 9 == 4 { 0.8 } else { -0.1 });
    }
    // The first channel as it is, moved by pixels: a kernel of 2x2 has no middle. Together they do not move it.
    for [at, _, _, side, _] in &R2D2_LAYERS[1..] {
        let tap = match at {
            3 | 6 | 12 | 15 => 4,
            22 => side * side - 1,
            _ => 0,
        };
        set(&format!("ops.{at}.weight"), tap, 1.0);
    }
    set("sal.weight", 0, 1.0);
    set("sal.bias", 0, -5.0);
    set("clf.bias", 1, 3.0);
    tensors
}

#[test]
fn r2d2_finds_dots_where_they_are_in_every_size() {
    let places = [[20, 30], [47, 51], [70, 11]];
    let mut extractor = R2d2Extractor::from_weights(&state(&blobs())).unwrap().with_scales(&[1.0]);
    assert_found(&pixels(&mut extractor, &dots(91, 67, &places), None), &places, 1e-3);
    // Squares of 4 x 4 pixels, which are dots in half the size. Their centres are between the pixels.
    let squares = GrayImage::from_fn(160, 120, |x, y| {
        let inside = |[left, top]: [usize; 2]| (left..left + 2).contains(&x) && (top..top + 2).contains(&y);
        if [[40, 30], [100, 80]].into_iter().any(inside) { 255 } else { 40 }
    });
    let mut extractor = extractor.with_scales(&[0.5]);
    let found = pixels(&mut extractor, &squares, None);
    assert_eq!(found.len(), 2);
    for [left, top] in [[40.0_f32, 30.0], [100.0, 80.0]] {
        let near = |p: &[f32; 2]| (p[0] - left - 0.5).abs() < 1e-2 && (p[1] - top - 0.5).abs() < 1e-2;
        assert!(found.iter().any(near), "{found:?}");
    }
}

#[test]
fn descriptors_keep_their_angles_as_bytes() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(7);
    for dimension in [64, 128] {
        for _ in 0..500 {
            let mut unit = |other: Option<&[f32]>| {
                let numbers = (0..dimension)
                    .map(|i| random.random_range(-1.0..1.0) + other.map_or(0.0, |o| 3.0 * o[i]));
                let numbers: Vec<f32> = numbers.collect();
                let norm = numbers.iter().map(|x| x * x).sum::<f32>().sqrt();
                numbers.into_iter().map(|x| x / norm).collect::<Vec<f32>>()
            };
            let a = unit(None);
            let b = unit(Some(&a));
            let cosine: f32 = a.iter().zip(&b).map(|(x, y)| x * y).sum();
            let (mut bytes_a, mut bytes_b) = (Vec::new(), Vec::new());
            quantize(&a, &mut bytes_a);
            quantize(&b, &mut bytes_b);
            assert_eq!(bytes_a.iter().map(|byte| byte.cast_signed().unsigned_abs()).max(), Some(127));
            let error = distance(Metric::CosineInt8, &bytes_a, &bytes_b) - (1.0 - cosine);
            assert!(error.abs() < 2e-3, "{error}");
        }
    }
    let mut zero = Vec::new();
    quantize(&[0.0; 64], &mut zero);
    assert_eq!(zero, [0; 64]);
}
