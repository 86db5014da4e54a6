//! The prior of one pose.

use geometry::pose::Pose;
use geometry::rotation::left_jacobian_inverse;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Matrix6, Vector6};

use crate::bundle::Bundle;
use crate::factor::Factor;
use crate::normal_equations::NormalEquations;

/// Lower bounds of the standard deviations of a prior pose (rad, m), which keep the equations well-conditioned where a map
/// is built from exact poses.
const MIN_SIGMAS: [f64; 2] = [1e-5, 1e-4];

/// A prior of a pose.
#[derive(Clone, Debug)]
pub struct PosePrior {
    /// The view.
    pub view: usize,
    /// Mean, `global_from_body`.
    pub pose: Pose,
    /// Inverse covariance of `[δθ, δp]` in G.
    pub information: Matrix6<f64>,
}

impl PosePrior {
    /// The prior that a reference pose is, with a lower bound of its covariance for exact poses.
    pub fn of_reference(view: usize, reference: &PoseWithCovariance) -> PosePrior {
        let mut floored = reference.covariance;
        for index in 0..6 {
            floored[(index, index)] += MIN_SIGMAS[index / 3].powi(2);
        }
        let information =
            floored.try_inverse().unwrap_or_else(|| Matrix6::identity() / MIN_SIGMAS[0].powi(2));
        PosePrior { view, pose: reference.pose, information }
    }
}

impl Factor for PosePrior {
    fn cost(&self, bundle: &Bundle, _scale: f64) -> f64 {
        let error = self.pose.local(&bundle.poses[self.view]);
        0.5 * error.dot(&(self.information * error))
    }

    fn add_to(&self, equations: &mut NormalEquations, bundle: &Bundle, _scale: f64) {
        let (error, jacobian) = pose_error(&self.pose, &bundle.poses[self.view]);
        equations.add_residual(bundle.layout().pose(self.view), &jacobian, &self.information, &error);
    }
}

/// The error `[δθ, δp]` of a pose relative to its mean, and its Jacobian by a further error.
pub fn pose_error(mean: &Pose, pose: &Pose) -> (Vector6<f64>, Matrix6<f64>) {
    let error = mean.local(pose);
    let mut jacobian = Matrix6::identity();
    let by_rotation = left_jacobian_inverse(&error.fixed_rows::<3>(0).into_owned());
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_rotation);
    (error, jacobian)
}

/// The information of a prior of yaw, tilt (rad) and position (m) of a pose: yaw and position are what neither images nor IMU see.
pub fn gauge_information(sigma_yaw_rad: f64, sigma_tilt_rad: f64, sigma_p_m: f64) -> Matrix6<f64> {
    let sigmas = [[sigma_tilt_rad, sigma_tilt_rad, sigma_yaw_rad], [sigma_p_m; 3]].concat();
    Matrix6::from_diagonal(&Vector6::from_iterator(sigmas.iter().map(|sigma| sigma.powi(-2))))
}
