//! The prior of one pose.

use geometry::pose::Pose;
use geometry::rotation::left_jacobian_inverse;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{DMatrix, DVector, Matrix6, Vector6};

use super::layout::{POSE, StateLayout};
use super::normal_equations::NormalEquations;

/// Lower bounds of the standard deviations of a prior pose (rad, m), which keep the equations well-conditioned where a map
/// is built from exact poses.
const MIN_SIGMAS: [f64; 2] = [1e-5, 1e-4];

/// A prior of a pose.
#[derive(Clone, Debug)]
pub(super) struct PosePrior {
    /// The view.
    pub(super) view: usize,
    /// Mean, `global_from_camera`.
    pub(super) pose: Pose,
    /// Inverse covariance of `[δθ, δp]` in G.
    pub(super) information: Matrix6<f64>,
}

impl PosePrior {
    /// The prior that a reference pose is, with a lower bound of its covariance for exact poses.
    pub(super) fn of_reference(view: usize, reference: &PoseWithCovariance) -> PosePrior {
        let mut floored = reference.covariance;
        for index in 0..6 {
            floored[(index, index)] += MIN_SIGMAS[index / 3].powi(2);
        }
        let information =
            floored.try_inverse().unwrap_or_else(|| Matrix6::identity() / MIN_SIGMAS[0].powi(2));
        PosePrior { view, pose: reference.pose, information }
    }

    /// Half the squared error, in standard deviations.
    pub(super) fn cost(&self, poses: &[Pose]) -> f64 {
        let error = self.pose.local(&poses[self.view]);
        0.5 * error.dot(&(self.information * error))
    }

    /// Adds the linearized error.
    pub(super) fn add_to(&self, equations: &mut NormalEquations, layout: StateLayout, poses: &[Pose]) {
        let (error, jacobian) = pose_error(&self.pose, &poses[self.view]);
        equations.add_residual(
            layout.pose(self.view).collect(),
            &DMatrix::from_column_slice(POSE, POSE, jacobian.as_slice()),
            &DMatrix::from_column_slice(POSE, POSE, self.information.as_slice()),
            &DVector::from_column_slice(error.as_slice()),
        );
    }
}

/// The error `[δθ, δp]` of a pose relative to its mean, and its Jacobian by a further error.
pub(super) fn pose_error(mean: &Pose, pose: &Pose) -> (Vector6<f64>, Matrix6<f64>) {
    let error = mean.local(pose);
    let mut jacobian = Matrix6::identity();
    let by_rotation = left_jacobian_inverse(&error.fixed_rows::<3>(0).into_owned());
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_rotation);
    (error, jacobian)
}
