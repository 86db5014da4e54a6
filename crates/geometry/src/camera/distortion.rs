//! The distortion models, from undistorted to distorted normalized coordinates.
//!
//! Sources: radial-tangential, Brown 1966 as in OpenCV; equidistant, Kannala & Brandt, PAMI 2006; FOV, Devernay &
//! Faugeras, "Straight lines have to be straight", 2001. The others are in `rational`, `thin_prism` and `sphere`.

use super::error::CameraError;
use super::plausibility::MAX_DISTORTION;
use super::polynomial::is_positive_until;
use super::sphere::{DoubleSphere, Eucm, Omni};
use super::{rational, thin_prism};
use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

/// Squared radius below which the radial models use their Taylor series.
const SMALL_RADIUS_SQUARED: f64 = 1e-10;
/// Minimum FOV parameter (rad); below it the model is numerically undistorted.
const MIN_OMEGA: f64 = 1e-4;

/// Lens distortion: maps undistorted to distorted normalized coordinates `(x, y)`.
///
/// Normalized coordinates are `(x / z, y / z)` with z > 0: rays at 90 degrees from the optical axis and beyond are not covered,
/// though some of the models have them. `r^2 = x^2 + y^2`.
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
    /// OpenCV's full model, `[k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4]`; zeros for what a calibration does not have.
    /// ```text
    /// x' = x g + 2 p1 x y + p2 (r^2 + 2 x^2) + s1 r^2 + s2 r^4
    /// y' = y g + p1 (r^2 + 2 y^2) + 2 p2 x y + s3 r^2 + s4 r^4
    /// g = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
    /// ```
    Rational([f64; 12]),
    /// COLMAP's `[k1, k2, p1, p2, k3, k4, sx1, sy1]`: with `t = atan(r)` and `[u, v] = [x, y] t / r`
    /// ```text
    /// x' = u g + 2 p1 u v + p2 (t^2 + 2 u^2) + sx1 t^2
    /// y' = v g + p1 (t^2 + 2 v^2) + 2 p2 u v + sy1 t^2
    /// g = 1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8
    /// ```
    ThinPrismFisheye([f64; 8]),
    /// Double sphere (Usenko et al. 2018), Kalibr's `ds`. The focal length is the model's: the image of the centre is magnified
    /// by `1 / (1 + xi)`.
    /// ```text
    /// [x', y'] = [x, y] / (alpha sqrt(r^2 + w^2) + (1 - alpha) w), w = 1 + xi sqrt(1 + r^2)
    /// ```
    DoubleSphere {
        /// Distance of the centres of the spheres, -1 to 1.
        xi: f64,
        /// 0 to 1.
        alpha: f64,
    },
    /// Extended unified model (Khomutenko et al. 2016), Kalibr's `eucm`. With `beta = 1` it is the unified model.
    /// ```text
    /// [x', y'] = [x, y] / (alpha sqrt(1 + beta r^2) + 1 - alpha)
    /// ```
    Eucm {
        /// 0 to 1.
        alpha: f64,
        /// Positive.
        beta: f64,
    },
    /// Omnidirectional model (Mei & Rives 2007), Kalibr's `omni` with `radtan`: `[x, y] / (1 + xi sqrt(1 + r^2))`, distorted as by
    /// [`Self::RadialTangential`]. The focal length is the model's, `1 + xi` times that of a pinhole.
    Omni {
        /// Distance of the centres of sphere and projection, above -1; 1 for a parabolic mirror.
        xi: f64,
        /// `[k1, k2, p1, p2]`
        distortion: [f64; 4],
    },
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
            _ => self.distort_general(normalized).0,
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
            _ => self.distort_general(normalized),
        }
    }

    /// [`Self::distort_with_jacobian`] of the models with more terms, apart so that the others stay small where they are inlined.
    #[inline(never)]
    fn distort_general(&self, normalized: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        match *self {
            Self::Rational(ref k) => rational::distort_with_jacobian(k, normalized),
            Self::ThinPrismFisheye(ref k) => thin_prism::distort_with_jacobian(k, normalized),
            Self::DoubleSphere { xi, alpha } => DoubleSphere { xi, alpha }.distort_with_jacobian(normalized),
            Self::Eucm { alpha, beta } => Eucm { alpha, beta }.distort_with_jacobian(normalized),
            Self::Omni { xi, distortion } => Omni { xi, distortion }.distort_with_jacobian(normalized),
            Self::None | Self::RadialTangential(_) | Self::Equidistant(_) | Self::Fov(_) => {
                (*normalized, Matrix2::identity())
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
            Self::Equidistant(k) => equidistant_increases_to(k, normalized.norm().atan()),
            _ => self.covers_general(normalized),
        }
    }

    #[inline(never)]
    fn covers_general(&self, normalized: &Vector2<f64>) -> bool {
        match *self {
            Self::Rational(ref k) => rational::covers(k, normalized),
            Self::ThinPrismFisheye(ref k) => thin_prism::covers(k, normalized),
            Self::DoubleSphere { xi, alpha } => DoubleSphere { xi, alpha }.covers(normalized),
            Self::Omni { xi, distortion } => Omni { xi, distortion }.covers(normalized),
            // The radius of the extended unified model increases for all rays to the front.
            Self::None
            | Self::RadialTangential(_)
            | Self::Equidistant(_)
            | Self::Fov(_)
            | Self::Eucm { .. } => true,
        }
    }

    /// Checks that the coefficients are finite and in range.
    pub(super) fn validate(&self) -> Result<(), CameraError> {
        if let Self::Fov(omega) = *self {
            let is_valid = (MIN_OMEGA..std::f64::consts::PI).contains(&omega);
            return if is_valid { Ok(()) } else { Err(CameraError::FovParameter { omega, min: MIN_OMEGA }) };
        }
        if let Some(wrong) = self.coefficients().into_iter().find(|value| !value.is_finite()) {
            return Err(CameraError::DistortionCoefficients(wrong));
        }
        let within = |parameter: &'static str, value: f64, min: f64, max: f64, is_open: bool| {
            let is_valid = if is_open { min < value && value < max } else { (min..=max).contains(&value) };
            if is_valid { Ok(()) } else { Err(CameraError::ModelParameter { parameter, value, min, max }) }
        };
        match *self {
            Self::DoubleSphere { xi, alpha } => {
                within("xi", xi, -1.0, 1.0, true)?;
                within("alpha", alpha, 0.0, 1.0, false)
            }
            Self::Eucm { alpha, beta } => {
                within("alpha", alpha, 0.0, 1.0, false)?;
                within("beta", beta, 0.0, MAX_DISTORTION, true)
            }
            Self::Omni { xi, .. } => within("xi", xi, -1.0, MAX_DISTORTION, true),
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
            _ => (1.0, 0.0),
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

/// The derivative of the equidistant polynomial by powers of `t^2`.
pub(super) fn equidistant_slope(k: &[f64; 4]) -> [f64; 5] {
    [1.0, 3.0 * k[0], 5.0 * k[1], 7.0 * k[2], 9.0 * k[3]]
}

/// Whether the equidistant polynomial increases from the centre out to an angle (rad).
///
/// The constant term and the negative ones of the slope, without the positive ones, decrease with the angle: where they are positive,
/// the slope is so from the centre on. Images of real lenses lie there, so that few rays need the search for a fold.
pub(super) fn equidistant_increases_to(k: &[f64; 4], t: f64) -> bool {
    let t2 = t * t;
    let slope = equidistant_slope(k);
    let [_, c1, c2, c3, c4] = slope.map(|coefficient| coefficient.min(0.0));
    let least = 1.0 + t2 * (c1 + t2 * (c2 + t2 * (c3 + t2 * c4)));
    equidistant(k, t).1 > 0.0 && (least > 0.0 || is_positive_until(&slope, t2))
}

/// Derivatives of the radial-tangential model with respect to `k1`, `k2`, `p1` and `p2`.
pub(super) fn radial_tangential_derivatives(normalized: &Vector2<f64>) -> [Vector2<f64>; 4] {
    let (x, y) = (normalized.x, normalized.y);
    let r2 = normalized.norm_squared();
    [
        normalized * r2,
        normalized * (r2 * r2),
        Vector2::new(2.0 * x * y, r2 + 2.0 * y * y),
        Vector2::new(r2 + 2.0 * x * x, 2.0 * x * y),
    ]
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
