//! Renewal of first estimates: a new point of linearization that invents no information.
//!
//! Jacobians at the first estimates see nothing along the gauge of L: a turn about gravity, and a translation. At the first
//! estimate `p` of a position or velocity, a turn by `a` shows as the error `a x p`, so that another first estimate has another
//! gauge, and information that was gathered at the old one is information about the new one: a yaw that nothing measured would
//! be known. With a first estimate that moves from `p` to `p + d`, the error moves, too:
//! ```text
//! e_p ← e_p + e_R x d
//! ```
//! with the rotation error `e_R` of the same block. It carries the old gauge to the new one, and is to first order the
//! statement of the invariant Kalman filter (Barrau and Bonnabel 2017): `e_p - e_R x p` keeps its distribution while the point
//! of linearization moves.
//!
//! SLAM features move with the rotation of the newest pose, the next one that sees them. If they stayed where they were first
//! estimated, poses and features would be linearized at trajectories of two scales, between which the scale of one camera that
//! drives ahead seems to be measured: position NEES of 3.9 with exact tracks, 0.8 where all of them are renewed.

use crate::covariance::JointCovariance;
use crate::linear_algebra::dependence::Dependence;
use crate::propagation::{MotionEstimate, VELOCITY};
use crate::state::{ActiveState, Block};
use geometry::rotation;
use nalgebra::Vector3;
use smallvec::SmallVec;

/// Takes the newest estimates of motion, clones and SLAM features for first ones: before each time update, so that within an image all updates
/// share one gauge.
pub fn renew(state: &mut ActiveState, covariance: &mut JointCovariance) {
    let newest = MotionEstimate::of(&state.imu);
    let moved = newest.position - state.first_motion.position;
    let gained = newest.velocity - state.first_motion.velocity;
    let mut transports = SmallVec::<[_; 96]>::new();
    transports.extend([transport(0, 3, &moved), transport(0, VELOCITY, &gained)]);
    state.first_motion = newest;

    for index in 0..state.slam_features.len() {
        let Some(block) = state.range(Block::SlamFeature(index)) else { continue };
        let feature = &mut state.slam_features[index];
        transports.push(transport(0, block.start, &(feature.position - feature.first_estimate)));
        feature.first_estimate = feature.position;
    }
    for index in 0..state.clones.len() {
        let Some(block) = state.range(Block::Clone(index)) else { continue };
        let clone = &mut state.clones[index];
        let moved = clone.local_from_imu.translation - clone.first_estimate.translation;
        transports.push(transport(block.start, block.start + 3, &moved));
        clone.first_estimate = clone.local_from_imu;
    }
    covariance.add_dependences(&transports);
}

/// Takes the first estimates of another point of linearization, to which [`renew`] has carried the covariance.
pub fn adopt(state: &mut ActiveState, other: &ActiveState) {
    state.first_motion = other.first_motion;
    for (own, other) in state.slam_features.iter_mut().zip(&other.slam_features) {
        own.first_estimate = other.first_estimate;
    }
    for (own, other) in state.clones.iter_mut().zip(&other.clones) {
        own.first_estimate = other.first_estimate;
    }
}

/// `e_p ← e_p + e_R x moved` for the errors that begin at `rotation` and `position`.
fn transport(rotation: usize, position: usize, moved: &Vector3<f64>) -> Dependence<3, 3> {
    Dependence { begin: position, of: rotation, jacobian: -rotation::skew(moved) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::{FEATURE_DIM, POSE_DIM, SlamFeature};
    use crate::test_scene::scene;
    use nalgebra::DMatrix;

    /// Errors that a turn about each axis, and a translation, of L would be at the first estimates.
    fn gauge(state: &ActiveState) -> DMatrix<f64> {
        let mut gauge = DMatrix::zeros(state.dim(), 6);
        let identity = nalgebra::Matrix3::identity();
        let mut position = |begin: usize, first: &Vector3<f64>| {
            gauge.fixed_view_mut::<3, 3>(begin, 0).copy_from(&-rotation::skew(first));
            gauge.fixed_view_mut::<3, 3>(begin, 3).copy_from(&identity);
        };
        position(3, &state.first_motion.position);
        for (index, feature) in state.slam_features.iter().enumerate() {
            position(state.range(Block::SlamFeature(index)).unwrap().start, &feature.first_estimate);
        }
        for (index, clone) in state.clones.iter().enumerate() {
            position(state.range(Block::Clone(index)).unwrap().start + 3, &clone.first_estimate.translation);
        }
        gauge.fixed_view_mut::<3, 3>(0, 0).copy_from(&identity);
        gauge.fixed_view_mut::<3, 3>(VELOCITY, 0).copy_from(&-rotation::skew(&state.first_motion.velocity));
        for index in 0..state.clones.len() {
            let begin = state.range(Block::Clone(index)).unwrap().start;
            gauge.fixed_view_mut::<3, 3>(begin, 0).copy_from(&identity);
        }
        gauge
    }

    /// A state whose first estimates are off, and a covariance with correlations everywhere.
    fn state_and_covariance() -> (ActiveState, JointCovariance) {
        let scene = scene(false);
        let mut state = scene.state;
        state.first_motion.position += Vector3::new(0.3, -0.1, 0.05);
        state.first_motion.velocity += Vector3::new(-0.2, 0.4, 0.1);
        let first_estimate = scene.landmark + Vector3::new(0.2, 0.1, -0.7);
        let position = scene.landmark;
        let last_seen = state.clones[0].id;
        state.slam_features.push(SlamFeature {
            feature_id: 3,
            position,
            first_estimate,
            gated_in_a_row: 0,
            camera: 0,
            last_seen,
        });
        let dim = state.dim();
        assert_eq!(dim, 15 + FEATURE_DIM + 8 * POSE_DIM);
        let root = DMatrix::from_fn(dim, dim, |row, column| {
            let own = if row == column { 1.0 } else { 0.0 };
            own + 0.4 * ((7 * row + 3 * column) as f64).sin()
        });
        (state, JointCovariance::new(&root * root.transpose() * 1e-2, 4))
    }

    #[test]
    fn a_renewal_neither_adds_nor_removes_information_about_the_gauge() {
        let (mut state, mut covariance) = state_and_covariance();
        let information = |state: &ActiveState, covariance: &JointCovariance| {
            let gauge = gauge(state);
            let inverse = covariance.active().view().into_owned().try_inverse().unwrap();
            gauge.transpose() * inverse * gauge
        };
        let before = information(&state, &covariance);
        renew(&mut state, &mut covariance);
        let after = information(&state, &covariance);
        assert!((&after - &before).amax() < 1e-7 * before.amax(), "{before}{after}");
        // And it did something: these are the newest estimates now.
        assert_eq!(state.first_motion.position, state.imu.local_from_imu.translation);
        assert!(state.clones.iter().all(|clone| clone.first_estimate == clone.local_from_imu));
        assert!(state.slam_features.iter().all(|feature| feature.first_estimate == feature.position));
    }
}
