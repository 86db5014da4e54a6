//! Laws of what answers hold.

use crate::common::{ask, loaded, random_pose};
use nalgebra::Vector3;
use protocol::{DescriptorFormat, DescriptorKind, Descriptors, FeatureSet, MatchOutcome, MatchedKeyframe};
use rand::SeedableRng;
use rand::rngs::StdRng;
use recognition::{LoadedMap, QueryError, RecognitionOptions};
use std::collections::{HashMap, HashSet};
use testing::{Place, PlaceOptions};

#[test]
fn every_feature_and_landmark_appears_once_and_every_anchor_is_in_the_answer() {
    let place = Place::new(&PlaceOptions::default());
    let map = loaded(&place);
    let truth_of: HashMap<u64, Vector3<f64>> = place
        .points
        .iter()
        .enumerate()
        .map(|(point, (position, _))| (1000 + point as u64, *position))
        .collect();
    let mut rng = StdRng::seed_from_u64(16);
    for max_keyframes in [1, 2, 4, 12] {
        let truth = random_pose(&place, &mut rng);
        let mut request = place.request(&truth, max_keyframes, &mut rng);
        let held = place.map.keyframes[3].id;
        request.held = vec![held, 987_654];
        let (keyframes, _) = ask(&map, &request);
        assert!(!keyframes.is_empty() && keyframes.len() <= usize::from(max_keyframes));
        let sent: HashMap<u64, &MatchedKeyframe> =
            keyframes.iter().map(|sent| (sent.keyframe.id, sent)).collect();
        assert_eq!(sent.len(), keyframes.len());
        let (mut features, mut landmarks) = (HashSet::new(), HashSet::new());
        for (rank, keyframe) in keyframes.iter().enumerate() {
            assert_eq!(usize::from(keyframe.rank), rank);
            for found in &keyframe.matches {
                assert!(features.insert(found.feature), "feature {} twice", found.feature);
                assert!(landmarks.insert(found.landmark), "landmark {} twice", found.landmark);
                let observed_by: Vec<u64> = found.observations.iter().map(|seen| seen.keyframe).collect();
                assert!(sent.contains_key(&found.anchor) && observed_by.contains(&found.anchor));
                assert!(observed_by.contains(&keyframe.keyframe.id));
                assert!(observed_by.iter().all(|id| sent.contains_key(id) || *id == held));

                let anchor = &sent[&found.anchor].keyframe;
                let in_anchor = Vector3::from(found.position_in_anchor);
                let in_global = anchor.global_from_keyframe.pose.transform(&in_anchor);
                let error = (in_global - truth_of[&found.landmark]).norm();
                assert!(
                    error < 0.1 * in_anchor.norm() + 0.2,
                    "landmark {} is off by {error} m",
                    found.landmark
                );
                let seen = found.observations.iter().find(|seen| seen.keyframe == found.anchor).unwrap();
                let pixel = anchor.camera.project(&in_anchor).unwrap();
                let residual = (pixel - nalgebra::Vector2::from(seen.pixel.map(f64::from))).norm();
                assert!(residual < 4.0, "landmark {} is {residual} px off its own pixel", found.landmark);
            }
        }
        assert!(keyframes[0].matches.len() >= 8);
    }
}

#[test]
fn cross_covariances_go_to_smaller_ranks_and_held_keyframes() {
    let place = Place::new(&PlaceOptions::default());
    let map = loaded(&place);
    let mut rng = StdRng::seed_from_u64(17);
    let truth = place.camera_at(20.5, 0.0, 0.0);
    let mut request = place.request(&truth, 6, &mut rng);
    request.held = place.map.keyframes.iter().step_by(2).map(|keyframe| keyframe.id).collect();
    let (keyframes, _) = ask(&map, &request);
    let mut blocks = 0;
    for (rank, keyframe) in keyframes.iter().enumerate() {
        let id = keyframe.keyframe.id;
        let smaller: Vec<u64> = keyframes[..rank].iter().map(|sent| sent.keyframe.id).collect();
        let wanted: HashSet<u64> = smaller
            .iter()
            .chain(&request.held)
            .copied()
            .filter(|other| other.abs_diff(id) == 1) // the map correlates neighbours
            .collect();
        let sent: HashSet<u64> = keyframe.cross_covariances.iter().map(|cross| cross.other).collect();
        assert_eq!(sent, wanted);
        for cross in &keyframe.cross_covariances {
            let stored = place
                .map
                .cross_covariances
                .iter()
                .find(|stored| (stored.a, stored.b) == (id.min(cross.other), id.max(cross.other)));
            let block = stored.unwrap().block;
            assert_eq!(cross.block, if id < cross.other { block } else { block.transpose() });
            blocks += 1;
        }
    }
    assert!(blocks > 0);
}

#[test]
fn what_the_robot_knows_of_held_keyframes_is_not_sent_again() {
    let mut place = Place::new(&PlaceOptions::default());
    testing::add_common_errors(&mut place.map, 3);
    let map = loaded(&place);
    let mut request = place.request(&place.camera_at(20.5, 0.0, 0.0), 6, &mut StdRng::seed_from_u64(17));
    let (all, _) = ask(&map, &request);
    assert!(all.len() > 2);
    for keyframe in &all {
        let stated = map.common_error(keyframe.keyframe.id).unwrap();
        assert_eq!(keyframe.common_error.as_flattened(), stated.factor.as_slice());
    }

    // Held in another version, or the robot does not say in which: everything is sent.
    request.held = all.iter().skip(1).map(|keyframe| keyframe.keyframe.id).collect();
    for version in [None, Some(map.info().version + 1)] {
        request.map_version_held = version;
        let (again, _) = ask(&map, &request);
        for (keyframe, before) in again.iter().zip(&all) {
            assert_eq!(keyframe.common_error, before.common_error);
            assert!(keyframe.cross_covariances.len() >= before.cross_covariances.len());
        }
    }

    request.map_version_held = Some(map.info().version);
    let (again, _) = ask(&map, &request);
    let new = &all[0].keyframe.id;
    let mut blocks = 0;
    for keyframe in &again {
        let is_new = keyframe.keyframe.id == *new;
        assert_eq!(keyframe.common_error.is_empty(), !is_new);
        for cross in &keyframe.cross_covariances {
            assert!(is_new || cross.other == *new, "two held keyframes");
            assert_eq!(Some(cross.block), map.cross_covariance(keyframe.keyframe.id, cross.other));
            blocks += 1;
        }
    }
    assert!(blocks > 0);
}

#[test]
fn the_same_query_has_the_same_answer() {
    let place = Place::new(&PlaceOptions::default());
    let map = loaded(&place);
    let request = place.request(&place.camera_at(9.0, 0.5, 0.2), 4, &mut StdRng::seed_from_u64(18));
    assert_eq!(ask(&map, &request).0, ask(&map, &request).0);
}

#[test]
fn too_few_features_and_an_empty_map_are_outcomes_and_foreign_descriptors_an_error() {
    let place = Place::new(&PlaceOptions { keyframes: 4, landmarks: 100, ..PlaceOptions::default() });
    let map = loaded(&place);
    let mut rng = StdRng::seed_from_u64(19);
    let mut request = place.request(&place.camera_at(2.0, 0.0, 0.0), 1, &mut rng);
    let none = FeatureSet::empty(DescriptorFormat { kind: DescriptorKind::Binary, width: 32 });
    let empty = Place::new(&PlaceOptions { keyframes: 0, landmarks: 0, ..PlaceOptions::default() });
    assert_eq!(ask(&loaded(&empty), &request).1.outcome, MatchOutcome::EmptyMap);
    let features = std::mem::replace(&mut request.features, none);
    assert_eq!(ask(&map, &request).1.outcome, MatchOutcome::TooFewFeatures);

    let bytes = features.descriptors.bytes[..16 * features.len()].to_vec();
    let narrow = Descriptors { kind: DescriptorKind::Binary, width: 16, bytes };
    request.features = FeatureSet { descriptors: narrow, ..features };
    let error = map.answer(&request, &RecognitionOptions::default()).unwrap_err();
    assert!(matches!(error, QueryError::DescriptorMismatch { .. }), "{error}");
}

#[test]
fn features_of_another_extractor_are_refused_with_both_names() {
    let place = Place::new(&PlaceOptions { keyframes: 10, landmarks: 500, ..PlaceOptions::default() });
    let mut contents = place.map.clone();
    contents.info.extractor = "sift-1".to_owned();
    let map = LoadedMap::from_contents(contents).unwrap();
    let mut rng = StdRng::seed_from_u64(23);
    let mut request = place.request(&place.camera_at(6.0, 0.0, 0.0), 1, &mut rng);
    for (stated, refused) in [("", false), ("sift-1", false), ("xfeat-1", true)] {
        request.features.extractor = stated.to_owned();
        match map.answer(&request, &RecognitionOptions::default()) {
            Ok(replies) => assert!(!refused && replies.len() == 2),
            Err(error) => {
                assert!(refused && matches!(error, QueryError::ExtractorMismatch { .. }));
                let said = error.to_string();
                assert!(said.contains("sift-1") && said.contains("xfeat-1"), "{said}");
            }
        }
    }
}

#[test]
fn a_loaded_map_holds_what_its_contents_hold() {
    let place = Place::new(&PlaceOptions::default());
    let map = loaded(&place);
    let mut contents = place.map.clone();
    contents.sort();
    assert_eq!(map.info_reply("place").observations as usize, contents.observation_count());
    for keyframe in &contents.keyframes {
        let reply = map.keyframe_reply(keyframe.id).unwrap();
        assert_eq!(reply.keyframe.global_from_keyframe, keyframe.global_from_keyframe);
        let observed = contents.landmarks.iter().filter_map(|landmark| {
            let own = landmark.observations.iter().find(|observation| observation.keyframe == keyframe.id)?;
            Some((landmark.id, landmark.anchor, <[f64; 3]>::from(landmark.position_in_anchor), own.pixel))
        });
        let told = reply.landmarks.iter().map(|landmark| {
            (landmark.landmark, landmark.anchor, landmark.position_in_anchor, landmark.pixel)
        });
        assert!(told.eq(observed), "keyframe {}", keyframe.id);
    }
    assert!(!contents.cross_covariances.is_empty());
    for cross in &contents.cross_covariances {
        assert_eq!(map.cross_covariance(cross.a, cross.b), Some(cross.block));
        assert_eq!(map.cross_covariance(cross.b, cross.a), Some(cross.block.transpose()));
    }
    assert_eq!(map.info_reply("hall").cross_covariances, contents.cross_covariances.len() as u64);
    assert_eq!(map.cross_covariance(u64::MAX, contents.keyframes[0].id), None);
}
