//! Edits keep a map valid and every landmark that stays in its place.

use std::collections::{BTreeMap, BTreeSet};

use map::{KeyframeCrossCovariance, Landmark, MapContents};
use nalgebra::Vector3;
use proptest::prelude::*;
use testing::{Place, PlaceOptions, add_images, add_second_kind};

use map::edit::{
    MIN_OTHERS, Region, keyframes_where, redundant_keyframes, remove_keyframes, retain_landmarks,
};

fn place(seed: u64) -> MapContents {
    let options = PlaceOptions { seed, keyframes: 12, landmarks: 200, ..PlaceOptions::default() };
    let mut map = Place::new(&options).map;
    add_second_kind(&mut map, "other-1");
    add_images(&mut map);
    map
}

/// Positions of the landmarks in G, of all kinds of features, by id.
fn positions(contents: &MapContents) -> BTreeMap<u64, Vector3<f64>> {
    let pose = |id| {
        let keyframe = contents.keyframes.iter().find(|keyframe| keyframe.id == id).unwrap();
        keyframe.global_from_keyframe.pose
    };
    let position = |landmark: &Landmark| pose(landmark.anchor).transform(&landmark.position_in_anchor);
    let landmarks = contents.landmarks_of_kinds().flat_map(|(_, landmarks)| landmarks);
    landmarks.map(|landmark| (landmark.id, position(landmark))).collect()
}

proptest! {
    #[test]
    fn what_stays_is_where_it_was(seed in 0_u64..1000, chosen in proptest::collection::vec(any::<bool>(), 12)) {
        let before = place(seed);
        let mut index = chosen.iter();
        let removed: BTreeSet<u64> =
            before.keyframes.iter().filter(|_| *index.next().unwrap()).map(|keyframe| keyframe.id).collect();
        let mut after = before.clone();
        remove_keyframes(&mut after, &removed);
        after.validate().unwrap();
        prop_assert_eq!(after.keyframes.len(), before.keyframes.len() - removed.len());
        let (was, is) = (positions(&before), positions(&after));
        for (id, position) in &is {
            prop_assert!((position - was[id]).norm() < 1e-9);
        }
        for landmark in before.landmarks_of_kinds().flat_map(|(_, landmarks)| landmarks) {
            let observed = landmark.observations.iter().any(|seen| !removed.contains(&seen.keyframe));
            prop_assert_eq!(observed, is.contains_key(&landmark.id));
        }
        let left: Vec<u64> = after.images.iter().map(|image| image.keyframe).collect();
        let expected = before.images.iter().map(|image| image.keyframe).filter(|id| !removed.contains(id));
        prop_assert_eq!(left, expected.collect::<Vec<_>>());
        let both = |cross: &&KeyframeCrossCovariance| !removed.contains(&cross.a) && !removed.contains(&cross.b);
        prop_assert_eq!(after.cross_covariances.len(), before.cross_covariances.iter().filter(both).count());
    }
}

#[test]
fn landmarks_of_redundant_keyframes_stay_well_observed() {
    let mut contents = place(5);
    let before: BTreeMap<u64, usize> =
        contents.landmarks.iter().map(|landmark| (landmark.id, landmark.observations.len())).collect();
    let redundant = redundant_keyframes(&contents, 1.0);
    assert!(!redundant.is_empty() && redundant.len() < contents.keyframes.len() - 1, "{redundant:?}");
    assert!(redundant_keyframes(&contents, 0.5).len() >= redundant.len());
    remove_keyframes(&mut contents, &redundant);
    contents.validate().unwrap();
    let after: BTreeMap<u64, usize> =
        contents.landmarks.iter().map(|landmark| (landmark.id, landmark.observations.len())).collect();
    for (id, count) in before {
        assert!(after[&id] >= count.min(MIN_OTHERS), "landmark {id}: {count}, then {}", after[&id]);
    }
    // What is left is redundant no more.
    assert!(redundant_keyframes(&contents, 1.0).is_empty());
}

#[test]
fn regions_choose_keyframes_and_landmarks() {
    let mut contents = place(8);
    let half = contents.keyframes[5].global_from_keyframe.pose.translation.x;
    let infinite = Vector3::repeat(f64::INFINITY);
    let region = Region { min: Vector3::new(half, f64::NEG_INFINITY, f64::NEG_INFINITY), max: infinite };
    let inside = keyframes_where(&contents, |keyframe| {
        region.contains(&keyframe.global_from_keyframe.pose.translation)
    });
    assert!(inside.contains(&contents.keyframes[5].id) && inside.len() < contents.keyframes.len());
    let [all, of_second] = [contents.landmarks.len(), contents.added_features[0].landmarks.len()];
    retain_landmarks(&mut contents, |position| region.contains(position));
    contents.validate().unwrap();
    assert!(contents.added_features[0].landmarks.len() < of_second);
    assert!(contents.landmarks.len() < all && positions(&contents).values().all(|at| at.x >= half));
}
