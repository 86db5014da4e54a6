//! Laws of place recognition, on seeded synthetic places.

use crate::common::{ask, loaded, localize_request, prior_at, random_pose};
use map::model::{Keyframe, Observation};
use nalgebra::{Vector2, Vector3};
use protocol::{MatchOutcome, Validate};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use recognition::{LoadedMap, RecognitionOptions};
use testing::{Place, PlaceOptions, add_copy_beside};

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

/// A place, and twelve keyframes side by side far away that see all of its landmarks anywhere in their images.
fn place_with_medley() -> (Place, LoadedMap) {
    let place = Place::new(&PlaceOptions::default());
    let mut contents = place.map.clone();
    let mut rng = StdRng::seed_from_u64(7);
    let medley: Vec<Keyframe> = (0..12_u64)
        .map(|number| {
            let mut keyframe = contents.keyframes[10].clone();
            keyframe.id = 100 + number;
            keyframe.global_from_keyframe.pose.translation += Vector3::new(500.0, 0.2 * number as f64, 0.0);
            keyframe
        })
        .collect();
    let originals = contents.landmarks.clone();
    for original in originals {
        let mut landmark = original.clone();
        landmark.id += 100_000;
        let descriptor = original.observations[0].descriptor.clone();
        let seen = |keyframe: &Keyframe, rng: &mut StdRng| Observation {
            keyframe: keyframe.id,
            pixel: [rng.random_range(5.0..745.0), rng.random_range(5.0..475.0)],
            descriptor: descriptor.clone(),
        };
        landmark.observations = medley.iter().map(|keyframe| seen(keyframe, &mut rng)).collect();
        landmark.anchor = medley[0].id;
        let ray =
            place.camera.unproject(&Vector2::from(landmark.observations[0].pixel.map(f64::from))).unwrap();
        landmark.position_in_anchor = ray.push(1.0) * rng.random_range(3.0..20.0);
        contents.landmarks.push(landmark);
    }
    // The medley has more of an image than the place has, where a third was changed.
    contents.landmarks.retain(|landmark| landmark.id > 100_000 || landmark.id % 3 > 0);
    contents.keyframes.extend(medley);
    contents.sort();
    (place, LoadedMap::from_contents(contents).unwrap())
}

#[test]
fn neighbours_that_outvote_the_place_of_an_image_leave_room_for_it() {
    let (place, map) = place_with_medley();
    let mut rng = StdRng::seed_from_u64(8);
    for x in [13.0, 23.0, 33.0] {
        let truth = place.camera_at(x, 0.8, 0.05);
        let request = place.request(&truth, 4, &mut rng);
        let ranked = map.rank_keyframes(&request.features, 10).unwrap();
        assert!(ranked.iter().all(|id| *id >= 100), "{ranked:?}");
        let reply = map.localize(&localize_request(request), &RecognitionOptions::default()).unwrap();
        let found = reply.fix.unwrap().global_from_camera.pose;
        assert!((found.translation - truth.translation).norm() < 0.3, "{x}: {found:?}");
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
    add_copy_beside(&mut contents, Vector3::new(0.0, 500.0, 0.0), [1000, 100_000]);
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
fn places_that_look_like_no_other_one_are_told_apart() {
    let place = Place::new(&PlaceOptions { keyframes: 10, landmarks: 600, ..PlaceOptions::default() });
    let (alone, (_, twins)) = (loaded(&place), twin_halls());
    let mut rng = StdRng::seed_from_u64(16);
    let mut told_apart = 0;
    for _ in 0..10 {
        let truth = random_pose(&place, &mut rng);
        let request = place.request(&truth, 1, &mut rng);
        let places = |map: &LoadedMap| {
            map.weighed_places(&request.camera, &request.features, None, &RecognitionOptions::default())
                .unwrap()
        };
        let of_twins = places(&twins);
        assert!(!of_twins.is_empty() && of_twins.iter().all(|(_, is_told_apart)| !is_told_apart));
        let of_one = places(&alone);
        let certain = of_one.iter().filter(|(_, is_told_apart)| *is_told_apart);
        for (found, _) in certain.clone() {
            let error = truth.local(&found.global_from_camera.pose);
            assert!(error.fixed_rows::<3>(3).norm() < 0.5, "{error}");
        }
        told_apart += usize::from(certain.count() > 0);
    }
    assert!(told_apart >= 8, "only {told_apart} of 10");
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
