//! The joint covariance against the dense Schmidt-Kalman filter that it must equal, and what it states after eviction and
//! invalidation against the true covariance of its errors.

mod dense_filter;
mod equality;
mod eviction;
mod invalidation;

use estimator::covariance::JointCovariance;
use estimator::measurement::{Information, StateBlocks};
use geometry::{Pose, PoseWithCovariance};
use nalgebra::{DMatrix, DVector, Matrix6xX};

#[test]
fn a_keyframe_without_uncertainty_is_accepted() {
    // Bundle adjustment with a fixed gauge states a covariance of zero for the first keyframe.
    let mut joint = JointCovariance::new(DMatrix::identity(21, 21) * 0.1, 6);
    let (keyframe, none) = (PoseWithCovariance::exact(Pose::identity()), Matrix6xX::zeros(0));
    let slot = joint.held.activate_or_insert(1, &keyframe, &none, &[]);
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
