//! Undistortion: closed form where it exists, otherwise guarded Newton iterations with analytic derivatives.

use super::distortion::{Distortion, equidistant, fov_scale, radial_limit_squared};
use super::error::ProjectionError;
use nalgebra::Vector2;
use std::f64::consts::FRAC_PI_2;

/// Newton converges in 3 to 6 steps inside of a real image; far outside, damping may need more.
const MAX_ITERATIONS: usize = 50;
/// Residual (normalized coordinates) at convergence; 1e-14 is 5e-12 px at a focal length of 500.
const CONVERGED: f64 = 1e-14;
/// Maximum residual (normalized coordinates) where rounding stops the iteration earlier.
const ACCEPTABLE: f64 = 1e-12;
/// Halvings of one Newton step.
const MAX_HALVINGS: usize = 20;

impl Distortion {
    /// Undistorted normalized coordinates: the inverse of [`Distortion::distort`].
    ///
    /// # Errors
    /// [`ProjectionError::OutsideModel`] if no ray in front of the camera maps to `distorted`.
    pub fn undistort(&self, distorted: &Vector2<f64>) -> Result<Vector2<f64>, ProjectionError> {
        match self {
            Self::None => Ok(*distorted),
            Self::RadialTangential([k1, k2, ..]) => {
                undistort_newton(self, radial_limit_squared(*k1, *k2), distorted)
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
        }
    }
}

/// Two-dimensional Newton with step halving inside the circle where the model is one-to-one.
fn undistort_newton(
    model: &Distortion,
    limit_squared: f64,
    distorted: &Vector2<f64>,
) -> Result<Vector2<f64>, ProjectionError> {
    let tolerance = 1.0 + distorted.norm();
    let mut estimate = *distorted;
    if estimate.norm_squared() >= limit_squared {
        estimate *= 0.9 * (limit_squared / estimate.norm_squared()).sqrt();
    }
    let (mut value, mut jacobian) = model.distort_with_jacobian(&estimate);
    let mut residual = distorted - value;
    for _ in 0..MAX_ITERATIONS {
        if residual.norm() <= CONVERGED * tolerance {
            return Ok(estimate);
        }
        let Some(inverse) = jacobian.try_inverse() else { break };
        let mut step = inverse * residual;
        let mut improved = false;
        for _ in 0..MAX_HALVINGS {
            let candidate = estimate + step;
            if candidate.norm_squared() < limit_squared {
                let (candidate_value, candidate_jacobian) = model.distort_with_jacobian(&candidate);
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
    if residual.norm() <= ACCEPTABLE * tolerance { Ok(estimate) } else { Err(ProjectionError::OutsideModel) }
}

/// The angle (rad, below 90 degrees) whose equidistant polynomial is `radius`: bracketed Newton.
fn equidistant_angle(k: &[f64; 4], radius: f64) -> Result<f64, ProjectionError> {
    let (mut low, mut high) = (0.0, FRAC_PI_2);
    let mut angle = radius.min(0.99 * FRAC_PI_2);
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
    if (radius - value).abs() <= ACCEPTABLE * (1.0 + radius) && slope > 0.0 && angle < FRAC_PI_2 {
        Ok(angle)
    } else {
        Err(ProjectionError::OutsideModel)
    }
}
