//! Prediction of patches after a known rotation, or in the other camera of a stereo pair.

use super::lucas_kanade::Warp;
use geometry::{Camera, Pose, Rotation};
use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};

/// A pixel with its ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ray {
    /// Distorted pixel.
    pub(super) pixel: Vector2<f64>,
    /// Undistorted normalized coordinates.
    pub(super) normalized: Vector2<f64>,
}

impl Ray {
    /// The ray of a pixel; `None` if the camera model cannot invert it.
    pub(super) fn new(camera: &Camera, pixel: Vector2<f64>) -> Option<Self> {
        let normalized = camera.unproject(&pixel).ok()?;
        Some(Self { pixel, normalized })
    }

    /// Unit vector along the ray, in the camera frame.
    pub(super) fn bearing(&self) -> Vector3<f64> {
        self.normalized.push(1.0).normalize()
    }
}

/// Predicts the warp of the patch around a pixel from camera `from` to camera `to`, for a fronto-parallel surface at a
/// known depth.
///
/// # Arguments
/// * `to_from`: pose of the camera `from` in the frame of `to`, metres.
/// * `inverse_depth`: of the point in `from`, 1/m; 0 for a point at infinity.
///
/// # Returns
/// `None` if the point has no pixel inside the image of `to`.
pub(super) fn predict(
    from: &Camera,
    to: &Camera,
    to_from: &Pose,
    ray: &Ray,
    inverse_depth: f64,
) -> Option<Warp> {
    let rotation = to_from.rotation.to_rotation_matrix().into_inner();
    // The point divided by its depth in `from`: finite at infinity too.
    let seen = rotation * ray.normalized.push(1.0) + to_from.translation * inverse_depth;
    let (pixel, by_point) = to.project_with_jacobian(&seen).ok()?;
    if !to.contains(&pixel) {
        return None;
    }
    let (_, from_by_normalized) = from.distort_normalized_with_jacobian(&ray.normalized);
    let columns: Matrix2x3<f64> = by_point * rotation;
    let linear = columns.fixed_columns::<2>(0) * from_by_normalized.try_inverse()?;
    let linear: Matrix2<f64> = linear;
    Some(Warp { centre: pixel.cast(), linear: linear.cast() })
}

/// [`predict`] for a pure rotation of one camera.
pub(super) fn predict_rotated(camera: &Camera, current_from_previous: &Rotation, ray: &Ray) -> Option<Warp> {
    let rotated = Pose::new(*current_from_previous, Vector3::zeros());
    predict(camera, camera, &rotated, ray, 0.0)
}
