//! Models that project onto a sphere or an ellipsoid first: `m = (x, y) / c(r^2)` at z = 1, with the closed inverse.
//!
//! | model | `c` with `d = sqrt(1 + r^2)` |
//! |---|---|
//! | double sphere | `alpha sqrt(r^2 + w^2) + (1 - alpha) w`, `w = 1 + xi d` |
//! | extended unified | `alpha sqrt(1 + beta r^2) + 1 - alpha` |
//! | omnidirectional | `1 + xi d`, and then a radial-tangential distortion of m |
//!
//! Sources: Usenko, Demmel & Cremers, "The double sphere camera model", 3DV 2018; Khomutenko, Garcia & Martinet, "An enhanced
//! unified camera model", RA-L 2016; Mei & Rives, "Single view point omnidirectional camera calibration from planar grids", ICRA 2007.

use super::distortion::{Distortion, radial_limit_squared, radial_tangential_derivatives};
use super::error::ProjectionError;
use super::undistortion::{newton, radial_start};
use nalgebra::{Matrix2, Vector2};

/// Parameters of the double sphere model.
#[derive(Clone, Copy)]
pub(super) struct DoubleSphere {
    pub(super) xi: f64,
    pub(super) alpha: f64,
}

/// Parameters of the extended unified model.
#[derive(Clone, Copy)]
pub(super) struct Eucm {
    pub(super) alpha: f64,
    pub(super) beta: f64,
}

/// Parameters of the omnidirectional model.
#[derive(Clone, Copy)]
pub(super) struct Omni {
    pub(super) xi: f64,
    /// `[k1, k2, p1, p2]`
    pub(super) distortion: [f64; 4],
}

/// `m = n / c`, and its Jacobian, of the divisor and its derivative with respect to `r^2`.
fn divided(normalized: &Vector2<f64>, divisor: f64, slope: f64) -> (Vector2<f64>, Matrix2<f64>) {
    let gain = 1.0 / divisor;
    let bend = -2.0 * slope * gain * gain;
    (normalized * gain, Matrix2::identity() * gain + normalized * normalized.transpose() * bend)
}

/// The normalized coordinates of a ray; an error for one that does not point to the front.
fn normalized_of(x: Vector2<f64>, z: f64) -> Result<Vector2<f64>, ProjectionError> {
    if z > 0.0 { Ok(x / z) } else { Err(ProjectionError::OutsideModel) }
}

impl DoubleSphere {
    /// Distances to the centres of the spheres: `d`, `w`, and `sqrt(r^2 + w^2)`.
    fn distances(&self, normalized: &Vector2<f64>) -> [f64; 3] {
        let r2 = normalized.norm_squared();
        let first = (1.0 + r2).sqrt();
        let shifted = 1.0 + self.xi * first;
        [first, shifted, (r2 + shifted * shifted).sqrt()]
    }

    pub(super) fn distort_with_jacobian(&self, normalized: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let Self { xi, alpha } = *self;
        let [first, shifted, second] = self.distances(normalized);
        let divisor = alpha * second + (1.0 - alpha) * shifted;
        let slope = 0.5 * (alpha * (1.0 + shifted * xi / first) / second + (1.0 - alpha) * xi / first);
        divided(normalized, divisor, slope)
    }

    /// Whether `c` and the derivative of `r / c`, `(1 + xi / d) ((1 - alpha) + alpha w / sqrt(r^2 + w^2)) / c^2`, are positive: they are so
    /// from the centre out to one radius. For `xi < 0` it is nearer than the bound of the paper, `z > -w2 d1`, between which and it two
    /// rays have one pixel.
    pub(super) fn covers(&self, normalized: &Vector2<f64>) -> bool {
        let [_, shifted, second] = self.distances(normalized);
        let alpha = self.alpha;
        alpha * second + (1.0 - alpha) * shifted > 0.0 && (1.0 - alpha) * second + alpha * shifted > 0.0
    }

    pub(super) fn undistort(&self, distorted: &Vector2<f64>) -> Result<Vector2<f64>, ProjectionError> {
        let Self { xi, alpha } = *self;
        let r2 = distorted.norm_squared();
        let inside = 1.0 - (2.0 * alpha - 1.0) * r2;
        if inside < 0.0 {
            return Err(ProjectionError::OutsideModel);
        }
        let z = (1.0 - alpha * alpha * r2) / (alpha * inside.sqrt() + 1.0 - alpha);
        let factor = (z * xi + (z * z + (1.0 - xi * xi) * r2).sqrt()) / (z * z + r2);
        normalized_of(distorted * factor, factor * z - xi)
    }

    /// Derivatives of the distorted coordinates with respect to `xi` and `alpha`.
    pub(super) fn derivatives(&self, normalized: &Vector2<f64>) -> [Vector2<f64>; 2] {
        let [first, shifted, second] = self.distances(normalized);
        let alpha = self.alpha;
        let divisor = alpha * second + (1.0 - alpha) * shifted;
        let by_divisor = -normalized / (divisor * divisor);
        [
            by_divisor * (alpha * shifted * first / second + (1.0 - alpha) * first),
            by_divisor * (second - shifted),
        ]
    }
}

impl Eucm {
    fn distance(&self, normalized: &Vector2<f64>) -> f64 {
        (1.0 + self.beta * normalized.norm_squared()).sqrt()
    }

    pub(super) fn distort_with_jacobian(&self, normalized: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let Self { alpha, beta } = *self;
        let distance = self.distance(normalized);
        divided(normalized, alpha * distance + 1.0 - alpha, 0.5 * alpha * beta / distance)
    }

    pub(super) fn undistort(&self, distorted: &Vector2<f64>) -> Result<Vector2<f64>, ProjectionError> {
        let Self { alpha, beta } = *self;
        let scaled = beta * distorted.norm_squared();
        let inside = 1.0 - (2.0 * alpha - 1.0) * scaled;
        if inside < 0.0 {
            return Err(ProjectionError::OutsideModel);
        }
        let z = (1.0 - alpha * alpha * scaled) / (alpha * inside.sqrt() + 1.0 - alpha);
        normalized_of(*distorted, z)
    }

    /// Derivatives of the distorted coordinates with respect to `alpha` and `beta`.
    pub(super) fn derivatives(&self, normalized: &Vector2<f64>) -> [Vector2<f64>; 2] {
        let alpha = self.alpha;
        let distance = self.distance(normalized);
        let divisor = alpha * distance + 1.0 - alpha;
        let by_divisor = -normalized / (divisor * divisor);
        [by_divisor * (distance - 1.0), by_divisor * (0.5 * alpha * normalized.norm_squared() / distance)]
    }
}

impl Omni {
    fn lens(&self) -> Distortion {
        Distortion::RadialTangential(self.distortion)
    }

    /// The projection of the unit sphere before its distortion, and the Jacobian.
    fn project(&self, normalized: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let distance = (1.0 + normalized.norm_squared()).sqrt();
        divided(normalized, 1.0 + self.xi * distance, 0.5 * self.xi / distance)
    }

    pub(super) fn distort_with_jacobian(&self, normalized: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let (projected, by_normalized) = self.project(normalized);
        let (distorted, by_projected) = self.lens().distort_with_jacobian(&projected);
        (distorted, by_projected * by_normalized)
    }

    pub(super) fn covers(&self, normalized: &Vector2<f64>) -> bool {
        let [k1, k2, ..] = self.distortion;
        let (projected, _) = self.project(normalized);
        let distance = (1.0 + normalized.norm_squared()).sqrt();
        1.0 + self.xi * distance > 0.0
            && projected.norm_squared() < radial_limit_squared(k1, k2)
            && self.lens().distort_with_jacobian(&projected).1.determinant() > 0.0
    }

    pub(super) fn undistort(&self, distorted: &Vector2<f64>) -> Result<Vector2<f64>, ProjectionError> {
        let (lens, [k1, k2, ..]) = (self.lens(), self.distortion);
        let limit_squared = radial_limit_squared(k1, k2);
        let radial = |radius: f64| {
            let r2 = radius * radius;
            (radius * (1.0 + r2 * (k1 + r2 * k2)), 1.0 + r2 * (3.0 * k1 + r2 * 5.0 * k2))
        };
        let start = radial_start(radial, limit_squared, distorted);
        let projected = newton(|at| lens.distort_with_jacobian(at), limit_squared, start, distorted)?;
        let xi = self.xi;
        let r2 = projected.norm_squared();
        let inside = 1.0 + (1.0 - xi * xi) * r2;
        if inside < 0.0 {
            return Err(ProjectionError::OutsideModel);
        }
        let factor = (xi + inside.sqrt()) / (1.0 + r2);
        normalized_of(projected * factor, factor - xi)
    }

    /// Derivatives of the distorted coordinates with respect to `xi`, `k1`, `k2` and `p1`.
    pub(super) fn derivatives(&self, normalized: &Vector2<f64>) -> [Vector2<f64>; 4] {
        let (projected, _) = self.project(normalized);
        let (_, by_projected) = self.lens().distort_with_jacobian(&projected);
        let distance = (1.0 + normalized.norm_squared()).sqrt();
        let divisor = 1.0 + self.xi * distance;
        let [by_k1, by_k2, by_p1, _] = radial_tangential_derivatives(&projected);
        [by_projected * normalized * (-distance / (divisor * divisor)), by_k1, by_k2, by_p1]
    }
}
