//! Absolute trajectory error (ATE): the difference between each estimated pose and the true one.

use super::{Pair, Statistics};
use crate::trajectory::StampedPose;
use geometry::pose::Pose;
use serde::Serialize;

/// Errors of poses or motions, in rotation and translation.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PoseErrors {
    /// Angle between estimated and true rotation, degrees.
    pub degrees: Vec<f64>,
    /// Distance between estimated and true position, metres.
    pub metres: Vec<f64>,
}

impl PoseErrors {
    /// Adds the difference of two poses (or motions).
    pub fn push(&mut self, truth: &Pose, estimate: &Pose) {
        self.degrees.push(truth.rotation.angle_to(&estimate.rotation).to_degrees());
        self.metres.push((truth.translation - estimate.translation).norm());
    }

    /// Statistics of the rotation, degrees; `None` without any.
    pub fn rotation(&self) -> Option<Statistics> {
        Statistics::of(&self.degrees)
    }

    /// Statistics of the translation, metres; `None` without any.
    pub fn translation(&self) -> Option<Statistics> {
        Statistics::of(&self.metres)
    }
}

/// The error of each pair after alignment, see the [example of the crate](crate).
///
/// # Arguments
/// * `pairs`: indices into `reference` and `estimate`, from [`associate`](crate::associate).
/// * `reference_from_estimate`: the alignment, from [`align`](crate::align).
///
/// # Panics
/// Where an index of a pair is out of range.
pub fn absolute_errors(
    reference: &[StampedPose],
    estimate: &[StampedPose],
    pairs: &[Pair],
    reference_from_estimate: &Pose,
) -> PoseErrors {
    let mut errors = PoseErrors::default();
    for pair in pairs {
        let moved = reference_from_estimate.compose(&estimate[pair.estimate].pose);
        errors.push(&reference[pair.reference].pose, &moved);
    }
    errors
}
