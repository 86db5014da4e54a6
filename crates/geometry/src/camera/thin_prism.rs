//! COLMAP's fisheye model with tangential terms and a thin prism: the equidistant map, then a distortion of its image.
//!
//! ```text
//! [u, v] = [x, y] t / r, t = atan(r)
//! x' = u g + 2 p1 u v + p2 (t^2 + 2 u^2) + sx1 t^2
//! y' = v g + p1 (t^2 + 2 v^2) + 2 p2 u v + sy1 t^2
//! g = 1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8
//! ```
//! Coefficients are in COLMAP's order `[k1, k2, p1, p2, k3, k4, sx1, sy1]`.
//!
//! Sources: the documentation of COLMAP's cameras; Kannala & Brandt, PAMI 2006; Weng, Cohen & Herniou, PAMI 1992.

use super::distortion::{Distortion, radial_tangential_derivatives};
use super::error::ProjectionError;
use super::polynomial::{first_positive_root, is_positive_until};
use super::undistortion::{newton, start_within};
use nalgebra::{Matrix2, Vector2};
use std::f64::consts::FRAC_PI_2;

/// Its image is in rad.
const EQUIDISTANT: Distortion = Distortion::Equidistant([0.0; 4]);

/// The distortion of the equidistant image (rad), and its Jacobian.
fn distort_angles(k: &[f64; 8], angles: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
    let [k1, k2, p1, p2, k3, k4, sx1, sy1] = *k;
    let (u, v) = (angles.x, angles.y);
    let t2 = u * u + v * v;
    let gain = 1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)));
    let slope = 2.0 * (k1 + t2 * (2.0 * k2 + t2 * (3.0 * k3 + t2 * 4.0 * k4)));
    let distorted = Vector2::new(
        u * gain + 2.0 * p1 * u * v + p2 * (t2 + 2.0 * u * u) + sx1 * t2,
        v * gain + p1 * (t2 + 2.0 * v * v) + 2.0 * p2 * u * v + sy1 * t2,
    );
    let mixed = slope * u * v + 2.0 * (p1 * u + p2 * v);
    let jacobian = Matrix2::new(
        gain + slope * u * u + 2.0 * p1 * v + 6.0 * p2 * u + 2.0 * sx1 * u,
        mixed + 2.0 * sx1 * v,
        mixed + 2.0 * sy1 * u,
        gain + slope * v * v + 6.0 * p1 * v + 2.0 * p2 * u + 2.0 * sy1 * v,
    );
    (distorted, jacobian)
}

/// Distorted normalized coordinates, and their Jacobian with respect to the undistorted ones.
pub(super) fn distort_with_jacobian(k: &[f64; 8], normalized: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
    let (angles, by_normalized) = EQUIDISTANT.distort_with_jacobian(normalized);
    let (distorted, by_angles) = distort_angles(k, &angles);
    (distorted, by_angles * by_normalized)
}

/// The derivative of `t g(t)` by powers of `t^2`.
fn radial_slope(k: &[f64; 8]) -> [f64; 5] {
    let [k1, k2, _, _, k3, k4, _, _] = *k;
    [1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3, 9.0 * k4]
}

/// Whether the radial part increases from the centre out to this ray, and the map does not fold at it.
pub(super) fn covers(k: &[f64; 8], normalized: &Vector2<f64>) -> bool {
    let angles = EQUIDISTANT.distort(normalized);
    is_positive_until(&radial_slope(k), angles.norm_squared())
        && distort_angles(k, &angles).1.determinant() > 0.0
}

/// The inverse, by Newton in the equidistant image inside of the limit; the caller checks the result.
pub(super) fn undistort(k: &[f64; 8], distorted: &Vector2<f64>) -> Result<Vector2<f64>, ProjectionError> {
    let limit_squared = first_positive_root(&radial_slope(k)).min(FRAC_PI_2 * FRAC_PI_2);
    let start = start_within(limit_squared, distorted);
    let angles = newton(|at| distort_angles(k, at), limit_squared, start, distorted)?;
    let angle = angles.norm();
    Ok(if angle == 0.0 { angles } else { angles * (angle.tan() / angle) })
}

/// Derivatives of the distorted coordinates with respect to `k1`, `k2`, `p1` and `p2`.
pub(super) fn derivatives(normalized: &Vector2<f64>) -> [Vector2<f64>; 4] {
    radial_tangential_derivatives(&EQUIDISTANT.distort(normalized))
}
