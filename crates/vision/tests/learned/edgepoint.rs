//! The extractor EdgePoint2, with its weights and with those of small networks.

use crate::common::Texture;
use crate::reference::Tensors;
use crate::weights_file;
use rand::{RngExt, SeedableRng as _, rngs::Xoshiro256PlusPlus};
use vision::features::edgepoint::NAME;
use vision::features::{EdgePointExtractor, StateDict, StateDictError, open};
use vision::{ExtractError, FeatureExtractor, GrayImage, MatchOptions, Metric, match_descriptors};

fn texture(width: usize, height: usize, shift: f64) -> GrayImage {
    let texture = Texture::new(5);
    GrayImage::from_fn(width, height, |x, y| texture.at(3.0 * x as f64 + shift, 3.0 * y as f64) as u8)
}

fn extractor() -> Box<dyn FeatureExtractor> {
    open(NAME, None).unwrap()
}

/// Tensors of a network with few channels.
fn small_network() -> Tensors {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut shapes = Vec::new();
    let normalized = |name: &str, norm: &str, shape: [usize; 4]| {
        let mut shapes = vec![(format!("{name}.weight"), shape.to_vec())];
        for what in ["weight", "bias", "running_mean", "running_var"] {
            shapes.push((format!("{norm}.{what}"), vec![shape[0]]));
        }
        shapes
    };
    let plain = |name: &str, shape: [usize; 4]| {
        [(format!("{name}.weight"), shape.to_vec()), (format!("{name}.bias"), vec![shape[0]])]
    };
    for (name, shape) in
        [("block1.0", [3, 1, 4, 4]), ("block1.1", [8, 3, 3, 3]), ("desc_head.1", [16, 16, 3, 3])]
    {
        shapes.extend(normalized(&format!("{name}.layer.0"), &format!("{name}.layer.1"), shape));
    }
    for (name, inputs, outputs) in [("block1.2", 8, 8), ("block2", 8, 3), ("block3", 3, 5)] {
        let of = |at: usize| format!("{name}.layer.{at}");
        shapes.extend(normalized(&of(0), &of(1), [outputs, inputs, 3, 3]));
        shapes.extend(normalized(&of(3), &of(4), [outputs, outputs, 3, 3]));
        if inputs != outputs {
            shapes.extend(plain(&format!("{name}.skip"), [outputs, inputs, 1, 1]));
        }
    }
    for (name, shape) in [
        ("desc_head.0", [16, 16, 1, 1]),
        ("desc_head.2", [32, 16, 1, 1]),
        ("conv1", [5, 8, 1, 1]),
        ("conv2", [5, 3, 1, 1]),
        ("conv3", [5, 5, 1, 1]),
        ("score_head.0", [5, 5, 3, 3]),
        ("score_head.2", [5, 5, 3, 3]),
        ("score_head.4", [4, 5, 3, 3]),
    ] {
        shapes.extend(plain(name, shape));
    }
    let tensor = |(name, shape): (String, Vec<usize>)| {
        let count: usize = shape.iter().product();
        let (low, high) = if name.ends_with("var") { (0.5, 1.5) } else { (-0.5, 0.5) };
        (name, (shape, (0..count).map(|_| random.random_range(low..high)).collect()))
    };
    shapes.into_iter().map(tensor).collect()
}

fn read(tensors: &Tensors) -> Result<EdgePointExtractor, StateDictError> {
    EdgePointExtractor::from_weights("small", &StateDict::read(&weights_file::write(tensors)).unwrap())
}

#[test]
fn what_was_extracted_before_does_not_matter() {
    let image = texture(150, 100, 0.0);
    let first = extractor().extract(&image, None, 100).unwrap();
    assert_eq!((first.keypoints.len(), first.metric, first.width), (100, Metric::CosineInt8, 64));
    let mut used = extractor();
    for other in [texture(150, 100, 700.0), texture(97, 41, 0.0)] {
        used.extract(&other, None, 300).unwrap();
        assert_eq!(used.extract(&image, None, 100).unwrap(), first);
    }
}

#[test]
fn keypoints_are_inside_the_mask_and_away_from_the_sides() {
    let [width, height] = [101, 67];
    let image = texture(width, height, 0.0);
    let mask = GrayImage::from_fn(width, height, |x, _| if x < 40 { 0 } else { 255 });
    let all = extractor().extract(&image, None, 1000).unwrap().keypoints;
    let masked = extractor().extract(&image, Some(&mask), 1000).unwrap().keypoints;
    assert!(masked.len() > 20 && masked.len() < all.len());
    assert!(masked.iter().all(|keypoint| keypoint.pixel[0] >= 39.5));
    let sides = [width, height].map(|side| side as f32 - 4.5);
    assert!(all.iter().all(|keypoint| (0..2).all(|k| (3.5..=sides[k]).contains(&keypoint.pixel[k]))));
    assert!(all.is_sorted_by(|a, b| a.score >= b.score));
    for (at, a) in all.iter().enumerate() {
        let apart =
            |b: &vision::Keypoint| (0..2).any(|k| (a.pixel[k].round() - b.pixel[k].round()).abs() > 2.0);
        assert!(all[..at].iter().all(apart), "{a:?}");
    }
}

#[test]
fn small_and_empty_images_are_no_fault() {
    let mut extractor = extractor();
    for side in [1, 31] {
        let error = extractor.extract(&texture(side, 64, 0.0), None, 10).unwrap_err();
        assert!(matches!(error, ExtractError::TooSmall { min_side: 32, .. }));
    }
    for [width, height] in [[32, 32], [33, 32], [32, 65], [63, 95]] {
        let image = texture(width, height, 0.0);
        assert!(extractor.extract(&image, None, 10).unwrap().keypoints.len() <= 10);
        assert!(extractor.extract(&image, None, 0).unwrap().descriptors.is_empty());
    }
    for level in [0, 128, 255] {
        let features = extractor.extract(&GrayImage::from_fn(80, 60, |_, _| level), None, 1000).unwrap();
        assert!(features.keypoints.iter().all(|keypoint| keypoint.score.is_finite()));
    }
}

#[test]
fn most_keypoints_of_a_shifted_image_match_where_they_moved() {
    let mut extractor = extractor();
    // 10.5 of the texture's units are 3.5 pixels.
    let [a, b] = [0.0, 10.5].map(|shift| extractor.extract(&texture(320, 240, shift), None, 300).unwrap());
    let view = |features: &vision::ImageFeatures| {
        let bytes = features.descriptors.clone();
        (features.metric, features.width, bytes)
    };
    let ((metric, width, of_a), (.., of_b)) = (view(&a), view(&b));
    let descriptors = |bytes| vision::DescriptorView::new(metric, width, bytes).unwrap();
    let matches =
        match_descriptors(descriptors(&of_a), descriptors(&of_b), &MatchOptions::for_metric(metric)).unwrap();
    let error = |found: &vision::Match| {
        let ([x, y], [u, v]) = (a.keypoints[found.query].pixel, b.keypoints[found.train].pixel);
        (x - 3.5 - u).hypot(y - v)
    };
    let mut errors: Vec<f32> = matches.iter().map(error).collect();
    errors.sort_by(f32::total_cmp);
    println!("{} matches, median {}", errors.len(), errors[errors.len() / 2]);
    assert!(errors.len() > 200 && errors[errors.len() / 2] < 0.2, "{errors:?}");
    assert!(errors[errors.len() * 95 / 100] < 1.0, "{errors:?}");
}

#[test]
fn a_network_needs_every_tensor_in_its_shape_and_finite() {
    let tensors = small_network();
    let features = read(&tensors).unwrap().extract(&texture(64, 64, 0.0), None, 9).unwrap();
    assert_eq!(features.width, 32);
    for name in tensors.keys() {
        let mut missing = tensors.clone();
        missing.remove(name);
        assert!(matches!(read(&missing), Err(StateDictError::Missing(what)) if what == *name));
        let mut flat = tensors.clone();
        flat.get_mut(name).unwrap().0.push(1);
        let error = read(&flat).err();
        assert!(
            matches!(&error, Some(StateDictError::Shape { name: what, .. } | StateDictError::Axes { name: what, .. }) if what == name),
            "{name}: {error:?}"
        );
        let mut infinite = tensors.clone();
        infinite.get_mut(name).unwrap().1[0] = f32::NAN;
        assert!(matches!(read(&infinite), Err(StateDictError::NotFinite(what)) if what == *name));
    }
    let mut negative = tensors.clone();
    negative.get_mut("block2.layer.1.running_var").unwrap().1[1] = -1.0;
    assert!(matches!(read(&negative), Err(StateDictError::NotFinite(_))));
    // Channels of which no groups of 16 can be made.
    let mut narrow = tensors;
    *narrow.get_mut("desc_head.2.weight").unwrap() = (vec![20, 16, 1, 1], vec![0.0; 320]);
    let error = read(&narrow).err().unwrap().to_string();
    assert!(error.contains("desc_head.2.weight") && error.contains("[32, 16, 1, 1]"), "{error}");
}
