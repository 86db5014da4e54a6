//! OpenCV's full model: a rational radial gain, tangential terms and a thin prism.
//!
//! ```text
//! x' = x g + 2 p1 x y + p2 (r^2 + 2 x^2) + s1 r^2 + s2 r^4
//! y' = y g + p1 (r^2 + 2 y^2) + 2 p2 x y + s3 r^2 + s4 r^4
//! g = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
//! ```
//! Coefficients are in OpenCV's order `[k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4]`.
//!
//! Sources: the documentation of OpenCV's calib3d; Claus & Fitzgibbon, "A rational function lens distortion model for general
//! cameras", CVPR 2005; Weng, Cohen & Herniou, PAMI 1992.

use super::distortion::radial_tangential_derivatives;
use super::error::ProjectionError;
use super::polynomial::{first_positive_root, is_positive_until};
use super::undistortion::{newton, radial_start};
use nalgebra::{Matrix2, Vector2};

/// Numerator and denominator of the gain, by powers of `r^2`.
fn gain_polynomials(k: &[f64; 12]) -> ([f64; 4], [f64; 4]) {
    ([1.0, k[0], k[1], k[4]], [1.0, k[5], k[6], k[7]])
}

/// A polynomial of degree 3 and its derivative.
fn cubic(c: &[f64; 4], s: f64) -> (f64, f64) {
    (c[0] + s * (c[1] + s * (c[2] + s * c[3])), c[1] + s * (2.0 * c[2] + s * 3.0 * c[3]))
}

/// Distorted normalized coordinates, and their Jacobian with respect to the undistorted ones.
pub(super) fn distort_with_jacobian(
    k: &[f64; 12],
    normalized: &Vector2<f64>,
) -> (Vector2<f64>, Matrix2<f64>) {
    let [_, _, p1, p2, _, _, _, _, s1, s2, s3, s4] = *k;
    let (x, y) = (normalized.x, normalized.y);
    let r2 = x * x + y * y;
    let (above, below) = gain_polynomials(k);
    let ((above, above_slope), (below, below_slope)) = (cubic(&above, r2), cubic(&below, r2));
    let gain = above / below;
    // d gain / d(r^2), times two.
    let slope = 2.0 * (above_slope - gain * below_slope) / below;
    let distorted = Vector2::new(
        x * gain + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2),
        y * gain + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + r2 * s4),
    );
    let mixed = slope * x * y + 2.0 * (p1 * x + p2 * y);
    let (prism_x, prism_y) = (2.0 * s1 + 4.0 * s2 * r2, 2.0 * s3 + 4.0 * s4 * r2);
    let jacobian = Matrix2::new(
        gain + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x + prism_x * x,
        mixed + prism_x * y,
        mixed + prism_y * x,
        gain + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x + prism_y * y,
    );
    (distorted, jacobian)
}

/// By powers of `r^2`: what has the sign of the derivative of `r g(r)`, `N D + 2 s (N' D - N D')`.
fn radial_slope(above: &[f64; 4], below: &[f64; 4]) -> [f64; 7] {
    let mut slope = [0.0; 7];
    for (i, a) in above.iter().enumerate() {
        for (j, b) in below.iter().enumerate() {
            slope[i + j] += a * b * (1.0 + 2.0 * (i as f64 - j as f64));
        }
    }
    slope
}

/// Whether the radial part increases from the centre out to this ray, and the map does not fold at it.
pub(super) fn covers(k: &[f64; 12], normalized: &Vector2<f64>) -> bool {
    let r2 = normalized.norm_squared();
    let (above, below) = gain_polynomials(k);
    is_positive_until(&below, r2)
        && is_positive_until(&radial_slope(&above, &below), r2)
        && distort_with_jacobian(k, normalized).1.determinant() > 0.0
}

/// The squared radius at which the radial part first turns back or has its pole; infinite where it never does.
fn limit_squared(k: &[f64; 12]) -> f64 {
    let (above, below) = gain_polynomials(k);
    first_positive_root(&below).min(first_positive_root(&radial_slope(&above, &below)))
}

/// The inverse, by Newton inside of the limit; the caller checks the result.
pub(super) fn undistort(k: &[f64; 12], distorted: &Vector2<f64>) -> Result<Vector2<f64>, ProjectionError> {
    let limit_squared = limit_squared(k);
    let (above, below) = gain_polynomials(k);
    let radial = |radius: f64| {
        let r2 = radius * radius;
        let ((a, a_slope), (b, b_slope)) = (cubic(&above, r2), cubic(&below, r2));
        let gain = a / b;
        (radius * gain, gain + 2.0 * r2 * (a_slope - gain * b_slope) / b)
    };
    let start = radial_start(radial, limit_squared, distorted);
    newton(|at| distort_with_jacobian(k, at), limit_squared, start, distorted)
}

/// Derivatives of the distorted coordinates with respect to `k1`, `k2`, `p1` and `p2`.
pub(super) fn derivatives(k: &[f64; 12], normalized: &Vector2<f64>) -> [Vector2<f64>; 4] {
    let (below, _) = cubic(&gain_polynomials(k).1, normalized.norm_squared());
    let [by_k1, by_k2, by_p1, by_p2] = radial_tangential_derivatives(normalized);
    [by_k1 / below, by_k2 / below, by_p1, by_p2]
}
