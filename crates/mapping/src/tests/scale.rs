//! Laws of the error of the scale that all lengths of a recording have in common.

use adjustment::{Bundle, Factor, PosePrior, Problem, RelativePose, gauge_information};
use geometry::pose::Pose;
use geometry::rotation;
use nalgebra::{DMatrix, Matrix6, Vector3, Vector6};

use super::dense;
use crate::joint_covariance::{FrameAndScale, JointCovariance, SCALE_SIGMA, joint_covariance};
use crate::refinement::{Constraints, pixel_model, state_covariance};
use crate::stored_poses::Posterior;

const COUNT: usize = 8;

/// A trajectory along a bend.
fn trajectory() -> Vec<Pose> {
    let pose = |at: usize| {
        let t = at as f64;
        let position = Vector3::new(3.0 * t, (0.6 * t).sin() * 4.0, 0.2 * t);
        Pose::new(rotation::exp(&Vector3::new(0.1, -0.05 * t, 0.3 * t)), position)
    };
    (0..COUNT).map(pose).collect()
}

/// What a recording measures: each pose relative to the one before.
fn measured(poses: &[Pose]) -> Vec<RelativePose> {
    let relative = |(at, pair): (usize, &[Pose])| RelativePose {
        views: [at, at + 1],
        first_from_second: pair[0].inverse().compose(&pair[1]),
        information: Matrix6::identity() * 1e4,
    };
    poses.windows(2).enumerate().map(relative).collect()
}

/// Poses that are known besides, as exactly as given (m).
fn known(poses: &[Pose], views: &[usize], sigma_m: f64) -> Vec<PosePrior> {
    let prior = |&view: &usize| PosePrior {
        view,
        pose: poses[view],
        information: Matrix6::identity() / sigma_m.powi(2),
    };
    views.iter().map(prior).collect()
}

/// The errors that a recording of which all lengths are off by a thousandth makes, by the normal equations.
fn errors_by_a_scaled_recording(poses: &[Pose], priors: &[PosePrior]) -> Vec<Vector6<f64>> {
    let (mut relative, priors) = (measured(poses), priors.to_vec());
    for relative in &mut relative {
        relative.first_from_second.translation *= 1.0 + SCALE_SIGMA;
    }
    let factors: Vec<&dyn Factor> = vec![&relative, &priors];
    let problem = Problem { cameras: &[], factors, pixels: pixel_model(1.0) };
    let bundle = Bundle { poses: poses.to_vec(), ..Bundle::default() };
    let step = problem.equations(&bundle, f64::INFINITY, 0.0).solve(0.0).unwrap().states;
    (0..COUNT).map(|view| step.fixed_rows::<6>(6 * view).into_owned()).collect()
}

/// The same as it is computed.
fn stated_errors(poses: &[Pose], priors: &[PosePrior]) -> Vec<Vector6<f64>> {
    let constraints =
        Constraints { priors: priors.to_vec(), relative_poses: measured(poses), ..Constraints::default() };
    let bundle = Bundle { poses: poses.to_vec(), ..Bundle::default() };
    let covariance = state_covariance(&[], &constraints, &bundle, 1.0).unwrap();
    let views: Vec<usize> = (0..COUNT).collect();
    let posterior = Posterior::new(&covariance, poses, &views, &[]);
    constraints.scale_errors(&covariance, &bundle, &posterior)
}

#[test]
fn a_recording_that_is_too_large_moves_the_poses_as_far_as_known_ones_let_it() {
    let poses = trajectory();
    let gauge = PosePrior { view: 0, pose: poses[0], information: gauge_information(1e-4, 1e-4, 1e-3) };
    let cases = [
        vec![gauge],
        known(&poses, &[0, 5], 0.05),
        known(&poses, &[0, 2, 4, 7], 0.002),
        known(&poses, &[3], 1.0),
    ];
    let mut largest = Vec::new();
    for priors in cases {
        let [stated, made] = [stated_errors(&poses, &priors), errors_by_a_scaled_recording(&poses, &priors)];
        let size = made.iter().map(Vector6::norm).fold(0.0, f64::max);
        for (view, (stated, made)) in stated.iter().zip(&made).enumerate() {
            assert!((stated - made).norm() < 1e-4 * size + 1e-9, "view {view}: {stated} {made}");
        }
        largest.push(size);
    }
    // Known to millimetres, they hold the scale; a single one does not.
    assert!(largest[2] < 0.2 * largest[0] && largest[0] > 0.02 && largest[3] > 0.009, "{largest:?}");
}

#[test]
fn what_is_stated_with_an_error_of_the_scale_is_a_covariance_that_is_larger_by_it() {
    let poses = trajectory();
    let priors = known(&poses, &[0, 5], 0.05);
    let errors = stated_errors(&poses, &priors);
    let constraints = Constraints { priors, relative_poses: measured(&poses), ..Constraints::default() };
    let bundle = Bundle { poses: poses.clone(), ..Bundle::default() };
    let covariance = state_covariance(&[], &constraints, &bundle, 1.0).unwrap();
    let views: Vec<usize> = (0..COUNT).collect();
    let positions: Vec<Vector3<f64>> = poses.iter().map(|pose| pose.translation).collect();
    let posterior = Posterior::new(&covariance, &poses, &views, &[]);
    let stated = |frame_and_scale: FrameAndScale| {
        let joint = joint_covariance(&posterior, (&views, COUNT), &positions, frame_and_scale, |_, _| ());
        whole(&joint)
    };
    let without = stated(FrameAndScale::AsAdjusted);
    let with = stated(FrameAndScale::WithScaleError(errors.clone()));
    let direction = DMatrix::from_fn(6 * COUNT, 1, |row, _| errors[row / 6][row % 6]);
    let expected = without + &direction * direction.transpose();
    assert!((&with - expected).amax() < 1e-12 * with.amax());
    assert!(with.cholesky().is_some());
}

fn whole(joint: &JointCovariance) -> DMatrix<f64> {
    let own: Vec<Matrix6<f64>> = joint.own.values().copied().collect();
    dense(&own, joint.cross.iter().copied())
}
