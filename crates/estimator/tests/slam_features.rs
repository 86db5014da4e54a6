//! What landmarks in the state promise: they enter as the dense filter would let them, correct the state, and leave.

use crate::common::{FRAME_NS, World, assert_finite};
use estimator::covariance::JointCovariance;
use estimator::linear_algebra::dense::Dense;
use estimator::{EstimatorConfig, TrackReport};
use geometry::{Pose, PoseWithCovariance};
use nalgebra::{DMatrix, Matrix6, Matrix6xX, Vector2};
use rand::{RngExt as _, SeedableRng, rngs::StdRng};

#[test]
fn what_enters_the_state_is_correlated_as_in_the_dense_filter() {
    let mut rng = StdRng::seed_from_u64(5);
    let mut draw =
        |rows: usize, columns: usize| DMatrix::from_fn(rows, columns, |_, _| rng.random_range(-1.0..1.0));
    let (dim, at) = (33, 21);
    let root = draw(dim, dim);
    let covariance = &root * root.transpose();
    let mut joint = JointCovariance::new(covariance.clone(), 4);
    // A keyframe that the state already depends on.
    let keyframe = PoseWithCovariance { pose: Pose::identity(), covariance: Matrix6::identity() * 0.2 };
    let slot = joint.held.activate_or_insert(1, &keyframe, &Matrix6xX::zeros(0), &[]);
    let columns = estimator::measurement::StateBlocks {
        keyframes: vec![slot],
        ..estimator::measurement::StateBlocks::of_active(std::iter::once(0..dim))
    };
    let mut information = estimator::measurement::Information::new(columns);
    information.add(&draw(8, dim + 6), &draw(8, 1).column(0).into_owned());
    joint.information_update(&information, &mut nalgebra::DVector::zeros(0)).unwrap();
    let (before, cross_before) = (joint.active().view().into_owned(), joint.held.cross_covariance(slot));

    // Two landmarks that depend on two separate ranges.
    let ranges = estimator::measurement::StateBlocks::of_active([15..18, 21..33]);
    let jacobian = draw(6, 15);
    let noises = [draw(3, 3), draw(3, 3)].map(|half| &half * half.transpose());
    joint.insert(at, &ranges, &Dense::from(jacobian.clone()), noises.iter().cloned());

    let mut over_all = DMatrix::zeros(6, dim);
    over_all.columns_mut(15, 3).copy_from(&jacobian.columns(0, 3));
    over_all.columns_mut(21, 12).copy_from(&jacobian.columns(3, 12));
    let mut full = DMatrix::zeros(dim + 6, dim);
    full.view_mut((0, 0), (at, at)).fill_with_identity();
    full.rows_mut(at, 6).copy_from(&over_all);
    full.view_mut((at + 6, at), (dim - at, dim - at)).fill_with_identity();
    let mut expected = &full * before * full.transpose();
    for (k, noise) in noises.iter().enumerate() {
        let mut block = expected.view_mut((at + 3 * k, at + 3 * k), (3, 3));
        block += noise;
    }
    assert!((joint.active().view() - expected).amax() < 1e-10);
    assert!((joint.held.cross_covariance(slot) - full * cross_before).amax() < 1e-10);
}

/// Runs for `frames` images, of which the pixels of the features `spoiled` are wrong from `from` on.
fn run(slam_features: usize, frames: i64, spoiled: std::ops::Range<u64>, from: i64) -> (f64, TrackReport) {
    let world = World::new();
    let mut config = EstimatorConfig::default();
    (config.slam_features, config.window) = (slam_features, 8);
    let mut estimator = world.estimator(config);
    let (mut worst, mut last) = (0.0_f64, TrackReport::default());
    for frame in 1..=frames {
        World::feed_imu(&mut estimator, frame);
        estimator.time_update(frame * FRAME_NS).unwrap();
        let mut tracks = world.tracks(frame);
        for seen in tracks.iter_mut().filter(|seen| frame >= from && spoiled.contains(&seen.feature_id)) {
            seen.pixel += Vector2::new(40.0, -25.0);
        }
        last = estimator.track_update(&tracks).unwrap();
        assert_finite(&estimator);
        let error = estimator.local_from_imu().pose.local(&World::truth(frame));
        worst = worst.max(error.fixed_rows::<3>(3).norm());
    }
    (worst, last)
}

#[test]
fn they_hold_a_drift_back_that_a_short_window_lets_go() {
    let (without, report) = run(0, 60, 0..0, 0);
    assert_eq!(report.slam_features, 0);
    let (with, report) = run(15, 60, 0..0, 0);
    assert!(report.slam_features > 8, "{report:?}");
    assert!(with < 0.8 * without, "{with} m with, {without} m without");
}

#[test]
fn pixels_that_jump_away_do_not_pull_the_state_and_free_their_places() {
    let (clean, _) = run(15, 60, 0..0, 0);
    let (spoiled, report) = run(15, 60, 0..75, 40);
    assert!(spoiled < 2.0 * clean + 0.01, "{spoiled} m, {clean} m without the jump");
    assert!(report.slam_features > 8, "others took their places: {report:?}");
}
