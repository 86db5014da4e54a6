//! Intrinsics as a parameter vector for online calibration: `[fx, fy, cx, cy, distortion...]`.
//!
//! Of a distortion with more than four coefficients the first four are parameters, and the others stay as they were calibrated: they act at
//! the border of the image, where an online calibration sees too little to tell them apart.
//!
//! | model | parameters | fixed |
//! |---|---|---|
//! | rational | k1, k2, p1, p2 | k3 to k6, s1 to s4 |
//! | thin prism fisheye | k1, k2, p1, p2 | k3, k4, sx1, sy1 |
//! | double sphere; extended unified | xi, alpha; alpha, beta | |
//! | omnidirectional | xi, k1, k2, p1 | p2 |

use super::distortion::{Distortion, equidistant_powers, fov_scale, radial_tangential_derivatives};
use super::sphere::{DoubleSphere, Eucm, Omni};
use super::{Camera, ProjectionError, normalize};
use super::{rational, thin_prism};
use nalgebra::{SMatrix, SVector, Vector2, Vector3};

/// Maximum number of intrinsic parameters.
pub const MAX_INTRINSICS: usize = 8;

/// Jacobian of a pixel with respect to the intrinsics; columns of parameters that the model does not have are zero.
pub type IntrinsicsJacobian = SMatrix<f64, 2, MAX_INTRINSICS>;

impl Camera {
    /// Number of intrinsic parameters: four and those of the distortion, of which at most the first four count.
    pub fn intrinsics_len(&self) -> usize {
        4 + match self.distortion {
            Distortion::None => 0,
            Distortion::RadialTangential(_)
            | Distortion::Equidistant(_)
            | Distortion::Rational(_)
            | Distortion::ThinPrismFisheye(_)
            | Distortion::Omni { .. } => 4,
            Distortion::Fov(_) => 1,
            Distortion::DoubleSphere { .. } | Distortion::Eucm { .. } => 2,
        }
    }

    /// Adds a correction to the intrinsics: `[fx, fy, cx, cy]` in pixels, then the distortion parameters in the order of
    /// the model. Elements from [`Self::intrinsics_len`] on are ignored.
    pub fn add_to_intrinsics(&mut self, change: &SVector<f64, MAX_INTRINSICS>) {
        for k in 0..2 {
            self.focal[k] += change[k];
            self.centre[k] += change[2 + k];
        }
        let add = |values: &mut [f64]| {
            values.iter_mut().zip(change.iter().skip(4)).for_each(|(value, step)| *value += step);
        };
        match &mut self.distortion {
            Distortion::None => {}
            Distortion::RadialTangential(values) | Distortion::Equidistant(values) => add(values),
            Distortion::Fov(omega) => *omega += change[4],
            Distortion::Rational(values) => add(&mut values[..4]),
            Distortion::ThinPrismFisheye(values) => add(&mut values[..4]),
            Distortion::DoubleSphere { xi: first, alpha: second }
            | Distortion::Eucm { alpha: first, beta: second } => {
                *first += change[4];
                *second += change[5];
            }
            Distortion::Omni { xi, distortion } => {
                *xi += change[4];
                distortion.iter_mut().zip(change.iter().skip(5)).for_each(|(value, step)| *value += step);
            }
        }
    }

    /// Jacobian of the pixel of a point (camera frame, metres) with respect to the intrinsics.
    ///
    /// # Errors
    /// [`ProjectionError`] as in [`Camera::project`].
    pub fn intrinsics_jacobian(
        &self,
        p_camera: &Vector3<f64>,
    ) -> Result<IntrinsicsJacobian, ProjectionError> {
        let normalized = normalize(p_camera)?;
        let distorted = self.distortion.distort(&normalized);
        let mut jacobian = IntrinsicsJacobian::zeros();
        jacobian[(0, 0)] = distorted.x;
        jacobian[(1, 1)] = distorted.y;
        jacobian[(0, 2)] = 1.0;
        jacobian[(1, 3)] = 1.0;
        for (k, by_coefficient) in
            distortion_derivatives(&self.distortion, &normalized).into_iter().enumerate()
        {
            jacobian[(0, 4 + k)] = self.focal[0] * by_coefficient.x;
            jacobian[(1, 4 + k)] = self.focal[1] * by_coefficient.y;
        }
        Ok(jacobian)
    }
}

/// Derivatives of the distorted normalized coordinates with respect to the coefficients; zero beyond the model.
fn distortion_derivatives(distortion: &Distortion, normalized: &Vector2<f64>) -> [Vector2<f64>; 4] {
    let r2 = normalized.norm_squared();
    match distortion {
        Distortion::None => [Vector2::zeros(); 4],
        Distortion::RadialTangential(_) => radial_tangential_derivatives(normalized),
        Distortion::Equidistant(_) => {
            let r = r2.sqrt();
            if r == 0.0 {
                return [Vector2::zeros(); 4];
            }
            equidistant_powers(r.atan()).map(|power| normalized * (power / r))
        }
        Distortion::Fov(omega) => {
            let r = r2.sqrt();
            if r == 0.0 {
                return [Vector2::zeros(); 4];
            }
            let scale = fov_scale(*omega);
            // d scale / d omega of 2 tan(omega / 2) is 1 + tan^2(omega / 2).
            let steeper = 1.0 + 0.25 * scale * scale;
            let angle = (scale * r).atan();
            let by_omega = steeper * r / (1.0 + scale * scale * r2) / omega - angle / (omega * omega);
            [normalized * (by_omega / r), Vector2::zeros(), Vector2::zeros(), Vector2::zeros()]
        }
        Distortion::Rational(k) => rational::derivatives(k, normalized),
        Distortion::ThinPrismFisheye(_) => thin_prism::derivatives(normalized),
        Distortion::DoubleSphere { xi, alpha } => {
            let [by_xi, by_alpha] = DoubleSphere { xi: *xi, alpha: *alpha }.derivatives(normalized);
            [by_xi, by_alpha, Vector2::zeros(), Vector2::zeros()]
        }
        Distortion::Eucm { alpha, beta } => {
            let [by_alpha, by_beta] = Eucm { alpha: *alpha, beta: *beta }.derivatives(normalized);
            [by_alpha, by_beta, Vector2::zeros(), Vector2::zeros()]
        }
        Distortion::Omni { xi, distortion } => {
            Omni { xi: *xi, distortion: *distortion }.derivatives(normalized)
        }
    }
}
