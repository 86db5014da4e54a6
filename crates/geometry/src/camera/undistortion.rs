//! Undistortion: closed form where it exists, otherwise guarded Newton iterations with analytic derivatives.

use super::distortion::{
    Distortion, equidistant, equidistant_increases_to, equidistant_slope, fov_scale, radial_limit_squared,
};
use super::error::ProjectionError;
use super::polynomial::first_positive_root;
use super::sphere::{DoubleSphere, Eucm, Omni};
use super::{rational, thin_prism};
use nalgebra::{Matrix2, Vector2};
use std::f64::consts::FRAC_PI_2;

/// Newton converges in 3 to 6 steps inside of a real image; far outside, damping may need more.
const MAX_ITERATIONS: usize = 50;
/// Residual (normalized coordinates) at convergence; 1e-14 is 5e-12 px at a focal length of 500.
const CONVERGED: f64 = 1e-14;
/// Maximum residual (normalized coordinates) where rounding stops the iteration earlier.
const ACCEPTABLE: f64 = 1e-12;
/// Relative error of the radius that Newton starts from.
const START_TOLERANCE: f64 = 1e-3;
/// Doublings of a radius: rays up to 1e-9 rad from the focal plane.
const MAX_DOUBLINGS: usize = 30;
/// Halvings of one Newton step.
const MAX_HALVINGS: usize = 20;

impl Distortion {
    /// Undistorted normalized coordinates: the inverse of [`Distortion::distort`].
    ///
    /// Closed form for the FOV, double sphere and extended unified models, and for the sphere of the omnidirectional one;
    /// otherwise Newton inside of the region where the radial part increases.
    ///
    /// # Errors
    /// [`ProjectionError::OutsideModel`] if no ray in front of the camera, in the region where the model is one-to-one, maps to
    /// `distorted`.
    pub fn undistort(&self, distorted: &Vector2<f64>) -> Result<Vector2<f64>, ProjectionError> {
        match self {
            Self::None => Ok(*distorted),
            Self::RadialTangential([k1, k2, ..]) => {
                let limit_squared = radial_limit_squared(*k1, *k2);
                let start = start_within(limit_squared, distorted);
                newton(|at| self.distort_with_jacobian(at), limit_squared, start, distorted)
            }
            Self::Equidistant(k) => {
                let radius = distorted.norm();
                if radius == 0.0 {
                    return Ok(*distorted);
                }
                Ok(distorted * (equidistant_angle(k, radius)?.tan() / radius))
            }
            Self::Fov(omega) => {
                let radius = distorted.norm();
                let angle = radius * omega;
                if angle >= FRAC_PI_2 {
                    return Err(ProjectionError::OutsideModel);
                }
                if radius == 0.0 {
                    return Ok(*distorted);
                }
                Ok(distorted * (angle.tan() / (fov_scale(*omega) * radius)))
            }
            Self::Rational(k) => self.verified(rational::undistort(k, distorted)?, distorted),
            Self::ThinPrismFisheye(k) => self.verified(thin_prism::undistort(k, distorted)?, distorted),
            Self::DoubleSphere { xi, alpha } => {
                self.verified(DoubleSphere { xi: *xi, alpha: *alpha }.undistort(distorted)?, distorted)
            }
            Self::Eucm { alpha, beta } => {
                self.verified(Eucm { alpha: *alpha, beta: *beta }.undistort(distorted)?, distorted)
            }
            Self::Omni { xi, distortion } => {
                self.verified(Omni { xi: *xi, distortion: *distortion }.undistort(distorted)?, distorted)
            }
        }
    }

    /// The undistorted coordinates, if they are in the region of the model and map to the distorted ones.
    fn verified(
        &self,
        undistorted: Vector2<f64>,
        distorted: &Vector2<f64>,
    ) -> Result<Vector2<f64>, ProjectionError> {
        let off = (self.distort(&undistorted) - distorted).norm();
        let found = if off <= ACCEPTABLE * (1.0 + distorted.norm()) {
            undistorted
        } else {
            // Closed forms lose digits where a small change of the ray moves the pixel far.
            newton(|at| self.distort_with_jacobian(at), f64::INFINITY, undistorted, distorted)?
        };
        if self.covers(&found) { Ok(found) } else { Err(ProjectionError::OutsideModel) }
    }
}

/// Where the iteration begins: at the distorted coordinates, or inside of the limit.
pub(super) fn start_within(limit_squared: f64, distorted: &Vector2<f64>) -> Vector2<f64> {
    let squared = distorted.norm_squared();
    if squared >= limit_squared { distorted * (0.9 * (limit_squared / squared).sqrt()) } else { *distorted }
}

/// Where the iteration begins if the radial part is far from the identity: on the ray whose radial part is the distorted radius.
///
/// # Arguments
/// * `radial`: the radial part of a radius, and its derivative, which is positive up to the limit.
pub(super) fn radial_start(
    radial: impl Fn(f64) -> (f64, f64),
    limit_squared: f64,
    distorted: &Vector2<f64>,
) -> Vector2<f64> {
    let target = distorted.norm();
    if target == 0.0 {
        return *distorted;
    }
    let (mut low, mut high) = (0.0, limit_squared.sqrt());
    if high.is_infinite() {
        high = target;
        for _ in 0..MAX_DOUBLINGS {
            if radial(high).0 >= target {
                break;
            }
            high *= 2.0;
        }
    }
    let mut radius = target.min(0.9 * high);
    for _ in 0..MAX_ITERATIONS {
        let (value, slope) = radial(radius);
        let residual = target - value;
        if residual.abs() <= START_TOLERANCE * target {
            break;
        }
        if residual < 0.0 {
            high = radius;
        } else {
            low = radius;
        }
        let next = radius + residual / slope;
        radius = if next > low && next < high { next } else { 0.5 * (low + high) };
    }
    distorted * (radius / target)
}

/// Two-dimensional Newton with step halving inside the circle where the model is one-to-one.
///
/// # Arguments
/// * `map`: the distorted coordinates of undistorted ones, and the Jacobian.
/// * `limit_squared`: the squared radius of the circle.
/// * `start`: in the circle.
pub(super) fn newton(
    map: impl Fn(&Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>),
    limit_squared: f64,
    start: Vector2<f64>,
    distorted: &Vector2<f64>,
) -> Result<Vector2<f64>, ProjectionError> {
    let tolerance = 1.0 + distorted.norm();
    let mut estimate = start;
    let (mut value, mut jacobian) = map(&estimate);
    let mut residual = distorted - value;
    for _ in 0..MAX_ITERATIONS {
        if residual.norm() <= CONVERGED * tolerance {
            break;
        }
        let Some(inverse) = jacobian.try_inverse() else { break };
        let mut step = inverse * residual;
        let mut improved = false;
        for _ in 0..MAX_HALVINGS {
            let candidate = estimate + step;
            if candidate.norm_squared() < limit_squared {
                let (candidate_value, candidate_jacobian) = map(&candidate);
                let candidate_residual = distorted - candidate_value;
                if candidate_residual.norm_squared() < residual.norm_squared() {
                    (estimate, value, jacobian) = (candidate, candidate_value, candidate_jacobian);
                    residual = distorted - value;
                    improved = true;
                    break;
                }
            }
            step *= 0.5;
        }
        if !improved {
            break;
        }
    }
    // A determinant that is not positive: beyond a fold that the tangential terms make inside of the circle.
    let is_found = residual.norm() <= ACCEPTABLE * tolerance && jacobian.determinant() > 0.0;
    if is_found { Ok(estimate) } else { Err(ProjectionError::OutsideModel) }
}

/// The angle (rad, below 90 degrees and the first fold) whose equidistant polynomial is `radius`.
fn equidistant_angle(k: &[f64; 4], radius: f64) -> Result<f64, ProjectionError> {
    if let Some(angle) = equidistant_angle_below(FRAC_PI_2, k, radius)
        && equidistant_increases_to(k, angle)
    {
        return Ok(angle);
    }
    // A fold may have led the iteration beyond it.
    let fold = first_positive_root(&equidistant_slope(k)).sqrt();
    let angle = if fold < FRAC_PI_2 { equidistant_angle_below(fold, k, radius) } else { None };
    angle.ok_or(ProjectionError::OutsideModel)
}

/// An angle (rad) below a limit whose equidistant polynomial is `radius`, where the polynomial increases: bracketed Newton. It finds the
/// one that there is where the polynomial increases up to the limit.
fn equidistant_angle_below(limit: f64, k: &[f64; 4], radius: f64) -> Option<f64> {
    let (mut low, mut high) = (0.0, limit);
    let mut angle = radius.min(0.99 * limit);
    for _ in 0..MAX_ITERATIONS {
        let (value, slope) = equidistant(k, angle);
        let residual = radius - value;
        if residual.abs() <= CONVERGED * (1.0 + radius) * 0.1 {
            break;
        }
        if slope <= 0.0 || residual < 0.0 {
            // Past the fold, or too far out.
            high = angle;
        } else {
            low = angle;
        }
        let newton = angle + residual / slope;
        let next = if slope > 0.0 && newton > low && newton < high { newton } else { 0.5 * (low + high) };
        angle = next;
    }
    let (value, slope) = equidistant(k, angle);
    let is_found = (radius - value).abs() <= ACCEPTABLE * (1.0 + radius) && slope > 0.0 && angle < limit;
    is_found.then_some(angle)
}
