//! Relative poses of two views, as place recognition finds them.

use geometry::pose::Pose;
use geometry::rotation::{left_jacobian_inverse, skew};
use nalgebra::{Matrix3, Matrix6, SMatrix, Vector6};

use crate::bundle::Bundle;
use crate::factor::Factor;
use crate::layout::POSE;
use crate::normal_equations::NormalEquations;

/// A measured relative pose.
#[derive(Clone, Debug)]
pub struct RelativePose {
    /// The two views.
    pub views: [usize; 2],
    /// The camera of the second view in that of the first.
    pub first_from_second: Pose,
    /// Inverse covariance of the error `[δθ, δp]`, in the camera frame of the first view.
    pub information: Matrix6<f64>,
}

impl RelativePose {
    /// Estimated minus measured pose of the second view, `[δθ, δp]` in the camera frame of the first view.
    fn residual(&self, poses: &[Pose]) -> Vector6<f64> {
        self.first_from_second.local(&self.estimated(poses))
    }

    fn estimated(&self, poses: &[Pose]) -> Pose {
        poses[self.views[0]].inverse().compose(&poses[self.views[1]])
    }

    /// Squared length of the residual, in standard deviations.
    pub fn distance(&self, poses: &[Pose]) -> f64 {
        let residual = self.residual(poses);
        residual.dot(&(self.information * residual))
    }

    /// The Jacobian of the residual by the errors of the first and the second view, in G.
    fn jacobian(&self, poses: &[Pose], residual: &Vector6<f64>) -> SMatrix<f64, POSE, 12> {
        let first = &poses[self.views[0]];
        let to_first = first.rotation.inverse().to_rotation_matrix().into_inner();
        let rotation = left_jacobian_inverse(&residual.fixed_rows::<3>(0).into_owned()) * to_first;
        let baseline = poses[self.views[1]].translation - first.translation;
        let mut jacobian = SMatrix::<f64, POSE, 12>::zeros();
        let mut put = |row: usize, column: usize, block: Matrix3<f64>| {
            jacobian.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        };
        put(0, 0, -rotation);
        put(0, 6, rotation);
        put(3, 0, to_first * skew(&baseline));
        put(3, 3, -to_first);
        put(3, 9, to_first);
        jacobian
    }

    /// Squared length of the residual where the poses themselves are uncertain.
    ///
    /// # Arguments
    /// * `covariance`: of the errors of both poses (12x12).
    ///
    /// # Returns
    /// `None` where the covariance is singular.
    pub fn distance_with(&self, poses: &[Pose], covariance: &SMatrix<f64, 12, 12>) -> Option<f64> {
        let residual = self.residual(poses);
        let jacobian = self.jacobian(poses, &residual);
        let measured = self.information.try_inverse()?;
        let total = jacobian * covariance * jacobian.transpose() + measured;
        Some(residual.dot(&total.cholesky()?.solve(&residual)))
    }
}

impl Factor for RelativePose {
    fn cost(&self, bundle: &Bundle, _scale: f64) -> f64 {
        0.5 * self.distance(&bundle.poses)
    }

    fn add_to(&self, equations: &mut NormalEquations, bundle: &Bundle, _scale: f64) {
        let [first, second] = self.views.map(|view| bundle.layout().pose(view));
        let residual = self.residual(&bundle.poses);
        let jacobian = self.jacobian(&bundle.poses, &residual);
        equations.add_residual(first.chain(second), &jacobian, &self.information, &residual);
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
