//! Relative poses of two views, as place recognition finds them.

use geometry::pose::Pose;
use geometry::rotation::{left_jacobian_inverse, right_jacobian_inverse, skew};
use nalgebra::{DMatrix, DVector, Matrix6, SMatrix, Vector6};

use super::layout::{POSE, StateLayout};
use super::normal_equations::NormalEquations;

/// A measured relative pose.
#[derive(Clone, Debug)]
pub(super) struct RelativePose {
    /// The two views.
    pub(super) views: [usize; 2],
    /// The camera of the second view in that of the first.
    pub(super) first_from_second: Pose,
    /// Inverse covariance of the error `[δθ, δp]`, in the camera frame of the first view.
    pub(super) information: Matrix6<f64>,
}

impl RelativePose {
    /// Estimated minus measured pose of the second view, `[δθ, δp]` in G.
    fn residual(&self, poses: &[Pose]) -> Vector6<f64> {
        poses[self.views[0]].compose(&self.first_from_second).local(&poses[self.views[1]])
    }

    /// The information in G.
    fn information_in_global(&self, poses: &[Pose]) -> Matrix6<f64> {
        let rotation = poses[self.views[0]].rotation.to_rotation_matrix().into_inner();
        let mut both = Matrix6::zeros();
        both.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        both.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        both * self.information * both.transpose()
    }

    /// Squared length of the residual, in standard deviations.
    pub(super) fn distance(&self, poses: &[Pose]) -> f64 {
        let residual = self.residual(poses);
        residual.dot(&(self.information_in_global(poses) * residual))
    }

    /// The Jacobian of the residual by the errors of the first and the second view.
    fn jacobian(&self, poses: &[Pose], residual: &Vector6<f64>) -> SMatrix<f64, POSE, 12> {
        let rotation_error = residual.fixed_rows::<3>(0).into_owned();
        let lever = poses[self.views[0]].rotation * self.first_from_second.translation;
        let mut jacobian = SMatrix::<f64, POSE, 12>::zeros();
        let mut put = |row: usize, column: usize, block: nalgebra::Matrix3<f64>| {
            jacobian.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        };
        put(0, 0, -right_jacobian_inverse(&rotation_error));
        put(3, 0, skew(&lever));
        put(3, 3, -nalgebra::Matrix3::identity());
        put(0, 6, left_jacobian_inverse(&rotation_error));
        put(3, 9, nalgebra::Matrix3::identity());
        jacobian
    }

    /// Squared length of the residual where the poses themselves are uncertain.
    ///
    /// # Arguments
    /// * `covariance`: of the errors of both poses (12x12).
    ///
    /// # Returns
    /// `None` where the covariance is singular.
    pub(super) fn distance_with(&self, poses: &[Pose], covariance: &SMatrix<f64, 12, 12>) -> Option<f64> {
        let residual = self.residual(poses);
        let jacobian = self.jacobian(poses, &residual);
        let measured = self.information_in_global(poses).try_inverse()?;
        let total = jacobian * covariance * jacobian.transpose() + measured;
        Some(residual.dot(&total.cholesky()?.solve(&residual)))
    }

    /// Adds the linearized residual.
    pub(super) fn add_to(&self, equations: &mut NormalEquations, layout: StateLayout, poses: &[Pose]) {
        let residual = self.residual(poses);
        let information = self.information_in_global(poses);
        let jacobian = self.jacobian(poses, &residual);
        equations.add_residual(
            layout.pose(self.views[0]).chain(layout.pose(self.views[1])).collect(),
            &DMatrix::from_column_slice(POSE, 12, jacobian.as_slice()),
            &DMatrix::from_column_slice(POSE, POSE, information.as_slice()),
            &DVector::from_column_slice(residual.as_slice()),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::rotation::exp;
    use nalgebra::Vector3;

    #[test]
    fn the_jacobian_is_the_numeric_derivative() {
        let pose =
            |x: f64| Pose::new(exp(&Vector3::new(0.3 * x, -0.5, 0.2 + x)), Vector3::new(x, 2.0 * x, -1.0));
        let poses = [pose(0.4), pose(1.1)];
        let measured = RelativePose {
            views: [0, 1],
            first_from_second: pose(0.4).inverse().compose(&pose(1.3)),
            information: Matrix6::identity(),
        };
        let stated = measured.jacobian(&poses, &measured.residual(&poses));
        for column in 0..12 {
            let moved = |step: f64| {
                let mut poses = poses;
                let mut error = Vector6::zeros();
                error[column % 6] = step;
                poses[column / 6] = poses[column / 6].retract(&error);
                measured.residual(&poses)
            };
            let numeric = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            assert!((numeric - stated.column(column)).amax() < 1e-8, "column {column}");
        }
    }
}
