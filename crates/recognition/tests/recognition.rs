//! Laws of place recognition and of the answers, on seeded synthetic places.

use std::collections::{HashMap, HashSet};

use geometry::{Pose, PoseWithCovariance};
use map::{CommonError, KeyframeCrossCovariance, MapContents};
use nalgebra::{Matrix6, Matrix6xX, Vector3, Vector6};
use protocol::{
    DescriptorFormat, DescriptorKind, Descriptors, FeatureSet, LocalizeRequest, MatchOutcome, MatchReply,
    MatchRequest, MatchStatus, MatchedKeyframe, PosePrior, Validate,
};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use recognition::{LoadedMap, QueryError, RecognitionOptions};
use testing::{Place, PlaceOptions};

fn loaded(place: &Place) -> LoadedMap {
    LoadedMap::from_contents(place.map.clone()).unwrap()
}

fn ask(map: &LoadedMap, request: &MatchRequest) -> (Vec<MatchedKeyframe>, MatchStatus) {
    let mut replies = map.answer(request, &RecognitionOptions::default()).unwrap();
    for reply in &replies {
        reply.validate().unwrap();
    }
    let Some(MatchReply::Done(status)) = replies.pop() else { panic!("no final status") };
    let keyframes: Vec<_> = replies
        .into_iter()
        .map(|reply| match reply {
            MatchReply::Keyframe(keyframe) => keyframe,
            MatchReply::Done(_) => panic!("two final statuses"),
        })
        .collect();
    assert_eq!(usize::from(status.keyframes_sent), keyframes.len());
    assert_eq!(status.outcome == MatchOutcome::Matched, !keyframes.is_empty());
    (keyframes, status)
}

/// A camera pose near the path, and not on a keyframe.
fn random_pose(place: &Place, rng: &mut StdRng) -> Pose {
    let along = rng.random_range(1.0..2.0 * place.path.len() as f64 - 3.0);
    place.camera_at(along, rng.random_range(-1.0..1.0), rng.random_range(-0.3..0.3))
}

fn localize_request(request: MatchRequest) -> LocalizeRequest {
    LocalizeRequest {
        camera: request.camera,
        features: request.features,
        prior: request.prior,
        gravity_in_camera: request.gravity_in_camera,
    }
}

fn prior_at(pose: Pose, sigma: f64) -> PosePrior {
    PosePrior { global_from_camera: PoseWithCovariance::new(pose, Matrix6::identity() * sigma.powi(2)) }
}

#[test]
fn nearly_every_image_is_recognized_where_it_was_taken() {
    let repeated = PlaceOptions { repeated_descriptors: 15, repeated_share: 0.3, ..PlaceOptions::default() };
    for options in [PlaceOptions::default(), repeated] {
        let place = Place::new(&options);
        let map = loaded(&place);
        let mut rng = StdRng::seed_from_u64(11);
        let mut found = 0;
        for round in 0..40 {
            let truth = random_pose(&place, &mut rng);
            let mut request = place.request(&truth, 1, &mut rng);
            if round % 2 == 0 {
                request.gravity_in_camera =
                    Some(truth.rotation.inverse_transform_vector(&place.gravity).into());
            }
            let reply = map.localize(&localize_request(request), &RecognitionOptions::default()).unwrap();
            reply.validate().unwrap();
            let Some(fix) = reply.fix else { continue };
            found += 1;
            let error = truth.local(&fix.global_from_camera.pose);
            assert!(error.fixed_rows::<3>(3).norm() < 0.3, "round {round}: {error}");
            assert!(error.fixed_rows::<3>(0).norm() < 0.04, "round {round}: {error}");
            let nees = fix.global_from_camera.nees(&truth).unwrap();
            assert!(nees < 60.0, "round {round}: NEES {nees}");
        }
        assert!(found >= 38, "only {found} of 40 images were recognized");
    }
}

#[test]
fn an_image_of_another_place_matches_nothing() {
    let place = Place::new(&PlaceOptions::default());
    let elsewhere = Place::new(&PlaceOptions { seed: 2, ..PlaceOptions::default() });
    let map = loaded(&place);
    let mut rng = StdRng::seed_from_u64(12);
    for _ in 0..10 {
        let truth = random_pose(&elsewhere, &mut rng);
        let (_, status) = ask(&map, &elsewhere.request(&truth, 3, &mut rng));
        assert_eq!(status.outcome, MatchOutcome::NoMatch);
    }
}

/// Two halls with the same geometry and the same texture, 500 m apart, in one map.
fn twin_halls() -> (Place, LoadedMap) {
    let place = Place::new(&PlaceOptions { keyframes: 10, landmarks: 600, ..PlaceOptions::default() });
    let mut contents = place.map.clone();
    let there = Vector3::new(0.0, 500.0, 0.0);
    for mut keyframe in place.map.keyframes.clone() {
        keyframe.id += 1000;
        keyframe.global_from_keyframe.pose.translation += there;
        contents.keyframes.push(keyframe);
    }
    for mut landmark in place.map.landmarks.clone() {
        landmark.id += 100_000;
        landmark.anchor += 1000;
        for observation in &mut landmark.observations {
            observation.keyframe += 1000;
        }
        contents.landmarks.push(landmark);
    }
    let map = LoadedMap::from_contents(contents).unwrap();
    (place, map)
}

#[test]
fn of_two_places_that_look_alike_neither_wins() {
    let (place, map) = twin_halls();
    let mut rng = StdRng::seed_from_u64(13);
    for _ in 0..10 {
        let truth = random_pose(&place, &mut rng);
        let (keyframes, status) = ask(&map, &place.request(&truth, 5, &mut rng));
        assert_eq!(status.outcome, MatchOutcome::Ambiguous);
        assert!(keyframes.is_empty());
    }
}

#[test]
fn a_prior_tells_places_that_look_alike_apart() {
    let (place, map) = twin_halls();
    let mut rng = StdRng::seed_from_u64(14);
    for _ in 0..10 {
        let truth = random_pose(&place, &mut rng);
        let mut request = place.request(&truth, 1, &mut rng);
        request.prior = Some(prior_at(truth, 2.0));
        let (keyframes, status) = ask(&map, &request);
        assert_eq!(status.outcome, MatchOutcome::Matched);
        assert!(keyframes[0].keyframe.id < 1000);
        let mut elsewhere = truth;
        elsewhere.translation += Vector3::new(0.0, 500.0, 0.0);
        request.prior = Some(prior_at(elsewhere, 2.0));
        assert!(ask(&map, &request).0[0].keyframe.id >= 1000);
    }
}

#[test]
fn a_wrong_prior_costs_time_but_not_the_answer() {
    let place = Place::new(&PlaceOptions::default());
    let map = loaded(&place);
    let mut rng = StdRng::seed_from_u64(15);
    let truth = place.camera_at(5.0, 0.3, 0.1);
    let mut request = place.request(&truth, 1, &mut rng);
    let (without, _) = ask(&map, &request);
    request.prior = Some(prior_at(truth, 0.1));
    let (with, near) = ask(&map, &request);
    assert_eq!(without[0].keyframe.id, with[0].keyframe.id);
    assert!((near.searched_keyframes as usize) < map.keyframe_count());
    request.prior = Some(prior_at(place.camera_at(55.0, 0.0, 0.0), 0.1));
    let (wrong, all) = ask(&map, &request);
    assert_eq!(without[0].keyframe.id, wrong[0].keyframe.id);
    assert_eq!(all.searched_keyframes as usize, map.keyframe_count());
}

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

#[test]
fn in_a_precise_map_a_tenth_of_moved_landmarks_does_not_move_the_pose() {
    let place = Place::new(&PlaceOptions::default());
    let mut rng = StdRng::seed_from_u64(25);
    let mut contents = place.map.clone();
    contents.cross_covariances.clear();
    for (keyframe, truth) in contents.keyframes.iter_mut().zip(&place.path) {
        let covariance = Matrix6::identity() * 0.001_f64.powi(2);
        keyframe.global_from_keyframe = PoseWithCovariance::new(*truth, covariance);
    }
    for landmark in &mut contents.landmarks {
        let anchor = &place.path[(landmark.anchor - 10) as usize];
        landmark.position_in_anchor =
            anchor.inverse_transform(&place.points[(landmark.id - 1000) as usize].0);
        if landmark.id % 10 == 0 {
            // Within what verification allows, and all to the same side.
            landmark.position_in_anchor.x += landmark.position_in_anchor.z * 6.0 / 458.0;
            for seen in &mut landmark.observations {
                seen.pixel[0] = (seen.pixel[0] + 6.0).min(751.0);
            }
        }
    }
    let map = LoadedMap::from_contents(contents).unwrap();
    let (mut errors, mut nees, mut inliers, mut matched) = (Vec::new(), Vec::new(), 0, 0);
    for _ in 0..20 {
        let truth = random_pose(&place, &mut rng);
        let request = localize_request(place.request(&truth, 1, &mut rng));
        let fix = map.localize(&request, &RecognitionOptions::default()).unwrap().fix.unwrap();
        inliers += fix.inliers;
        matched += fix.matched_features;
        errors.push(truth.local(&fix.global_from_camera.pose).fixed_rows::<3>(3).norm());
        nees.push(fix.global_from_camera.nees(&truth).unwrap());
    }
    assert!(f64::from(inliers) < 0.97 * f64::from(matched), "{inliers} of {matched}");
    errors.sort_by(f64::total_cmp);
    nees.sort_by(f64::total_cmp);
    assert!(errors[10] < 0.02 && errors[19] < 0.06, "{errors:?}");
    assert!(nees[10] < 12.0, "{nees:?}");
}

#[test]
fn the_uncertainty_of_the_keyframes_is_in_the_fix_and_common_errors_do_not_average_out() {
    let place = Place::new(&PlaceOptions::default());
    let mut contents = place.map.clone();
    contents.cross_covariances.clear();
    let covariance = Matrix6::from_diagonal(&Vector6::new(1e-8, 1e-8, 1e-8, 0.25, 0.25, 0.25));
    for keyframe in &mut contents.keyframes {
        keyframe.global_from_keyframe.covariance = covariance;
    }
    let request = place.request(&place.camera_at(10.0, 0.0, 0.0), 1, &mut StdRng::seed_from_u64(22));
    let request = localize_request(request);
    let variance_in = |contents: MapContents| {
        let map = LoadedMap::from_contents(contents).unwrap();
        let fix = map.localize(&request, &RecognitionOptions::default()).unwrap().fix.unwrap();
        fix.global_from_camera.covariance[(4, 4)]
    };
    let independent = variance_in(contents.clone());
    assert!((0.25 / 7.0..0.25).contains(&independent), "{independent}");
    let ids: Vec<u64> = contents.keyframes.iter().map(|keyframe| keyframe.id).collect();
    for (at, &a) in ids.iter().enumerate() {
        contents.cross_covariances.extend(ids[at + 1..].iter().map(|&b| KeyframeCrossCovariance {
            a,
            b,
            block: covariance,
        }));
    }
    let listed = variance_in(contents.clone());
    assert!((0.24..0.3).contains(&listed), "{listed}");

    // As a map of many keyframes states it: half of it common to all, the rest pair by pair.
    let factor =
        Matrix6xX::from_columns(&(covariance * 0.5).map(f64::sqrt).column_iter().collect::<Vec<_>>());
    contents.cross_covariances.iter_mut().for_each(|cross| cross.block *= 0.5);
    contents.common_errors =
        ids.iter().map(|&keyframe| CommonError { keyframe, factor: factor.clone() }).collect();
    let stated = variance_in(contents);
    assert!((stated - listed).abs() < 1e-6 * listed, "{stated} and {listed}");
}

#[test]
fn a_camera_with_a_wrong_focal_length_gets_no_pose() {
    let place = Place::new(&PlaceOptions::default());
    let map = loaded(&place);
    let mut rng = StdRng::seed_from_u64(21);
    let (mut given, mut wrong_by_far) = ([0; 3], 0);
    for _ in 0..20 {
        let truth = random_pose(&place, &mut rng);
        let request = localize_request(place.request(&truth, 1, &mut rng));
        for (index, factor) in [1.0, 0.85, 1.15].into_iter().enumerate() {
            let mut wrong = request.clone();
            wrong.camera.focal = wrong.camera.focal.map(|focal| focal * factor);
            let reply = map.localize(&wrong, &RecognitionOptions::default()).unwrap();
            let Some(fix) = reply.fix else { continue };
            given[index] += 1;
            wrong_by_far += usize::from(fix.global_from_camera.nees(&truth).unwrap() > 100.0);
        }
    }
    assert!(given[0] >= 19 && given[1] + given[2] <= 2, "{given:?}, {wrong_by_far}");
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
    assert_eq!(map.listed_pairs().count(), contents.cross_covariances.len());
    assert_eq!(map.cross_covariance(u64::MAX, contents.keyframes[0].id), None);
}

/// With a prior, the search ends once enough keyframes agree with it: with the pose that the search of all has.
#[test]
fn a_good_prior_does_not_change_the_pose() {
    let place = Place::new(&PlaceOptions::default());
    let map = loaded(&place);
    let mut rng = StdRng::seed_from_u64(35);
    let mut compared = 0;
    for _ in 0..30 {
        let truth = random_pose(&place, &mut rng);
        let mut request = localize_request(place.request(&truth, 3, &mut rng));
        let without = map.localize(&request, &RecognitionOptions::default()).unwrap();
        request.prior = Some(prior_at(truth, 0.1));
        let with = map.localize(&request, &RecognitionOptions::default()).unwrap();
        assert!(with.fix.is_some() || without.fix.is_none());
        let (Some(with), Some(without)) = (with.fix, without.fix) else { continue };
        let apart = with.global_from_camera.pose.local(&without.global_from_camera.pose);
        assert!(apart.fixed_rows::<3>(0).norm() < 0.01 && apart.fixed_rows::<3>(3).norm() < 0.1, "{apart}");
        compared += 1;
    }
    assert!(compared >= 25, "{compared}");
}

#[test]
fn keyframes_that_look_the_other_way_are_not_near_and_the_search_of_all_follows() {
    let place = Place::new(&PlaceOptions::default());
    let map = loaded(&place);
    let mut rng = StdRng::seed_from_u64(36);
    let truth = place.camera_at(20.0, 0.3, 0.1);
    let mut request = place.request(&truth, 1, &mut rng);
    request.prior = Some(prior_at(place.camera_at(20.0, 0.3, 0.1 + std::f64::consts::PI), 0.1));
    let (keyframes, turned) = ask(&map, &request);
    assert!(!keyframes.is_empty());
    assert_eq!(turned.searched_keyframes as usize, map.keyframe_count());
    // A robot that does not know its heading says so.
    let mut uncertain = prior_at(place.camera_at(20.0, 0.3, 0.1 + std::f64::consts::PI), 0.1);
    uncertain.global_from_camera.covariance.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    request.prior = Some(uncertain);
    let (_, near) = ask(&map, &request);
    assert!((near.searched_keyframes as usize) < map.keyframe_count());
}
