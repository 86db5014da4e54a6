//! Levenberg-Marquardt over the inverse-depth parameters of a landmark in its anchor view.
//!
//! The landmark is `p_anchor = (x, y, 1) / rho`. Its bearing in a view is the direction of
//!
//! ```text
//! h = C (x, y, 1) + rho t,      camera_from_anchor = (C, t)
//! ```
//!
//! which is the point times `rho` and has the same pixel. It is defined for `rho = 0`, a landmark at infinity.

use super::View;
use crate::camera::Camera;
use crate::pose::Pose;
use crate::robust::huber;
use nalgebra::{Matrix3, Vector2, Vector3};

/// Initial damping relative to the diagonal of the normal matrix.
const INITIAL_DAMPING: f64 = 1e-6;
/// Relative decrease of the cost at convergence.
const CONVERGED: f64 = 1e-8;

/// Inverse-depth parameters in the anchor view.
#[derive(Clone, Copy, Debug)]
pub(super) struct InverseDepth {
    /// Normalized coordinate.
    pub x: f64,
    /// Normalized coordinate.
    pub y: f64,
    /// Inverse depth, 1/m.
    pub rho: f64,
}

/// A view relative to the anchor.
pub(super) struct ViewGeometry<'a> {
    camera: &'a Camera,
    pixel: Vector2<f64>,
    inverse_sigma: f64,
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

impl<'a> ViewGeometry<'a> {
    pub fn new(camera: &'a Camera, view: &View, anchor: &Pose) -> Self {
        let parent_from_camera = &view.parent_from_camera;
        Self {
            camera,
            pixel: view.pixel,
            inverse_sigma: 1.0 / view.sigma_px,
            rotation: (parent_from_camera.rotation.inverse() * anchor.rotation)
                .to_rotation_matrix()
                .into_inner(),
            translation: parent_from_camera.inverse_transform(&anchor.translation),
        }
    }

    /// Centre of the camera and unit direction of a ray, in the anchor's frame.
    pub fn ray_in_anchor(&self, normalized: &Vector2<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let direction = self.rotation.tr_mul(&Vector3::new(normalized.x, normalized.y, 1.0));
        (-self.rotation.tr_mul(&self.translation), direction.normalize())
    }

    /// Depth in this view, metres.
    pub fn depth(&self, landmark: &InverseDepth) -> f64 {
        self.direction(landmark).z / landmark.rho
    }

    fn direction(&self, landmark: &InverseDepth) -> Vector3<f64> {
        self.rotation * Vector3::new(landmark.x, landmark.y, 1.0) + self.translation * landmark.rho
    }
}

/// The residuals of all views.
pub(super) struct Residuals<'a> {
    pub views: &'a [ViewGeometry<'a>],
    /// Huber's threshold, in standard deviations.
    pub huber_sigmas: f64,
}

/// Cost, gradient and Gauss-Newton matrix at one estimate.
struct Linearization {
    cost: f64,
    gradient: Vector3<f64>,
    information: Matrix3<f64>,
}

/// The result of the iteration.
pub(super) struct Solution {
    pub estimate: InverseDepth,
    /// Information of `(x, y, rho)`.
    pub information: Matrix3<f64>,
}

impl Residuals<'_> {
    /// `None` if a view cannot observe the landmark.
    fn linearize(&self, landmark: &InverseDepth) -> Option<Linearization> {
        let mut cost = 0.0;
        let mut gradient = Vector3::zeros();
        let mut information = Matrix3::zeros();
        for view in self.views {
            let (pixel, by_point) = view.camera.project_with_jacobian(&view.direction(landmark)).ok()?;
            let residual = (view.pixel - pixel) * view.inverse_sigma;
            let by_direction = by_point * view.inverse_sigma;
            let first = by_direction * view.rotation.column(0);
            let second = by_direction * view.rotation.column(1);
            let third = by_direction * view.translation;
            let (weight, loss) = huber(residual.norm(), self.huber_sigmas);
            cost += loss;
            gradient +=
                Vector3::new(first.dot(&residual), second.dot(&residual), third.dot(&residual)) * weight;
            information.m11 += weight * first.norm_squared();
            information.m12 += weight * first.dot(&second);
            information.m13 += weight * first.dot(&third);
            information.m22 += weight * second.norm_squared();
            information.m23 += weight * second.dot(&third);
            information.m33 += weight * third.norm_squared();
        }
        information.m21 = information.m12;
        information.m31 = information.m13;
        information.m32 = information.m23;
        Some(Linearization { cost, gradient, information })
    }

    /// Mean norm of the residuals (pixels); infinite if a view cannot observe the landmark.
    pub fn mean_length(&self, landmark: &InverseDepth) -> f64 {
        let length = |view: &ViewGeometry| {
            view.camera
                .project(&view.direction(landmark))
                .map_or(f64::INFINITY, |pixel| (view.pixel - pixel).norm())
        };
        self.views.iter().map(length).sum::<f64>() / self.views.len() as f64
    }
}

/// Minimizes from a linear solution (metres, anchor frame), or from infinity along the anchor ray if that solution is
/// missing or behind a camera. `None` if neither is observable by all views.
pub(super) fn solve(
    residuals: &Residuals,
    anchor: &Vector2<f64>,
    linear: Option<Vector3<f64>>,
    max_iterations: usize,
) -> Option<Solution> {
    let at_infinity = InverseDepth { x: anchor.x, y: anchor.y, rho: 0.0 };
    let from_linear = linear
        .filter(|p| p.z > 0.0 && p.iter().all(|value| value.is_finite()))
        .map(|p| InverseDepth { x: p.x / p.z, y: p.y / p.z, rho: 1.0 / p.z })
        .and_then(|start| residuals.linearize(&start).map(|at_start| (start, at_start)));
    let (mut estimate, mut current) = match from_linear {
        Some(start) => start,
        None => residuals.linearize(&at_infinity).map(|at_start| (at_infinity, at_start))?,
    };
    let mut damping = INITIAL_DAMPING;
    for _ in 0..max_iterations {
        let mut damped = current.information;
        for i in 0..3 {
            damped[(i, i)] *= 1.0 + damping;
        }
        let Some(step) = damped.cholesky().map(|factor| factor.solve(&current.gradient)) else { break };
        let candidate =
            InverseDepth { x: estimate.x + step.x, y: estimate.y + step.y, rho: estimate.rho + step.z };
        match residuals.linearize(&candidate).filter(|next| next.cost <= current.cost) {
            Some(next) => {
                let converged = current.cost - next.cost <= CONVERGED * next.cost;
                (estimate, current) = (candidate, next);
                damping *= 0.1;
                if converged {
                    break;
                }
            }
            None => damping = (damping * 100.0).max(1e-2),
        }
    }
    Some(Solution { estimate, information: current.information })
}
