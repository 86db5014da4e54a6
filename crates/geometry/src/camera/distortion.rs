//! The distortion models, from undistorted to distorted normalized coordinates.
//!
//! Sources: radial-tangential, Brown 1966 as in OpenCV; equidistant, Kannala & Brandt, PAMI 2006; FOV, Devernay &
//! Faugeras, "Straight lines have to be straight", 2001.

use super::error::CameraError;
use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

/// Squared radius below which the radial models use their Taylor series.
const SMALL_RADIUS_SQUARED: f64 = 1e-10;
/// Minimum FOV parameter (rad); below it the model is numerically undistorted.
const MIN_OMEGA: f64 = 1e-4;

/// Lens distortion: maps undistorted to distorted normalized coordinates `(x, y)`.
///
/// # Example
/// ```
/// use geometry::Distortion;
/// use nalgebra::Vector2;
///
/// let fisheye = Distortion::Equidistant([-0.01, 0.02, 0.0, 0.0]);
/// let undistorted = Vector2::new(0.6, -0.3);
/// let distorted = fisheye.distort(&undistorted);
/// assert!((fisheye.undistort(&distorted)? - undistorted).norm() < 1e-12);
/// # Ok::<(), geometry::ProjectionError>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Distortion {
    /// An ideal pinhole.
    #[default]
    None,
    /// `[k1, k2, p1, p2]`:
    /// ```text
    /// x' = x (1 + k1 r^2 + k2 r^4) + 2 p1 x y + p2 (r^2 + 2 x^2)
    /// y' = y (1 + k1 r^2 + k2 r^4) + p1 (r^2 + 2 y^2) + 2 p2 x y
    /// ```
    RadialTangential([f64; 4]),
    /// `[k1, k2, k3, k4]` (fisheye): `r' = t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)`, `t = atan(r)`.
    Equidistant([f64; 4]),
    /// `omega` (radians): `r' = atan(2 r tan(omega / 2)) / omega`.
    Fov(f64),
}

impl Distortion {
    /// Distorted normalized coordinates.
    #[inline]
    pub fn distort(&self, normalized: &Vector2<f64>) -> Vector2<f64> {
        match self {
            Self::None => *normalized,
            Self::RadialTangential([k1, k2, p1, p2]) => {
                let (x, y) = (normalized.x, normalized.y);
                let r2 = x * x + y * y;
                let radial = 1.0 + r2 * (k1 + r2 * k2);
                Vector2::new(
                    x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                )
            }
            Self::Equidistant(_) | Self::Fov(_) => normalized * self.radial_gain(normalized.norm_squared()).0,
        }
    }

    /// Distorted normalized coordinates, and their Jacobian with respect to the undistorted ones.
    #[inline]
    pub fn distort_with_jacobian(&self, normalized: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        match self {
            Self::None => (*normalized, Matrix2::identity()),
            Self::RadialTangential([k1, k2, p1, p2]) => {
                let (x, y) = (normalized.x, normalized.y);
                let r2 = x * x + y * y;
                let radial = 1.0 + r2 * (k1 + r2 * k2);
                let slope = 2.0 * (k1 + 2.0 * r2 * k2); // d radial / d(r^2), times two
                let mixed = slope * x * y + 2.0 * (p1 * x + p2 * y);
                (
                    self.distort(normalized),
                    Matrix2::new(
                        radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
                        mixed,
                        mixed,
                        radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
                    ),
                )
            }
            Self::Equidistant(_) | Self::Fov(_) => {
                let (gain, bend) = self.radial_gain(normalized.norm_squared());
                (normalized * gain, Matrix2::identity() * gain + normalized * normalized.transpose() * bend)
            }
        }
    }

    /// Whether the model is one-to-one from the centre out to this ray.
    #[inline]
    pub(super) fn covers(&self, normalized: &Vector2<f64>) -> bool {
        match self {
            Self::None | Self::Fov(_) => true,
            Self::RadialTangential([k1, k2, ..]) => {
                normalized.norm_squared() < radial_limit_squared(*k1, *k2)
            }
            Self::Equidistant(k) => equidistant(k, normalized.norm().atan()).1 > 0.0,
        }
    }

    /// Checks that the coefficients are finite and in range.
    pub(super) fn validate(&self) -> Result<(), CameraError> {
        match *self {
            Self::RadialTangential(k) | Self::Equidistant(k) if !k.iter().all(|value| value.is_finite()) => {
                Err(CameraError::DistortionCoefficients(k))
            }
            Self::Fov(omega) if !(MIN_OMEGA..std::f64::consts::PI).contains(&omega) => {
                Err(CameraError::FovParameter { omega, min: MIN_OMEGA })
            }
            _ => Ok(()),
        }
    }

    /// For the purely radial models `d = n g(r) / r`: the gain `g / r`, and `(g' - g / r) / r^2`, such that the Jacobian is
    /// `gain I + bend n n^T`.
    fn radial_gain(&self, r2: f64) -> (f64, f64) {
        match self {
            Self::Equidistant(k) => {
                if r2 < SMALL_RADIUS_SQUARED {
                    let cubic = k[0] - 1.0 / 3.0;
                    return (1.0 + cubic * r2, 2.0 * cubic);
                }
                let r = r2.sqrt();
                let (value, slope) = equidistant(k, r.atan());
                let gain = value / r;
                (gain, (slope / (1.0 + r2) - gain) / r2)
            }
            Self::Fov(omega) => {
                let a = fov_scale(*omega);
                if r2 < SMALL_RADIUS_SQUARED {
                    let cubic = -a * a * a / (3.0 * omega);
                    return (a / omega + cubic * r2, 2.0 * cubic);
                }
                let r = r2.sqrt();
                let gain = (a * r).atan() / (omega * r);
                (gain, (a / (omega * (1.0 + a * a * r2)) - gain) / r2)
            }
            Self::None | Self::RadialTangential(_) => (1.0, 0.0),
        }
    }
}

/// The equidistant polynomial in the angle `t` (rad), and its derivative.
pub(super) fn equidistant(k: &[f64; 4], t: f64) -> (f64, f64) {
    let t2 = t * t;
    let value = t * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
    let slope = 1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])));
    (value, slope)
}

/// `[t^3, t^5, t^7, t^9]`, what the coefficients of the equidistant polynomial multiply.
pub(super) fn equidistant_powers(t: f64) -> [f64; 4] {
    let t2 = t * t;
    let cube = t * t2;
    [cube, cube * t2, cube * t2 * t2, cube * t2 * t2 * t2]
}

/// `2 tan(omega / 2)` of the FOV model.
pub(super) fn fov_scale(omega: f64) -> f64 {
    2.0 * (omega / 2.0).tan()
}

/// The squared radius at which `r (1 + k1 r^2 + k2 r^4)` first turns back; infinite where it never does.
///
/// The smallest positive root in `s = r^2` of `1 + 3 k1 s + 5 k2 s^2`.
#[inline]
pub(super) fn radial_limit_squared(k1: f64, k2: f64) -> f64 {
    let (a, b) = (5.0 * k2, 3.0 * k1);
    let discriminant = b * b - 4.0 * a;
    if discriminant < 0.0 {
        return f64::INFINITY;
    }
    // With q = -(b + sign(b) sqrt(D)) / 2 the roots are q / a and 1 / q, without cancellation.
    let q = -0.5 * (b + discriminant.sqrt().copysign(b));
    [q / a, 1.0 / q].into_iter().filter(|root| *root > 0.0).fold(f64::INFINITY, f64::min)
}
