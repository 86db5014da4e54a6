//! Measurements that no sane sender sends must not poison the filter.

use crate::common::{FRAME_NS, IMU_NS, World, accepted, assert_finite, imu_at};
use estimator::{BadImuSample, CloneId, Estimator, EstimatorConfig, EstimatorError, ImuSample, MapAnswer};
use geometry::PoseWithCovariance;
use nalgebra::{Matrix6, Matrix6xX, Vector3};

/// A filter that is localized, at the frame after which the next answer is due.
fn localized() -> (World, Estimator, CloneId, i64) {
    let world = World::new();
    let mut estimator = world.estimator(EstimatorConfig::default());
    for frame in 1..=8 {
        let clone = world.frame(&mut estimator, frame);
        if frame % 4 == 0 {
            let report = estimator.map_update(clone, &world.answer(frame, frame, frame as u64)).unwrap();
            assert!(accepted(&report), "{report:?}");
        }
    }
    let clone = world.frame(&mut estimator, 9);
    (world, estimator, clone, 9)
}

/// Takes a spoilt answer, then the same keyframes as they should be, and is still a filter.
fn survives(spoil: impl Fn(&mut MapAnswer)) {
    let (world, mut estimator, clone, frame) = localized();
    let mut spoilt = world.answer(frame, frame, 50);
    spoil(&mut spoilt);
    if let Err(error) = estimator.map_update(clone, &spoilt) {
        panic!("an answer of the map broke the filter: {error}");
    }
    assert_finite(&estimator);
    for next in frame + 1..frame + 4 {
        let clone = world.frame(&mut estimator, next);
        let report = estimator.map_update(clone, &world.answer(next, frame, 50)).unwrap();
        assert!(accepted(&report), "a good answer is refused after the bad one: {report:?}");
        assert_finite(&estimator);
    }
    let error =
        estimator.global_from_imu().unwrap().pose.local(&(world.global_from_local * World::truth(frame + 3)));
    assert!(error.amax() < 0.1, "{error}");
}

#[test]
fn a_tracked_pixel_that_is_no_number() {
    let (world, mut estimator, _, frame) = localized();
    for next in frame + 1..frame + 30 {
        World::feed_imu(&mut estimator, next);
        estimator.time_update(next * FRAME_NS).unwrap();
        let mut tracks = world.tracks(next);
        tracks.iter_mut().step_by(5).for_each(|track| track.pixel.x = f64::NAN);
        tracks.iter_mut().skip(1).step_by(7).for_each(|track| track.pixel.y = f64::INFINITY);
        estimator.track_update(&tracks).unwrap();
        assert_finite(&estimator);
    }
    let error = estimator.local_from_imu().pose.local(&World::truth(frame + 29));
    assert!(error.amax() < 0.1, "{error}");
}

#[test]
fn a_matched_pixel_that_is_no_number() {
    survives(|answer| answer.landmarks[3].pixel.x = f64::NAN);
}

#[test]
fn a_pixel_of_the_map_that_is_no_number() {
    survives(|answer| answer.landmarks[3].observations[1].1.x = f64::NAN);
}

#[test]
fn a_landmark_that_is_nowhere() {
    survives(|answer| answer.landmarks[3].position_in_anchor.z = f64::NAN);
    survives(|answer| answer.landmarks[3].position_in_anchor = Vector3::zeros());
}

#[test]
fn a_keyframe_pose_that_is_no_number() {
    survives(|answer| answer.keyframes[0].global_from_keyframe.pose.translation.x = f64::NAN);
}

#[test]
fn a_keyframe_covariance_that_is_no_number() {
    survives(|answer| answer.keyframes[1].global_from_keyframe.covariance[(2, 2)] = f64::NAN);
}

#[test]
fn a_keyframe_covariance_that_is_none() {
    survives(|answer| answer.keyframes[1].global_from_keyframe.covariance[(2, 2)] = -1.0);
}

#[test]
fn a_keyframe_that_is_known_exactly() {
    survives(|answer| {
        let pose = answer.keyframes[1].global_from_keyframe.pose;
        answer.keyframes[1].global_from_keyframe = PoseWithCovariance::exact(pose);
    });
}

#[test]
fn a_cross_covariance_larger_than_the_covariances_allow() {
    survives(|answer| {
        let other = answer.keyframes[0].id;
        answer.keyframes[1].cross_covariances = vec![(other, Matrix6::identity())];
    });
    survives(|answer| {
        let other = answer.keyframes[0].id;
        answer.keyframes[1].cross_covariances = vec![(other, Matrix6::repeat(f64::NAN))];
    });
}

#[test]
fn a_common_error_larger_than_the_covariance_allows_or_of_another_map() {
    for common in
        [Matrix6xX::repeat(4, 1.0), Matrix6xX::repeat(4, f64::NAN), Matrix6xX::repeat(4, f64::INFINITY)]
    {
        survives(|answer| answer.keyframes[1].common_error = common.clone());
    }
    survives(|answer| {
        for (at, keyframe) in answer.keyframes.iter_mut().enumerate() {
            keyframe.common_error = Matrix6xX::repeat(4 + at, 1e-6);
        }
    });
}

#[test]
fn a_pixel_noise_that_is_none() {
    for sigma in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        survives(|answer| answer.sigma_map_px = sigma);
    }
}

#[test]
fn a_gravity_that_is_no_direction() {
    survives(|answer| answer.gravity_in_global = Some(Vector3::repeat(f64::NAN)));
    survives(|answer| answer.gravity_in_global = Some(Vector3::zeros()));
}

/// How many readings are spoilt, and how.
type Fault = (i64, fn(&mut ImuSample));

#[test]
fn readings_that_no_motion_explains_are_left_out_and_the_pose_stays_right() {
    let spoilt: [Fault; 6] = [
        (1, |reading| reading.gyroscope.z = 35.0),
        (1, |reading| reading.accelerometer.x = 157.0),
        (10, |reading| reading.gyroscope.z = -35.0),
        (10, |reading| reading.accelerometer.x = -157.0),
        (160, |reading| reading.gyroscope.y = 1e5),
        (160, |reading| reading.accelerometer = Vector3::repeat(1e300)),
    ];
    for (case, (count, spoil)) in spoilt.into_iter().enumerate() {
        let (world, mut estimator, _, frame) = localized();
        let from_ns = frame * FRAME_NS + 20_000_000;
        let mut refused = 0;
        for next in frame + 1..frame + 60 {
            for k in 1..=FRAME_NS / IMU_NS {
                let mut reading = imu_at((next - 1) * FRAME_NS + k * IMU_NS);
                if (from_ns..from_ns + count * IMU_NS).contains(&reading.stamp_ns) {
                    spoil(&mut reading);
                }
                match estimator.imu(reading) {
                    Err(EstimatorError::BadImu(BadImuSample::Implausible { .. })) => refused += 1,
                    other => other.unwrap(),
                }
            }
            if estimator.time_update(next * FRAME_NS).is_ok() {
                estimator.track_update(&world.tracks(next)).unwrap();
            }
        }
        assert_eq!(refused, count, "case {case}");
        let (pose, truth) = (estimator.local_from_imu(), World::truth(frame + 59));
        let (error, nees) = (pose.pose.local(&truth), pose.nees(&truth).unwrap());
        assert!(error.amax() < 0.05 && nees < 25.0, "case {case}: {error}, NEES {nees} over 6");
    }
}
