//! The joint covariance against the dense Schmidt-Kalman filter that it claims to equal, and its budget of keyframes
//! against the true covariance of its errors.
#![allow(clippy::unwrap_used)]

mod budget;
#[path = "../common/mod.rs"]
mod common;
mod equality;
mod map_versions;
mod textbook;

use estimator::covariance::JointCovariance;
use estimator::measurement::{Information, StateBlocks};
use geometry::{Pose, PoseWithCovariance};
use nalgebra::{DMatrix, DVector};

#[test]
fn a_map_that_knows_a_keyframe_exactly_is_no_fault_of_the_filter() {
    // A builder that fixes its gauge at the first keyframe gives it no covariance at all.
    let mut joint = JointCovariance::new(DMatrix::identity(21, 21) * 0.1, 6);
    let slot = joint.held.activate_or_insert(1, &PoseWithCovariance::exact(Pose::identity()), &[]);
    let mut information = Information::new(StateBlocks {
        keyframes: vec![slot],
        ..StateBlocks::of_active(std::iter::once(15..21))
    });
    let jacobian = DMatrix::from_fn(8, 12, |row, column| ((3 * row + column) as f64).sin());
    information.add(&jacobian, &DVector::from_element(8, 0.1));
    assert!(joint.information_nis(&information).is_ok(), "reported as a diverged filter");
    assert!(
        joint.information_update(&information, &mut DVector::zeros(0)).is_ok(),
        "reported as a diverged filter"
    );
}
