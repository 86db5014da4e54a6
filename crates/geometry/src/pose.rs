//! Rigid poses with the error convention of the whole project.

use crate::rotation::{self, Rotation, skew};
use nalgebra::{Matrix3, Matrix3x6, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use std::ops::Mul;

/// Maximum deviation of the norm of a decoded quaternion from one.
const UNIT_NORM_TOLERANCE: f64 = 1e-6;

/// A rigid transformation, named by what it maps: `global_from_camera * point_in_camera` is in the global frame.
///
/// ```text
/// p_parent = rotation * p_child + translation
/// ```
///
/// # Coordinate systems
/// `parent_from_child` maps the child's coordinates (metres) to the parent's. The error of a pose is six numbers
/// `[dtheta, dp]` in the **parent** frame: `R = Exp(dtheta) R^` (radians) and `p = p^ + dp` (metres).
///
/// # Example
/// ```
/// use geometry::{Pose, rotation};
/// use nalgebra::Vector3;
///
/// let world_from_robot = Pose::new(rotation::exp(&Vector3::new(0.0, 0.0, 1.0)), Vector3::new(4.0, 2.0, 0.0));
/// let robot_from_camera = Pose::new(rotation::exp(&Vector3::new(0.3, 0.0, 0.0)), Vector3::new(0.0, 0.0, 1.5));
/// let world_from_camera = world_from_robot * robot_from_camera;
/// let point_in_camera = Vector3::new(0.0, 0.0, 5.0);
/// let point_in_world = world_from_camera.transform(&point_in_camera);
/// assert!((world_from_camera.inverse_transform(&point_in_world) - point_in_camera).norm() < 1e-12);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Rotation of the child's axes into the parent frame.
    pub rotation: Rotation,
    /// Origin of the child in the parent frame, metres.
    pub translation: Vector3<f64>,
}

impl Default for Pose {
    fn default() -> Self {
        Self::identity()
    }
}

impl Pose {
    /// The identity.
    #[inline]
    pub fn identity() -> Self {
        Self { rotation: Rotation::identity(), translation: Vector3::zeros() }
    }

    /// A pose from rotation and translation (metres).
    #[inline]
    pub fn new(rotation: Rotation, translation: Vector3<f64>) -> Self {
        Self { rotation, translation }
    }

    /// `child_from_parent` of `parent_from_child`.
    #[inline]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// `a_from_c` of `a_from_b` (self) and `b_from_c`. The same as `*`.
    #[inline]
    pub fn compose(&self, other: &Self) -> Self {
        Self { rotation: self.rotation * other.rotation, translation: self.transform(&other.translation) }
    }

    /// The point in the parent frame (metres).
    #[inline]
    pub fn transform(&self, p_child: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * p_child + self.translation
    }

    /// The point in the child frame (metres): `R^T (p - t)`.
    #[inline]
    pub fn inverse_transform(&self, p_parent: &Vector3<f64>) -> Vector3<f64> {
        self.rotation.inverse_transform_vector(&(p_parent - self.translation))
    }

    /// Applies an error `[dtheta, dp]` (radians, metres; parent frame): `R = Exp(dtheta) R^`, `p = p^ + dp`.
    ///
    /// Inverse of [`Pose::local`].
    ///
    /// ```
    /// use geometry::{Pose, rotation};
    /// use nalgebra::{Vector3, Vector6};
    ///
    /// let estimate = Pose::new(rotation::exp(&Vector3::new(0.1, 0.2, 0.3)), Vector3::new(4.0, 5.0, 6.0));
    /// let error = Vector6::new(0.01, -0.02, 0.03, 0.4, -0.5, 0.6);
    /// let truth = estimate.retract(&error);
    /// assert!((estimate.local(&truth) - error).norm() < 1e-12);
    /// assert!((truth.translation - estimate.translation - Vector3::new(0.4, -0.5, 0.6)).norm() < 1e-12);
    /// ```
    pub fn retract(&self, error: &Vector6<f64>) -> Self {
        let (dtheta, dp) = split(error);
        Self { rotation: rotation::exp(&dtheta) * self.rotation, translation: self.translation + dp }
    }

    /// The error `[dtheta, dp]` of this pose with respect to `other`: `self.retract(&self.local(&other)) == other`.
    pub fn local(&self, other: &Self) -> Vector6<f64> {
        let dtheta = rotation::log(&(other.rotation * self.rotation.inverse()));
        let dp = other.translation - self.translation;
        Vector6::new(dtheta.x, dtheta.y, dtheta.z, dp.x, dp.y, dp.z)
    }

    /// Interpolates towards another pose: spherical interpolation of the rotation, linear of the position. Fraction 0 gives
    /// this pose, 1 the other.
    ///
    /// ```
    /// use geometry::Pose;
    /// use nalgebra::Vector3;
    /// let ahead = Pose::new(geometry::rotation::exp(&Vector3::new(0.0, 0.0, 0.4)), Vector3::new(2.0, 0.0, 0.0));
    /// let half = Pose::identity().interpolate(&ahead, 0.5);
    /// assert!((half.translation.x - 1.0).abs() < 1e-12 && (half.rotation.angle() - 0.2).abs() < 1e-12);
    /// ```
    pub fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        let rotation = self.rotation.try_slerp(&other.rotation, fraction, 1e-12).unwrap_or(other.rotation);
        Self::new(rotation, self.translation.lerp(&other.translation, fraction))
    }

    /// Whether all elements are finite.
    pub fn is_finite(&self) -> bool {
        self.rotation.coords.iter().chain(self.translation.iter()).all(|value| value.is_finite())
    }

    /// Whether the pose is finite and its quaternion has unit norm to 1e-6. Decoded poses need this check: decoding does
    /// not normalize.
    pub fn check_unit(&self) -> bool {
        self.is_finite() && (self.rotation.quaternion().norm() - 1.0).abs() <= UNIT_NORM_TOLERANCE
    }

    /// Jacobians of [`Pose::transform`] with respect to the pose's `[dtheta, dp]` (3x6) and the point (3x3).
    ///
    /// ```text
    /// [ -[R p]x  I ],  R
    /// ```
    pub fn transform_jacobians(&self, p_child: &Vector3<f64>) -> (Matrix3x6<f64>, Matrix3<f64>) {
        let mut by_pose = Matrix3x6::zeros();
        by_pose.fixed_view_mut::<3, 3>(0, 0).copy_from(&-skew(&(self.rotation * p_child)));
        by_pose.fixed_view_mut::<3, 3>(0, 3).fill_with_identity();
        (by_pose, self.rotation.to_rotation_matrix().into_inner())
    }

    /// Jacobians of [`Pose::inverse_transform`] with respect to the pose's `[dtheta, dp]` (3x6) and the point (3x3).
    ///
    /// ```text
    /// R^T [ [p - t]x  -I ],  R^T
    /// ```
    pub fn inverse_transform_jacobians(&self, p_parent: &Vector3<f64>) -> (Matrix3x6<f64>, Matrix3<f64>) {
        let child_from_parent = self.rotation.to_rotation_matrix().into_inner().transpose();
        let mut by_pose = Matrix3x6::zeros();
        let by_rotation = child_from_parent * skew(&(p_parent - self.translation));
        by_pose.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_rotation);
        by_pose.fixed_view_mut::<3, 3>(0, 3).copy_from(&-child_from_parent);
        (by_pose, child_from_parent)
    }
}

/// The rotation part and the translation part of a pose error.
pub(crate) fn split(error: &Vector6<f64>) -> (Vector3<f64>, Vector3<f64>) {
    (error.fixed_rows::<3>(0).into_owned(), error.fixed_rows::<3>(3).into_owned())
}

impl Mul<Pose> for Pose {
    type Output = Pose;
    fn mul(self, other: Pose) -> Pose {
        self.compose(&other)
    }
}

impl Mul<&Pose> for Pose {
    type Output = Pose;
    fn mul(self, other: &Pose) -> Pose {
        self.compose(other)
    }
}

impl Mul<Pose> for &Pose {
    type Output = Pose;
    fn mul(self, other: Pose) -> Pose {
        self.compose(&other)
    }
}

impl Mul<&Pose> for &Pose {
    type Output = Pose;
    fn mul(self, other: &Pose) -> Pose {
        self.compose(other)
    }
}
