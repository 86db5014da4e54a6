//! A place is believed for what it explains of an image: one picture that repeats elsewhere is no place.

use geometry::Pose;
use map::{Alias, KeyframeAliases, MapContents, MapMetadata};
use nalgebra::Vector3;
use protocol::{LocalizeRequest, MapIdentity, MatchOutcome, PosePrior};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use recognition::{LoadedMap, RecognitionOptions};
use testing::{POSTER_LANDMARKS, Place, PlaceOptions};

use crate::common::prior_at;

fn dense_place() -> Place {
    Place::new(&PlaceOptions { keyframes: 12, landmarks: 6000, ..PlaceOptions::default() })
}

/// The query of an image in which only some features show what the map has seen there.
fn request(
    place: &Place,
    truth: &Pose,
    rng: &mut StdRng,
    is_as_before: impl Fn([f32; 2]) -> bool,
) -> LocalizeRequest {
    let request = place.request(truth, 1, rng);
    let mut features = request.features;
    let width = features.descriptors.bytes.len() / features.pixels.len();
    for (descriptor, pixel) in features.descriptors.bytes.chunks_exact_mut(width).zip(&features.pixels) {
        if !is_as_before(*pixel) {
            for byte in descriptor {
                *byte = rng.random();
            }
        }
    }
    let (camera, gravity_in_camera) = (request.camera, request.gravity_in_camera);
    LocalizeRequest { camera, features, prior: None, gravity_in_camera }
}

fn pose(place: &Place, rng: &mut StdRng) -> Pose {
    let along = rng.random_range(2.0..2.0 * place.path.len() as f64 - 4.0);
    place.camera_at(along, rng.random_range(-0.3..0.3), rng.random_range(-0.1..0.1))
}

/// Whether a pixel shows one of some points (pixels).
fn shows(place: &Place, from: &Pose, points: &[(Vector3<f64>, Vec<u8>)], pixel: [f32; 2]) -> bool {
    points.iter().any(|(point, _)| {
        let projected = place.camera.project(&from.inverse_transform(point));
        projected.is_ok_and(|at| (at - nalgebra::Vector2::from(pixel.map(f64::from))).norm() < 2.0)
    })
}

#[test]
fn one_picture_of_a_place_is_ambiguous_however_many_matches_it_has_and_its_odds_are_listed() {
    let landmarks = 6000;
    let options = PlaceOptions { keyframes: 12, landmarks, posters: 8, ..PlaceOptions::default() };
    let place = Place::new(&options);
    let map = LoadedMap::from_contents(place.map.clone()).unwrap();
    let mut rng = StdRng::seed_from_u64(31);
    let (mut seen, mut two_were_claimed) = (0, 0);
    for trial in 0..20 {
        // Poster `at` begins at four times its number along the path; the camera is some metres before it.
        let at = 2 + trial % 4;
        let truth =
            place.camera_at(4.0 * at as f64 - rng.random_range(5.0..6.0), rng.random_range(-0.3..0.3), 0.0);
        let posters = |count: usize| {
            let first = landmarks + at * POSTER_LANDMARKS;
            &place.points[first..first + count * POSTER_LANDMARKS]
        };
        let mut localize = |count: usize| {
            let is_of_posters = |pixel: [f32; 2]| shows(&place, &truth, posters(count), pixel);
            let request = request(&place, &truth, &mut rng, is_of_posters);
            map.localize_with_report(&request, &RecognitionOptions::default()).unwrap()
        };
        let (reply, report) = localize(1);
        assert_eq!(reply.fix, None);
        if let Some(hypothesis) = report.hypotheses.first() {
            seen += 1;
            assert!(hypothesis.place.features >= 30 && hypothesis.log_odds() < 0.0, "{hypothesis:?}");
            let strongest = report.place.as_ref().unwrap();
            assert_eq!((reply.outcome, strongest), (MatchOutcome::Ambiguous, &hypothesis.place));
        }
        two_were_claimed += usize::from(localize(2).0.fix.is_some());
    }
    assert!(seen >= 18 && two_were_claimed >= 10, "{seen}, {two_were_claimed}");
}

#[test]
fn a_place_of_which_half_has_changed_is_still_found() {
    half_of_a_place_is_found(10);
}

#[test]
#[ignore = "more images"]
fn a_place_of_which_half_has_changed_is_still_found_in_twenty_images() {
    half_of_a_place_is_found(20);
}

fn half_of_a_place_is_found(images: usize) {
    let place = dense_place();
    let map = LoadedMap::from_contents(place.map.clone()).unwrap();
    let mut rng = StdRng::seed_from_u64(32);
    let mut found = 0;
    for _ in 0..images {
        let truth = pose(&place, &mut rng);
        // Chequered, in squares of 80 px.
        let remains = |pixel: [f32; 2]| ((pixel[0] / 80.0) as i32 + (pixel[1] / 80.0) as i32) % 2 == 0;
        let request = request(&place, &truth, &mut rng, remains);
        let (reply, report) = map.localize_with_report(&request, &RecognitionOptions::default()).unwrap();
        let Some(fix) = reply.fix else { continue };
        found += 1;
        assert!(truth.local(&fix.global_from_camera.pose).fixed_rows::<3>(3).norm() < 0.3);
        assert!(report.hypotheses[0].log_odds() > 0.0);
    }
    assert!(10 * found >= 9 * images, "{found}");
}

#[test]
fn only_what_fits_the_claimed_pose_well_confirms_a_part() {
    let place = dense_place();
    // One keyframe: where several match a feature, one of them may fit by the errors of the map.
    let mut options = RecognitionOptions::default();
    options.candidates = 1;
    for extractor in ["sift-1", "edgepoint2-1"] {
        let mut contents = place.map.clone();
        contents.info.extractor = extractor.to_owned();
        let map = LoadedMap::from_contents(contents).unwrap();
        let confirmed = |request: &LocalizeRequest| {
            let (_, report) = map.localize_with_report(request, &options).unwrap();
            report.hypotheses[0].coverage.of_image().confirmed
        };
        let mut rng = StdRng::seed_from_u64(33);
        let (mut whole, mut blurred) = (0, 0);
        for _ in 0..3 {
            let truth = pose(&place, &mut rng);
            let mut request = request(&place, &truth, &mut rng, |_| true);
            request.features.extractor = extractor.to_owned();
            whole += confirmed(&request);
            // What one half of the image shows is nearly where an inlier is no longer one.
            let off = 0.8 * options.inlier_angle * request.camera.focal[0];
            let half = f64::from(request.camera.width) / 2.0;
            for pixel in request.features.pixels.iter_mut().filter(|pixel| f64::from(pixel[0]) < half) {
                let angle: f64 = rng.random_range(0.0..std::f64::consts::TAU);
                pixel[0] += (off * angle.cos()) as f32;
                pixel[1] += (off * angle.sin()) as f32;
            }
            blurred += confirmed(&request);
        }
        // The parts of the other half are confirmed.
        assert!(whole > 30 && 10 * blurred <= 9 * whole, "{extractor}: {blurred} of {whole}");
    }
}

/// The same hall once more beside itself, with landmarks and keyframes of its own.
fn twice(once: &MapContents, beside: Vector3<f64>) -> MapContents {
    let (keyframes, landmarks) = (1000, 1_000_000);
    let mut both = once.clone();
    both.keyframes.extend(once.keyframes.iter().cloned().map(|mut keyframe| {
        keyframe.id += keyframes;
        keyframe.global_from_keyframe.pose.translation += beside;
        keyframe
    }));
    both.landmarks.extend(once.landmarks.iter().cloned().map(|mut landmark| {
        landmark.id += landmarks;
        landmark.anchor += keyframes;
        landmark.observations.iter_mut().for_each(|observation| observation.keyframe += keyframes);
        landmark
    }));
    both.sort();
    both
}

#[test]
fn a_map_knows_that_its_halls_look_alike_and_which_keyframe_is_like_which() {
    let place = dense_place();
    let once = LoadedMap::from_contents(place.map.clone()).unwrap();
    let rate = once.aliasing_rate();
    assert!(rate.aliased == 0.0 && rate.views > 1.0, "{rate:?}");

    let beside = Vector3::new(0.0, 50.0, 0.0);
    let both = LoadedMap::from_contents(twice(&place.map, beside)).unwrap();
    let rate = both.aliasing_rate();
    assert!(rate.aliased > 0.9 * rate.views && rate.log_odds() < 0.2, "{rate:?}");
    for keyframe in once.keyframes() {
        let own = &keyframe.global_from_keyframe.pose;
        let alias = both.keyframe_aliases(keyframe.id).unwrap().places[0];
        let found = &both.keyframe(alias.keyframe).unwrap().global_from_keyframe.pose;
        assert!((found.translation - own.translation - beside).norm() < 2.5, "{alias:?}");
        assert!(alias.log_odds > 0.0, "{alias:?}");
    }
    // A map that states them is not searched: here it states what is not so.
    let mut stated = twice(&place.map, beside);
    let ids: Vec<u64> = both.keyframes().map(|keyframe| keyframe.id).collect();
    let none = |&keyframe: &u64| KeyframeAliases { keyframe, places: Vec::new() };
    stated.aliases = ids.iter().map(none).collect();
    let rate = LoadedMap::from_contents(stated.clone()).unwrap().aliasing_rate();
    assert!(rate.aliased == 0.0 && rate.views > 1.0, "{rate:?}");
    for (at, aliases) in stated.aliases.iter_mut().enumerate().filter(|(at, _)| at % 4 == 0) {
        aliases.places.push(Alias { keyframe: ids[at + 1], log_odds: 0.5 });
    }
    let rate = LoadedMap::from_contents(stated).unwrap().aliasing_rate();
    assert!((rate.aliased - 0.25 * rate.views).abs() < 1e-9, "{rate:?}");
}

#[test]
fn a_new_version_keeps_the_rate_of_the_former_unless_it_states_its_own_or_has_other_keyframes() {
    let contents = dense_place().map;
    let stating = |keyframes: Vec<u64>| {
        let mut contents = contents.clone();
        let of = |keyframe| KeyframeAliases {
            keyframe,
            places: vec![Alias { keyframe: contents.keyframes[0].id, log_odds: 3.0 }],
        };
        contents.aliases = keyframes.into_iter().map(of).collect();
        contents.info.identity = Some(MapIdentity::from_bytes([7; 16]));
        contents
    };
    let all: Vec<u64> = contents.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let former = LoadedMap::from_contents(stating(all[1..].to_vec())).unwrap();
    let rate_after = |contents: MapContents| {
        let version = LoadedMap::from_contents(contents).unwrap();
        version.keep_aliasing_rate(&former);
        version.aliasing_rate()
    };
    let of_former = former.aliasing_rate();
    assert!((of_former.aliased - of_former.views).abs() < 1e-9, "{of_former:?}");
    assert_eq!(rate_after(stating(Vec::new())), of_former);
    let own = rate_after(twice(&stating(Vec::new()), Vector3::new(0.0, 50.0, 0.0)));
    assert_ne!(own, of_former);
    let other = MapContents { info: MapMetadata { identity: None, ..contents.info.clone() }, ..contents };
    assert!(rate_after(other).aliased < 1e-9);
}

#[test]
fn the_odds_of_an_answer_are_smaller_in_a_map_that_looks_like_itself() {
    let place = dense_place();
    let [once, both] = [place.map.clone(), twice(&place.map, Vector3::new(0.0, 50.0, 0.0))]
        .map(|contents| LoadedMap::from_contents(contents).unwrap());
    let mut rng = StdRng::seed_from_u64(33);
    let truth = pose(&place, &mut rng);
    let request = request(&place, &truth, &mut rng, |_| true);
    let options = RecognitionOptions::default();
    let (reply, report) = once.localize_with_report(&request, &options).unwrap();
    assert!(reply.fix.is_some());
    let (ambiguous, other) = both.localize_with_report(&request, &options).unwrap();
    assert_eq!((ambiguous.outcome, ambiguous.fix), (MatchOutcome::Ambiguous, None));
    assert_eq!(ambiguous.places.len(), 2);
    let apart = ambiguous.places[0].global_from_camera.pose.translation
        - ambiguous.places[1].global_from_camera.pose.translation;
    assert!((apart.norm() - 50.0).abs() < 0.5, "{apart}");
    assert!(other.hypotheses[0].log_odds() < report.hypotheses[0].log_odds() - 1.0);
}

#[test]
fn odds_that_are_too_small_are_enough_only_where_a_tight_prior_supports_the_pose() {
    let place = dense_place();
    let map = LoadedMap::from_contents(place.map.clone()).unwrap();
    let mut rng = StdRng::seed_from_u64(41);
    let truth = place.camera_at(8.0, 0.1, 0.0);
    let mut request = request(&place, &truth, &mut rng, |_| true);
    // No answer has such odds.
    let mut options = RecognitionOptions::default();
    options.min_fix_log_odds = 1e3;
    let mut outcome = |prior: Option<PosePrior>| {
        request.prior = prior;
        let reply = map.localize(&request, &options).unwrap();
        assert_eq!(reply.fix.is_some(), reply.outcome == MatchOutcome::Matched);
        reply.outcome
    };
    let beside = |metres: f64| place.camera_at(8.0 + metres, 0.1, 0.0);
    assert_eq!(outcome(None), MatchOutcome::Ambiguous);
    assert_eq!(outcome(Some(prior_at(beside(0.1), 0.1))), MatchOutcome::Matched);
    // The place is found near the prior, but not where the prior says.
    assert_eq!(outcome(Some(prior_at(beside(1.0), 0.1))), MatchOutcome::Ambiguous);
    assert_eq!(outcome(Some(prior_at(beside(12.0), 0.1))), MatchOutcome::Ambiguous);
    // Everything is near.
    assert_eq!(outcome(Some(prior_at(beside(0.1), 100.0))), MatchOutcome::Ambiguous);
}
