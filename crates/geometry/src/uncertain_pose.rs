//! Poses with the covariance of their `[dtheta, dp]` error in the parent frame, and first-order propagation:
//!
//! ```text
//! a * b:      dtheta = dtheta_a + R_a dtheta_b,   dp = dp_a - [R_a p_b]x dtheta_a + R_a dp_b
//! a^-1:       dtheta = -R^T dtheta,               dp = -R^T [p]x dtheta - R^T dp
//! ```

use crate::covariance_check::check_covariance;
use crate::pose::Pose;
use crate::rotation::skew;
use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};

/// A pose whose error `[dtheta, dp]` (radians, metres; parent frame) is zero-mean with `covariance`.
///
/// # Example
/// ```
/// use geometry::{Pose, PoseWithCovariance};
/// use nalgebra::Matrix6;
///
/// let global_from_keyframe = PoseWithCovariance::new(Pose::identity(), Matrix6::identity() * 1e-4);
/// let keyframe_from_camera = PoseWithCovariance::exact(Pose::identity());
/// let global_from_camera = global_from_keyframe.compose(&keyframe_from_camera);
/// assert_eq!(global_from_camera.covariance, global_from_keyframe.covariance);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovariance {
    /// The estimate, `parent_from_child`.
    pub pose: Pose,
    /// Covariance of `[dtheta, dp]` in the parent frame (rad^2, rad m, m^2).
    pub covariance: Matrix6<f64>,
}

impl PoseWithCovariance {
    /// A pose from the estimate and the covariance of its error.
    pub fn new(pose: Pose, covariance: Matrix6<f64>) -> Self {
        Self { pose, covariance }
    }

    /// A pose that is known exactly.
    pub fn exact(pose: Pose) -> Self {
        Self { pose, covariance: Matrix6::zeros() }
    }

    /// `child_from_parent`, with its error in the child frame.
    pub fn inverse(&self) -> Self {
        let jacobian = inverse_jacobian(&self.pose);
        Self {
            pose: self.pose.inverse(),
            covariance: symmetric(&(jacobian * self.covariance * jacobian.transpose())),
        }
    }

    /// `a_from_c` of `a_from_b` (self) and `b_from_c`, whose errors are independent.
    pub fn compose(&self, other: &Self) -> Self {
        self.compose_correlated(other, &Matrix6::zeros())
    }

    /// [`PoseWithCovariance::compose`] of two poses with the cross-covariance `E[error_self error_other^T]`.
    pub fn compose_correlated(&self, other: &Self, cross_covariance: &Matrix6<f64>) -> Self {
        let (by_a, by_b) = compose_jacobians(&self.pose, &other.pose);
        let cross = by_a * cross_covariance * by_b.transpose();
        let covariance = by_a * self.covariance * by_a.transpose()
            + by_b * other.covariance * by_b.transpose()
            + cross
            + cross.transpose();
        Self { pose: self.pose * other.pose, covariance: symmetric(&covariance) }
    }

    /// Transforms to another parent frame, known exactly: `new_from_child = new_from_parent * self`.
    pub fn change_of_parent(&self, new_from_parent: &Pose) -> Self {
        let (_, by_self) = compose_jacobians(new_from_parent, &self.pose);
        let covariance = symmetric(&(by_self * self.covariance * by_self.transpose()));
        Self { pose: new_from_parent * self.pose, covariance }
    }

    /// The pose of another frame rigidly attached to the child, known exactly: `parent_from_other = self * child_from_other`.
    pub fn change_of_child(&self, child_from_other: &Pose) -> Self {
        let (by_self, _) = compose_jacobians(&self.pose, child_from_other);
        let covariance = symmetric(&(by_self * self.covariance * by_self.transpose()));
        Self { pose: self.pose * child_from_other, covariance }
    }

    /// Normalized estimation error squared against the truth: `e^T P^-1 e`, chi-square with 6 degrees of freedom for a
    /// consistent estimate. `None` if the covariance is not positive definite.
    pub fn nees(&self, truth: &Pose) -> Option<f64> {
        let error: Vector6<f64> = self.pose.local(truth);
        let information_times_error = self.covariance.cholesky()?.solve(&error);
        Some(error.dot(&information_times_error))
    }

    /// Standard deviation of the rotation per axis (rad): the root mean square over the three axes.
    ///
    /// ```
    /// use geometry::uncertain_pose::isotropic_covariance;
    /// use geometry::{Pose, PoseWithCovariance};
    ///
    /// let pose = PoseWithCovariance::new(Pose::identity(), isotropic_covariance(0.01, 0.1));
    /// assert!((pose.sigma_theta_rad() - 0.01).abs() < 1e-12 && (pose.sigma_p_m() - 0.1).abs() < 1e-12);
    /// ```
    pub fn sigma_theta_rad(&self) -> f64 {
        self.sigma_per_axis(0)
    }

    /// Standard deviation of the position per axis (m): the root mean square over the three axes.
    pub fn sigma_p_m(&self) -> f64 {
        self.sigma_per_axis(3)
    }

    fn sigma_per_axis(&self, first: usize) -> f64 {
        (self.covariance.diagonal().fixed_rows::<3>(first).sum() / 3.0).max(0.0).sqrt()
    }

    /// Whether the pose is finite with a quaternion of unit length, and the covariance passes [`check_covariance`]. For
    /// decoded data.
    pub fn is_plausible(&self) -> bool {
        self.pose.check_unit() && check_covariance(&self.covariance).is_ok()
    }
}

/// The covariance of `[dtheta, dp]` with the same standard deviation on the three axes of each: `sigma_theta_rad` (rad)
/// and `sigma_p_m` (m).
///
/// ```
/// use geometry::uncertain_pose::isotropic_covariance;
///
/// let covariance = isotropic_covariance(0.01, 0.1);
/// assert_eq!((covariance[(0, 0)], covariance[(5, 5)], covariance[(0, 5)]), (0.01 * 0.01, 0.1 * 0.1, 0.0));
/// ```
pub fn isotropic_covariance(sigma_theta_rad: f64, sigma_p_m: f64) -> Matrix6<f64> {
    let [theta, p] = [sigma_theta_rad * sigma_theta_rad, sigma_p_m * sigma_p_m];
    Matrix6::from_diagonal(&Vector6::new(theta, theta, theta, p, p, p))
}

/// Jacobians of `a * b` with respect to the `[dtheta, dp]` errors of a and of b.
///
/// ```text
/// d(ab)/da = |  I           0 |    d(ab)/db = | R_a  0   |
///            | -[R_a p_b]x  I |               | 0    R_a |
/// ```
pub fn compose_jacobians(a: &Pose, b: &Pose) -> (Matrix6<f64>, Matrix6<f64>) {
    let mut by_a = Matrix6::identity();
    by_a.fixed_view_mut::<3, 3>(3, 0).copy_from(&-skew(&(a.rotation * b.translation)));
    let rotation = a.rotation.to_rotation_matrix().into_inner();
    let mut by_b = Matrix6::zeros();
    by_b.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    by_b.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    (by_a, by_b)
}

/// Jacobian of `pose.inverse()` with respect to the `[dtheta, dp]` error of `pose`.
///
/// ```text
/// | -R^T        0    |
/// | -R^T [p]x  -R^T  |
/// ```
pub fn inverse_jacobian(pose: &Pose) -> Matrix6<f64> {
    let minus_transposed = -pose.rotation.to_rotation_matrix().into_inner().transpose();
    let mut jacobian = Matrix6::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&minus_transposed);
    jacobian.fixed_view_mut::<3, 3>(3, 0).copy_from(&(minus_transposed * skew(&pose.translation)));
    jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&minus_transposed);
    jacobian
}

/// Removes rounding errors from a matrix that is symmetric by construction.
pub(crate) fn symmetric(matrix: &Matrix6<f64>) -> Matrix6<f64> {
    (matrix + matrix.transpose()) * 0.5
}
