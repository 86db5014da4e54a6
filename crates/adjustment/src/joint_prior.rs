//! The joint prior that the keyframe poses of a stored map are.

use std::sync::Arc;

use geometry::pose::Pose;
use nalgebra::{DMatrix, DVector, Matrix6};

use crate::bundle::Bundle;
use crate::factor::Factor;
use crate::layout::POSE;
use crate::normal_equations::NormalEquations;
use crate::pose_prior::pose_error;

/// A joint Gaussian prior of the poses of some views.
#[derive(Clone, Debug)]
pub struct JointPrior {
    /// The views.
    views: Vec<usize>,
    /// Means, `global_from_body`.
    means: Vec<Pose>,
    /// Inverse covariance of all errors `[δθ, δp]` in G.
    information: Arc<DMatrix<f64>>,
}

impl JointPrior {
    /// # Arguments
    /// * `information`: 6 rows and columns a view.
    pub fn new(views: Vec<usize>, means: Vec<Pose>, information: Arc<DMatrix<f64>>) -> JointPrior {
        JointPrior { views, means, information }
    }
}

impl Factor for JointPrior {
    fn cost(&self, bundle: &Bundle, _scale: f64) -> f64 {
        let error = pose_errors(&self.means, self.views.iter().map(|&view| &bundle.poses[view]));
        0.5 * error.dot(&(&*self.information * &error))
    }

    /// Its Jacobian is block-diagonal.
    fn add_to(&self, equations: &mut NormalEquations, bundle: &Bundle, _scale: f64) {
        let layout = bundle.layout();
        let poses = self.views.iter().map(|&view| &bundle.poses[view]);
        let weighted = &*self.information * pose_errors(&self.means, poses.clone());
        let jacobians: Vec<Matrix6<f64>> =
            self.means.iter().zip(poses).map(|(mean, pose)| pose_error(mean, pose).1).collect();
        let mut gradient = DVector::zeros(weighted.len());
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
        let indices = self.views.iter().flat_map(|&view| layout.pose(view));
        equations.add_information(indices, &information, gradient.as_slice());
    }
}

/// The errors `[δθ, δp]` of poses relative to their means.
pub fn pose_errors<'a>(means: &[Pose], poses: impl Iterator<Item = &'a Pose>) -> DVector<f64> {
    let mut errors = DVector::zeros(POSE * means.len());
    for (at, (mean, pose)) in means.iter().zip(poses).enumerate() {
        errors.fixed_rows_mut::<POSE>(POSE * at).copy_from(&mean.local(pose));
    }
    errors
}
