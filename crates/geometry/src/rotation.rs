//! Rotations as Hamilton unit quaternions, with the exponential map of SO(3) and its Jacobians.
//!
//! A rotation vector `phi` (radians) is an axis times an angle. Errors multiply on the left: `R = Exp(dtheta) R^`.
//!
//! ```text
//! Exp(phi + d) ~ Exp(J_l(phi) d) Exp(phi) = Exp(phi) Exp(J_r(phi) d),   J_r(phi) = J_l(-phi)
//! ```
//!
//! Source: Sola, Deray & Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, section IV-B.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// A rotation: a Hamilton unit quaternion.
pub type Rotation = UnitQuaternion<f64>;

/// Squared angle (rad^2) below which Taylor series replace the closed forms, which cancel there.
const SMALL_ANGLE_SQUARED: f64 = 1e-4;

/// The matrix of the cross product: `skew(v) * w == v.cross(w)`.
///
/// ```text
///           |  0  -z   y |
/// skew(v) = |  z   0  -x |
///           | -y   x   0 |
/// ```
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// The rotation about the axis `phi / |phi|` by the angle `|phi|` (radians).
///
/// ```
/// use nalgebra::Vector3;
/// let quarter_turn = geometry::rotation::exp(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
/// assert!((quarter_turn * Vector3::x() - Vector3::y()).norm() < 1e-15);
/// ```
pub fn exp(phi: &Vector3<f64>) -> Rotation {
    let angle_squared = phi.norm_squared();
    let (w, scale) = if angle_squared < SMALL_ANGLE_SQUARED {
        let h2 = angle_squared / 4.0;
        (1.0 - h2 / 2.0 * (1.0 - h2 / 12.0), 0.5 * (1.0 - h2 / 6.0 * (1.0 - h2 / 20.0)))
    } else {
        let angle = angle_squared.sqrt();
        let (sin, cos) = (angle / 2.0).sin_cos();
        (cos, sin / angle)
    };
    UnitQuaternion::new_normalize(Quaternion::from_parts(w, phi * scale))
}

/// The rotation vector of `rotation` (radians), of a length of at most pi. Undoes [`exp`].
pub fn log(rotation: &Rotation) -> Vector3<f64> {
    let q = rotation.quaternion();
    let (w, v) = if q.w < 0.0 { (-q.w, -q.imag()) } else { (q.w, q.imag()) };
    let sin_half_squared = v.norm_squared();
    if sin_half_squared < 1e-10 {
        // atan(x) / x = 1 - x^2 / 3 + ..., x = |v| / w
        let ratio_squared = sin_half_squared / (w * w);
        return v * (2.0 / w * (1.0 - ratio_squared / 3.0));
    }
    let sin_half = sin_half_squared.sqrt();
    v * (2.0 * sin_half.atan2(w) / sin_half)
}

/// The left Jacobian of SO(3): `Exp(phi + d) ~ Exp(left_jacobian(phi) d) Exp(phi)`.
pub fn left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let t2 = phi.norm_squared();
    let (a, b) = if t2 < SMALL_ANGLE_SQUARED {
        (0.5 - t2 / 24.0 * (1.0 - t2 / 30.0), (1.0 - t2 / 20.0 * (1.0 - t2 / 42.0)) / 6.0)
    } else {
        let t = t2.sqrt();
        ((1.0 - t.cos()) / t2, (t - t.sin()) / (t2 * t))
    };
    let k = skew(phi);
    Matrix3::identity() + k * a + k * k * b
}

/// The inverse of [`left_jacobian`], for angles below 2 pi.
pub fn left_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    let t2 = phi.norm_squared();
    let b = if t2 < SMALL_ANGLE_SQUARED {
        (1.0 + t2 / 60.0 * (1.0 + t2 / 42.0)) / 12.0
    } else {
        let half = t2.sqrt() / 2.0;
        (1.0 - half * half.cos() / half.sin()) / t2
    };
    let k = skew(phi);
    Matrix3::identity() - k * 0.5 + k * k * b
}

/// The right Jacobian of SO(3): `Exp(phi + d) ~ Exp(phi) Exp(right_jacobian(phi) d)`.
pub fn right_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian(&-phi)
}

/// The inverse of [`right_jacobian`], for angles below 2 pi.
pub fn right_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
    left_jacobian_inverse(&-phi)
}
