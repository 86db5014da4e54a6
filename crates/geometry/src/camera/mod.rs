//! Pinhole cameras with lens distortion: project, unproject, and the Jacobians.

mod distortion;
mod error;
mod intrinsics;
mod parameters;
mod plausibility;
mod polynomial;
mod rational;
mod sphere;
mod thin_prism;
mod undistortion;

pub use distortion::Distortion;
pub use error::{CameraError, ProjectionError};
pub use intrinsics::{IntrinsicsJacobian, MAX_INTRINSICS};
pub use plausibility::{
    MAX_CAMERA_SIDE, MAX_CENTRE_OFFSET, MAX_DISTORTION, MAX_FOCAL, MAX_MOUNT_M, MAX_RATIONAL_TERM, MIN_FOCAL,
    check_mount,
};

use nalgebra::{Matrix2, Matrix2x3, Unit, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Depth (metres) at or below which a point is behind the camera.
const MIN_DEPTH: f64 = 1e-9;

/// A pinhole camera with lens distortion.
///
/// # Coordinate systems
/// Camera frame: x right, y down, z forward, metres. Normalized coordinates: `(x / z, y / z)` for z > 0, undistorted.
/// Pixels: distorted, as observed; (0, 0) is the centre of the top-left pixel.
///
/// ```text
/// pixel = focal .* distort(x / z, y / z) + centre
/// ```
/// Rays at 90 degrees from the optical axis and beyond have no normalized coordinates: pixels of such rays, in the corners of a fisheye
/// lens, are errors.
///
/// # Example
/// ```
/// use geometry::{Camera, Distortion};
/// use nalgebra::Vector3;
///
/// let camera = Camera {
///     width: 752,
///     height: 480,
///     focal: [458.654, 457.296],
///     centre: [367.215, 248.375],
///     distortion: Distortion::RadialTangential([-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]),
/// };
/// let pixel = camera.project(&Vector3::new(0.5, -0.2, 2.0))?;
/// let normalized = camera.unproject(&pixel)?;
/// assert!((normalized.x - 0.25).abs() < 1e-12 && (normalized.y + 0.1).abs() < 1e-12);
/// # Ok::<(), geometry::ProjectionError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Focal lengths `[fx, fy]`, pixels.
    pub focal: [f64; 2],
    /// Principal point `[cx, cy]`, pixels.
    pub centre: [f64; 2],
    /// Lens distortion.
    pub distortion: Distortion,
}

impl Camera {
    /// The distorted pixel of a point in the camera frame (metres). The pixel may lie outside the image, see
    /// [`Camera::contains`].
    ///
    /// # Errors
    /// [`ProjectionError::BehindCamera`], [`ProjectionError::OutsideModel`] where the distortion folds back,
    /// [`ProjectionError::NotFinite`] on NaN or infinity.
    #[inline]
    pub fn project(&self, p_camera: &Vector3<f64>) -> Result<Vector2<f64>, ProjectionError> {
        let normalized = normalize(p_camera)?;
        if !self.distortion.covers(&normalized) {
            return Err(ProjectionError::OutsideModel);
        }
        finite(self.pixel_of_distorted(&self.distortion.distort(&normalized)))
    }

    /// [`Camera::project`] with the Jacobian of the pixel with respect to the point (2x3, pixels per metre).
    ///
    /// # Errors
    /// As [`Camera::project`].
    #[inline]
    pub fn project_with_jacobian(
        &self,
        p_camera: &Vector3<f64>,
    ) -> Result<(Vector2<f64>, Matrix2x3<f64>), ProjectionError> {
        let normalized = normalize(p_camera)?;
        if !self.distortion.covers(&normalized) {
            return Err(ProjectionError::OutsideModel);
        }
        let (pixel, by_normalized) = self.distort_normalized_with_jacobian(&normalized);
        let inverse_depth = 1.0 / p_camera.z;
        let first = by_normalized.column(0) * inverse_depth;
        let second = by_normalized.column(1) * inverse_depth;
        let third = -(first * normalized.x + second * normalized.y);
        Ok((finite(pixel)?, Matrix2x3::from_columns(&[first, second, third])))
    }

    /// The distorted pixel of normalized coordinates, and the Jacobian of the one with respect to the other (pixels).
    #[inline]
    pub fn distort_normalized_with_jacobian(
        &self,
        normalized: &Vector2<f64>,
    ) -> (Vector2<f64>, Matrix2<f64>) {
        let (distorted, by_normalized) = self.distortion.distort_with_jacobian(normalized);
        let [fx, fy] = self.focal;
        let jacobian = Matrix2::new(
            by_normalized.m11 * fx,
            by_normalized.m12 * fx,
            by_normalized.m21 * fy,
            by_normalized.m22 * fy,
        );
        (self.pixel_of_distorted(&distorted), jacobian)
    }

    /// The undistorted normalized coordinates `(x / z, y / z)` of a pixel, to rounding precision.
    ///
    /// # Errors
    /// [`ProjectionError::OutsideModel`] if no ray in front of the camera has this pixel,
    /// [`ProjectionError::NotFinite`] on NaN or infinity.
    pub fn unproject(&self, pixel: &Vector2<f64>) -> Result<Vector2<f64>, ProjectionError> {
        let [fx, fy] = self.focal;
        let [cx, cy] = self.centre;
        let distorted = finite(Vector2::new((pixel.x - cx) / fx, (pixel.y - cy) / fy))?;
        self.distortion.undistort(&distorted)
    }

    /// The bearing of a pixel: unit vector in the camera frame towards the observed point.
    ///
    /// # Errors
    /// As [`Camera::unproject`].
    pub fn bearing(&self, pixel: &Vector2<f64>) -> Result<Unit<Vector3<f64>>, ProjectionError> {
        let normalized = self.unproject(pixel)?;
        Ok(Unit::new_normalize(Vector3::new(normalized.x, normalized.y, 1.0)))
    }

    /// Whether a pixel lies in the image, the outer half of the border pixels included.
    pub fn contains(&self, pixel: &Vector2<f64>) -> bool {
        (-0.5..=f64::from(self.width) - 0.5).contains(&pixel.x)
            && (-0.5..=f64::from(self.height) - 0.5).contains(&pixel.y)
    }

    /// Validates the parameters, for decoded data.
    ///
    /// # Errors
    /// [`CameraError`] if the image is empty, a focal length is not positive, a coefficient is not finite or out of
    /// range, or no camera has such parameters.
    pub fn validate(&self) -> Result<(), CameraError> {
        if self.width == 0 || self.height == 0 {
            return Err(CameraError::EmptyImage { width: self.width, height: self.height });
        }
        if !self.focal.iter().all(|f| f.is_finite() && *f > 0.0) {
            return Err(CameraError::FocalLength(self.focal[0], self.focal[1]));
        }
        if !self.centre.iter().all(|c| c.is_finite()) {
            return Err(CameraError::Centre(self.centre[0], self.centre[1]));
        }
        self.distortion.validate()?;
        plausibility::check(self)
    }

    #[inline]
    fn pixel_of_distorted(&self, distorted: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(
            self.focal[0] * distorted.x + self.centre[0],
            self.focal[1] * distorted.y + self.centre[1],
        )
    }
}

#[inline]
fn normalize(p_camera: &Vector3<f64>) -> Result<Vector2<f64>, ProjectionError> {
    if !p_camera.iter().all(|value| value.is_finite()) {
        return Err(ProjectionError::NotFinite);
    }
    if p_camera.z <= MIN_DEPTH {
        return Err(ProjectionError::BehindCamera);
    }
    Ok(Vector2::new(p_camera.x / p_camera.z, p_camera.y / p_camera.z))
}

#[inline]
fn finite(v: Vector2<f64>) -> Result<Vector2<f64>, ProjectionError> {
    if v.x.is_finite() && v.y.is_finite() { Ok(v) } else { Err(ProjectionError::NotFinite) }
}
