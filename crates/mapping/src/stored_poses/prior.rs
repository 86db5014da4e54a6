//! The joint prior that the keyframe poses of a stored map are.

use std::sync::Arc;

use geometry::pose::Pose;
use nalgebra::{DMatrix, DVector};

use crate::layout::{POSE, StateLayout};
use crate::normal_equations::NormalEquations;
use crate::pose_prior::pose_error;

/// A joint Gaussian prior of the poses of some views.
#[derive(Clone, Debug)]
pub(crate) struct JointPrior {
    /// The views.
    views: Vec<usize>,
    /// Means, `global_from_camera`.
    means: Vec<Pose>,
    /// Inverse covariance of all errors `[δθ, δp]` in G.
    information: Arc<DMatrix<f64>>,
}

impl JointPrior {
    /// # Arguments
    /// * `information`: 6 rows and columns a view.
    pub(super) fn new(views: Vec<usize>, means: Vec<Pose>, information: Arc<DMatrix<f64>>) -> JointPrior {
        JointPrior { views, means, information }
    }

    /// Half the squared error, in standard deviations.
    pub(crate) fn cost(&self, poses: &[Pose]) -> f64 {
        let error = errors(&self.means, self.views.iter().map(|&view| &poses[view]));
        0.5 * error.dot(&(&*self.information * &error))
    }

    /// Adds the linearized error; its Jacobian is block-diagonal.
    pub(crate) fn add_to(&self, equations: &mut NormalEquations, layout: StateLayout, poses: &[Pose]) {
        let size = POSE * self.means.len();
        let mut error = DVector::zeros(size);
        let mut indices = Vec::with_capacity(size);
        let mut jacobians = Vec::with_capacity(self.means.len());
        for (at, (mean, &view)) in self.means.iter().zip(&self.views).enumerate() {
            let (of_pose, jacobian) = pose_error(mean, &poses[view]);
            error.fixed_rows_mut::<POSE>(POSE * at).copy_from(&of_pose);
            indices.extend(layout.pose(view));
            jacobians.push(jacobian);
        }
        let weighted = &*self.information * error;
        let mut gradient = DVector::zeros(size);
        let mut information = DMatrix::clone(&self.information);
        for (row, by_row) in jacobians.iter().enumerate() {
            let of_row = -by_row.transpose() * weighted.fixed_rows::<POSE>(POSE * row);
            gradient.fixed_rows_mut::<POSE>(POSE * row).copy_from(&of_row);
            for (column, by_column) in jacobians.iter().enumerate() {
                let mut block = information.fixed_view_mut::<POSE, POSE>(POSE * row, POSE * column);
                let product = by_row.transpose() * &block * by_column;
                block.copy_from(&product);
            }
        }
        equations.add_information(indices, information, &gradient);
    }
}

/// The errors `[δθ, δp]` of poses relative to their means.
pub(super) fn errors<'a>(means: &[Pose], poses: impl Iterator<Item = &'a Pose>) -> DVector<f64> {
    let mut errors = DVector::zeros(POSE * means.len());
    for (at, (mean, pose)) in means.iter().zip(poses).enumerate() {
        errors.fixed_rows_mut::<POSE>(POSE * at).copy_from(&mean.local(pose));
    }
    errors
}
