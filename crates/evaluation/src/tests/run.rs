//! The score of a run sees what the pose in G hides.

use super::*;
use crate::trajectory::StateRow;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::Matrix6;
use sensors::TruthRow;

/// The true pose of L in G; gravity in G is along -x.
fn true_global_from_local() -> Pose {
    let level = alignment::rotation_between(&gravity(), &-Vector3::z());
    Pose::new(level * rotation(0.0, 0.0, 1.2), Vector3::new(7.0, -2.0, 3.0))
}

fn gravity() -> Vector3<f64> {
    -Vector3::x()
}

fn truth() -> Vec<TruthRow> {
    let row = |stamped: StampedPose| TruthRow {
        stamp_ns: stamped.stamp_ns,
        pose: stamped.pose,
        velocity: None,
        gyroscope_bias: None,
        accelerometer_bias: None,
    };
    reference().into_iter().map(row).collect()
}

fn certain(pose: Pose) -> PoseWithCovariance {
    PoseWithCovariance::new(pose, Matrix6::identity() * 1e-4)
}

/// A perfect run whose map initialization comes at the 40th frame, with L moved against the truth by `gauge`.
fn states(gauge: impl Fn(usize) -> Pose) -> Vec<StateRow> {
    let global_from_local = true_global_from_local();
    truth()
        .iter()
        .enumerate()
        .map(|(index, row)| {
            let local_from_imu = gauge(index).compose(&global_from_local.inverse()).compose(&row.pose);
            let is_initialized = index >= 40;
            StateRow {
                stamp_ns: row.stamp_ns,
                local_from_imu: certain(local_from_imu),
                global_from_local: is_initialized
                    .then(|| certain(global_from_local.compose(&gauge(index).inverse()))),
                global_from_imu: is_initialized.then(|| certain(row.pose)),
            }
        })
        .collect()
}

#[test]
fn a_perfect_run_has_no_error_wherever_local_lies() {
    let score =
        score_run(&states(|_| Pose::identity()), &truth(), gravity(), &ScoreOptions::default()).unwrap();
    for part in [Some(score.local), score.transform, score.pose] {
        let part = part.unwrap();
        assert!(part.max_deg < 1e-6 && part.max_m < 1e-9, "{part:?}");
        assert!(part.nees_pose.unwrap() < 1e-9);
    }
    assert!(score.odometry_yaw_aligned_m.max < 1e-9);
    assert_eq!((score.local.samples, score.pose.unwrap().samples), (200, 200 - 40 - 100));
    assert!(
        (score.map_initialization_s.unwrap() - 2.0).abs() < 1e-9 && (score.duration_s - 9.95).abs() < 1e-9
    );
    let errors = run_errors(&states(|_| Pose::identity()), &truth(), gravity()).unwrap();
    assert!(errors.true_global_from_local.local(&true_global_from_local()).amax() < 1e-9);
}

#[test]
fn turning_and_moving_all_of_local_about_gravity_changes_nothing() {
    let gauge = Pose::new(rotation(0.0, 0.0, -2.0), Vector3::new(1.0, 2.0, 3.0));
    let score = score_run(&states(|_| gauge), &truth(), gravity(), &ScoreOptions::default()).unwrap();
    assert!(score.local.max_m < 1e-9 && score.transform.unwrap().max_m < 1e-9);
}

#[test]
fn a_drifting_gauge_shows_in_local_and_transform_but_not_in_the_pose() {
    let drift =
        |index: usize| Pose::new(rotation(0.0, 0.0, 1e-4 * index as f64), Vector3::x() * 1e-3 * index as f64);
    let score = score_run(&states(drift), &truth(), gravity(), &ScoreOptions::default()).unwrap();
    let (transform, pose) = (score.transform.unwrap(), score.pose.unwrap());
    assert!(pose.max_m < 1e-9 && pose.max_deg < 1e-6);
    assert!(transform.rmse_m > 0.1 && transform.nees_pose.unwrap() > 10.0, "{transform:?}");
    assert!(score.local.rmse_m > 0.05 && score.local.nees_pose.unwrap() > 10.0);
    assert!((transform.max_deg - 0.0199_f64.to_degrees()).abs() < 1e-6);
}

#[test]
fn an_error_in_tilt_counts_as_an_error_of_local() {
    let tilt = Pose::new(rotation(0.01, -0.02, 0.0), Vector3::zeros());
    let score = score_run(&states(|_| tilt), &truth(), gravity(), &ScoreOptions::default()).unwrap();
    assert!((score.local.rmse_deg - 5e-4_f64.sqrt().to_degrees()).abs() < 1e-3, "{:?}", score.local);
    assert!(score.pose.unwrap().max_m < 1e-9);
}

#[test]
fn truth_between_the_frames_is_interpolated_but_not_over_gaps() {
    let mut rows = truth();
    let states = states(|_| Pose::identity());
    // Every other row gone: 100 ms apart. Then a hole of 1 s.
    rows = rows.into_iter().step_by(2).collect();
    let halved = score_run(&states, &rows, gravity(), &ScoreOptions::default()).unwrap();
    assert_eq!(halved.local.samples, 199);
    assert!(halved.pose.unwrap().max_m < 0.02);
    rows.drain(20..30);
    let holed = score_run(&states, &rows, gravity(), &ScoreOptions::default()).unwrap();
    assert_eq!(holed.local.samples, 199 - 21);
}

#[test]
fn a_run_that_never_localizes_has_a_local_score_only() {
    let mut states = states(|_| Pose::identity());
    for state in &mut states {
        (state.global_from_local, state.global_from_imu) = (None, None);
    }
    let score = score_run(&states, &truth(), gravity(), &ScoreOptions::default()).unwrap();
    assert!(score.pose.is_none() && score.transform.is_none() && score.map_initialization_s.is_none());
    assert_eq!(
        score_run(&states, &truth()[..1], -gravity(), &ScoreOptions::default()).unwrap().local.samples,
        1
    );
    let late: Vec<_> =
        truth().into_iter().map(|row| TruthRow { stamp_ns: row.stamp_ns + (1 << 40), ..row }).collect();
    let score = score_run(&states, &late, gravity(), &ScoreOptions::default());
    assert!(matches!(score, Err(ScoreError::NoOverlap)));
}

#[test]
fn a_map_with_a_frame_of_its_own_is_compared_after_an_alignment_that_is_stated() {
    // The map's z points up; the truth's x does.
    let level = alignment::rotation_between(&-Vector3::z(), &gravity());
    let map_from_truth = Pose::new(rotation(0.0, 0.0, 1.4) * level, Vector3::new(3.0, -1.0, 0.2));
    let mut states = states(|_| Pose::identity());
    for state in &mut states {
        for pose in [&mut state.global_from_local, &mut state.global_from_imu].into_iter().flatten() {
            pose.pose = map_from_truth.compose(&pose.pose);
        }
    }
    let unaligned = score_run(&states, &truth(), gravity(), &ScoreOptions::default()).unwrap();
    assert!(unaligned.map_from_truth.is_none() && unaligned.pose.unwrap().rmse_m > 1.0);
    let options = ScoreOptions { gravity_in_own_frame: Some(-Vector3::z()), ..ScoreOptions::default() };
    let score = score_run(&states, &truth(), gravity(), &options).unwrap();
    let aligned = score.map_from_truth.unwrap();
    assert!(aligned.pose().local(&map_from_truth).amax() < 1e-6, "{aligned}");
    assert!(aligned.to_string().contains("aligned with it in yaw and position"));
    // The alignment took the constant part of the errors in the map away.
    let in_map = [score.transform.unwrap(), score.pose.unwrap()];
    assert!(in_map.iter().all(|part| part.nees_pose.is_none() && part.nees_position.is_none()), "{in_map:?}");
    assert!(score.local.nees_pose.is_some() && unaligned.pose.unwrap().nees_pose.is_some());
    for part in [Some(score.local), score.transform, score.pose] {
        assert!(part.unwrap().max_m < 1e-6, "{part:?}");
    }
    assert!((score.odometry_yaw_aligned_m.rmse - unaligned.odometry_yaw_aligned_m.rmse).abs() < 1e-9);
    // The aligned truth gives the same errors, as plots draw them.
    let rows: Vec<_> = truth().iter().map(|row| aligned.apply(row)).collect();
    let errors = run_errors(&states, &rows, aligned.gravity()).unwrap();
    assert!(errors.pose.iter().all(|sample| sample.error.amax() < 1e-6));
}
