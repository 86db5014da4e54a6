//! Descriptors of every kind are recognized.

use crate::common::{loaded, localize_request, random_pose};
use protocol::{DescriptorFormat, DescriptorKind, Descriptors, FeatureSet};
use rand::SeedableRng;
use rand::rngs::StdRng;
use recognition::{LoadedMap, RecognitionOptions};
use testing::{Place, PlaceOptions};

#[test]
fn float_descriptors_are_recognized_too() {
    // Each bit becomes a number: +1 or -1, with noise.
    let as_floats = |bits: &[u8], rng: &mut StdRng| -> Vec<u8> {
        let bit = |at: usize| f32::from(bits[at / 8] >> (at % 8) & 1) * 2.0 - 1.0;
        (0..64).flat_map(|at| (bit(at) + 0.2 * testing::normal(rng) as f32).to_le_bytes()).collect()
    };
    let place = Place::new(&PlaceOptions { keyframes: 12, landmarks: 500, ..PlaceOptions::default() });
    let mut rng = StdRng::seed_from_u64(20);
    let mut contents = place.map.clone();
    contents.info.descriptor_kind = DescriptorKind::Float;
    contents.info.descriptor_width = 256;
    for observation in contents.landmarks.iter_mut().flat_map(|landmark| &mut landmark.observations) {
        observation.descriptor = as_floats(&observation.descriptor, &mut rng);
    }
    let map = LoadedMap::from_contents(contents).unwrap();
    let mut found = 0;
    for _ in 0..10 {
        let truth = random_pose(&place, &mut rng);
        let mut request = place.request(&truth, 1, &mut rng);
        let floats: Vec<Vec<u8>> =
            request.features.descriptors.iter().map(|bits| as_floats(bits, &mut rng)).collect();
        let bytes = floats.concat();
        request.features.descriptors = Descriptors { kind: DescriptorKind::Float, width: 256, bytes };
        let reply = map.localize(&localize_request(request), &RecognitionOptions::default()).unwrap();
        if let Some(fix) = reply.fix {
            assert!(truth.local(&fix.global_from_camera.pose).fixed_rows::<3>(3).norm() < 0.3);
            found += 1;
        }
    }
    assert!(found >= 9, "only {found} of 10");
}

/// The place with signed bytes for bits: +40 or -40, with noise.
fn with_signed_bytes(place: &Place, rng: &mut StdRng) -> LoadedMap {
    let mut contents = place.map.clone();
    contents.info.descriptor_kind = DescriptorKind::Int8;
    contents.info.descriptor_width = 64;
    for observation in contents.landmarks.iter_mut().flat_map(|landmark| &mut landmark.observations) {
        observation.descriptor = as_signed_bytes(&observation.descriptor, rng);
    }
    LoadedMap::from_contents(contents).unwrap()
}

fn as_signed_bytes(bits: &[u8], rng: &mut StdRng) -> Vec<u8> {
    let bit = |at: usize| f64::from(bits[at / 8] >> (at % 8) & 1) * 80.0 - 40.0;
    let mut number = |at: usize| (bit(at) + 15.0 * testing::normal(rng)).clamp(-127.0, 127.0) as i8;
    (0..64).map(|at| number(at).cast_unsigned()).collect()
}

#[test]
fn keyframes_that_look_like_an_image_come_first() {
    let place = Place::new(&PlaceOptions {
        keyframes: 120,
        landmarks: 6000,
        repeated_descriptors: 20,
        repeated_share: 0.3,
        ..PlaceOptions::default()
    });
    let mut rng = StdRng::seed_from_u64(24);
    let map = with_signed_bytes(&place, &mut rng);
    let mut found = 0;
    for _ in 0..40 {
        let truth = random_pose(&place, &mut rng);
        let mut features = place.request(&truth, 1, &mut rng).features;
        let bytes: Vec<u8> =
            features.descriptors.iter().flat_map(|bits| as_signed_bytes(bits, &mut rng)).collect();
        features.descriptors = Descriptors { kind: DescriptorKind::Int8, width: 64, bytes };
        let alike = map.rank_keyframes(&features, 5).unwrap();
        let distance = |id: &u64| (place.path[(id - 10) as usize].translation - truth.translation).norm();
        found += usize::from(alike.iter().any(|id| distance(id) < 4.0));

        // Whoever lists the features, in whatever order.
        let mut reversed = features.clone();
        reversed.pixels.reverse();
        reversed.descriptors.bytes = features.descriptors.bytes.chunks(64).rev().flatten().copied().collect();
        assert_eq!(map.rank_keyframes(&reversed, 5).unwrap(), alike);
    }
    assert!(found >= 39, "only {found} of 40");
}

#[test]
fn a_keyframe_looks_most_like_itself() {
    let place = Place::new(&PlaceOptions::default());
    let map = loaded(&place);
    for keyframe in &place.map.keyframes[..25] {
        let mut features = FeatureSet::empty(DescriptorFormat { kind: DescriptorKind::Binary, width: 32 });
        for seen in place.map.landmarks.iter().flat_map(|landmark| &landmark.observations) {
            if seen.keyframe == keyframe.id {
                features.pixels.push(seen.pixel);
                features.descriptors.bytes.extend(&seen.descriptor);
            }
        }
        assert_eq!(map.rank_keyframes(&features, 1).unwrap(), [keyframe.id]);
    }
}
