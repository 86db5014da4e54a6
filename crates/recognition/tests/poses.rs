//! Laws of the pose of an image.

use crate::common::{loaded, localize_request, random_pose};
use geometry::PoseWithCovariance;
use map::{CommonError, KeyframeCrossCovariance, MapContents};
use nalgebra::{Matrix6, Matrix6xX, Vector6};
use rand::SeedableRng;
use rand::rngs::StdRng;
use recognition::{LoadedMap, RecognitionOptions};
use testing::{Place, PlaceOptions};

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
