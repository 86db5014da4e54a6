//! Edits keep a map valid, and every landmark that stays where its anchor sees it.

use std::collections::{BTreeMap, BTreeSet};

use map::{Keyframe, KeyframeCrossCovariance, Landmark, MapContents};
use nalgebra::{Vector2, Vector3};
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

fn keyframe(contents: &MapContents, id: u64) -> &Keyframe {
    contents.keyframes.iter().find(|keyframe| keyframe.id == id).unwrap()
}

/// The landmarks of all kinds of features, by id.
fn landmarks(contents: &MapContents) -> BTreeMap<u64, &Landmark> {
    let landmarks = contents.landmarks_of_kinds().flat_map(|(_, landmarks)| landmarks);
    landmarks.map(|landmark| (landmark.id, landmark)).collect()
}

/// Their positions in G, by id.
fn positions(contents: &MapContents) -> BTreeMap<u64, Vector3<f64>> {
    let position = |landmark: &Landmark| {
        let anchor = keyframe(contents, landmark.anchor);
        anchor.global_from_keyframe.pose.transform(&landmark.position_in_anchor)
    };
    let landmarks = contents.landmarks_of_kinds().flat_map(|(_, landmarks)| landmarks);
    landmarks.map(|landmark| (landmark.id, position(landmark))).collect()
}

proptest! {
    #[test]
    fn what_stays_is_where_its_anchor_sees_it(
        seed in 0_u64..1000,
        chosen in proptest::collection::vec(any::<bool>(), 12),
    ) {
        let before = place(seed);
        let mut index = chosen.iter();
        let removed: BTreeSet<u64> =
            before.keyframes.iter().filter(|_| *index.next().unwrap()).map(|keyframe| keyframe.id).collect();
        let mut after = before.clone();
        remove_keyframes(&mut after, &removed);
        after.validate().unwrap();
        prop_assert_eq!(after.keyframes.len(), before.keyframes.len() - removed.len());
        let (was, is) = (landmarks(&before), landmarks(&after));
        let were_at = positions(&before);
        for (id, landmark) in &is {
            let in_anchor = landmark.position_in_anchor;
            if landmark.anchor == was[id].anchor {
                prop_assert_eq!(in_anchor, was[id].position_in_anchor);
                continue;
            }
            // At the depth that the poses give, where the anchor sees it.
            let anchor = keyframe(&after, landmark.anchor);
            let depth = anchor.global_from_keyframe.pose.inverse_transform(&were_at[id]).z;
            prop_assert!((in_anchor.z - depth).abs() < 1e-9);
            let seen = landmark.observations.iter().find(|seen| seen.keyframe == anchor.id).unwrap();
            let pixel = anchor.camera.project(&in_anchor).unwrap();
            prop_assert!((pixel - Vector2::from(seen.pixel.map(f64::from))).norm() < 1e-6);
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

/// The poses of the map put the landmark behind the next observer.
#[test]
fn a_landmark_is_anchored_where_it_is_in_front_of_the_camera() {
    let mut map = place(3);
    let at = map.landmarks.iter().position(|landmark| landmark.observations.len() > 2).unwrap();
    let [id, first, second, third] = {
        let Landmark { id, anchor, observations, .. } = &map.landmarks[at];
        [*id, *anchor, observations[1].keyframe, observations[2].keyframe]
    };
    let position = positions(&map)[&id];
    let behind = map.keyframes.iter_mut().find(|keyframe| keyframe.id == second).unwrap();
    let pose = &mut behind.global_from_keyframe.pose;
    pose.translation = position + pose.rotation * Vector3::z();
    remove_keyframes(&mut map, &BTreeSet::from([first]));
    assert_eq!(landmarks(&map)[&id].anchor, third);
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
