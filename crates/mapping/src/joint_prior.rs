//! The keyframe poses of a map that is extended, with their joint covariance.

use geometry::pose::Pose;
use map::contents::MapContents;
use nalgebra::{DMatrix, DVector, Matrix6, Vector3};

use super::bundle_adjustment::pose_error;
use super::layout::{POSE, StateLayout};
use super::normal_equations::NormalEquations;

/// Lower bounds of the standard deviations (rad, m), so that exact keyframes have a covariance that can be inverted.
const MIN_SIGMAS: [f64; 2] = [1e-6, 1e-5];

/// A joint Gaussian prior of the poses of consecutive views.
#[derive(Clone, Debug)]
pub(super) struct JointPrior {
    /// The first of the views.
    first: usize,
    /// Means, `global_from_camera`.
    poses: Vec<Pose>,
    /// Inverse covariance of all errors `[δθ, δp]` in G.
    information: DMatrix<f64>,
}

impl JointPrior {
    /// The keyframes of a map, in its order, as the views from `first` on; `None` where their joint covariance is none.
    pub(super) fn of_map(contents: &MapContents, first: usize) -> Option<JointPrior> {
        let keyframes = &contents.keyframes;
        let mut covariance = DMatrix::zeros(POSE * keyframes.len(), POSE * keyframes.len());
        for (at, keyframe) in keyframes.iter().enumerate() {
            let mut own = keyframe.global_from_keyframe.covariance;
            for index in 0..POSE {
                own[(index, index)] += MIN_SIGMAS[index / 3].powi(2);
            }
            covariance.fixed_view_mut::<POSE, POSE>(POSE * at, POSE * at).copy_from(&own);
        }
        let index_of = |id: u64| keyframes.binary_search_by_key(&id, |keyframe| keyframe.id).ok();
        let mut add = |a: usize, b: usize, block: &Matrix6<f64>| {
            let mut upper = covariance.fixed_view_mut::<POSE, POSE>(POSE * a, POSE * b);
            upper += block;
            let mut lower = covariance.fixed_view_mut::<POSE, POSE>(POSE * b, POSE * a);
            lower += block.transpose();
        };
        for cross in &contents.cross_covariances {
            add(index_of(cross.a)?, index_of(cross.b)?, &cross.block);
        }
        for (at, one) in contents.common_errors.iter().enumerate() {
            for other in &contents.common_errors[..at] {
                add(index_of(one.keyframe)?, index_of(other.keyframe)?, &one.covariance_with(other));
            }
        }
        let poses = keyframes.iter().map(|keyframe| keyframe.global_from_keyframe.pose).collect();
        Some(JointPrior { first, poses, information: covariance.cholesky()?.inverse() })
    }

    /// The same without what it says of yaw and position of the whole: of the keyframes relative to each other.
    pub(super) fn relative(mut self) -> Option<JointPrior> {
        let mut modes = DMatrix::zeros(POSE * self.poses.len(), 4);
        for (at, pose) in self.poses.iter().enumerate() {
            modes[(POSE * at + 2, 0)] = 1.0;
            let by_yaw = Vector3::z().cross(&pose.translation);
            modes.fixed_view_mut::<3, 1>(POSE * at + 3, 0).copy_from(&by_yaw);
            modes.fixed_view_mut::<3, 3>(POSE * at + 3, 1).fill_with_identity();
        }
        let weighted = &self.information * &modes;
        let of_modes = modes.tr_mul(&weighted).cholesky()?;
        self.information -= &weighted * of_modes.solve(&weighted.transpose());
        Some(self)
    }

    /// Half the squared error, in standard deviations.
    pub(super) fn cost(&self, poses: &[Pose]) -> f64 {
        let errors = self.poses.iter().zip(&poses[self.first..]).flat_map(|(mean, pose)| {
            let error = mean.local(pose);
            (0..POSE).map(move |index| error[index])
        });
        let error = DVector::from_iterator(POSE * self.poses.len(), errors);
        0.5 * error.dot(&(&self.information * &error))
    }

    /// Adds the linearized error; its Jacobian is block-diagonal.
    pub(super) fn add_to(&self, equations: &mut NormalEquations, layout: StateLayout, poses: &[Pose]) {
        let size = POSE * self.poses.len();
        let mut error = DVector::zeros(size);
        let mut indices = Vec::with_capacity(size);
        let mut jacobians = Vec::with_capacity(self.poses.len());
        for (at, mean) in self.poses.iter().enumerate() {
            let (of_pose, jacobian) = pose_error(mean, &poses[self.first + at]);
            error.fixed_rows_mut::<POSE>(POSE * at).copy_from(&of_pose);
            indices.extend(layout.pose(self.first + at));
            jacobians.push(jacobian);
        }
        let weighted = &self.information * error;
        let mut gradient = DVector::zeros(size);
        let mut information = self.information.clone();
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
