//! Refinement of a pose on pixel residuals, and its covariance.

use super::{Correspondence, PnpError};
use crate::camera::Camera;
use crate::pose::Pose;
use crate::robust::huber;
use crate::uncertain_pose::{PoseWithCovariance, symmetric};
use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

/// Initial damping relative to the diagonal of the normal matrix.
const INITIAL_DAMPING: f64 = 1e-6;
/// Largest step of the last iteration, in standard deviations of the pose. Its own error is smaller by orders.
const LAST_STEP_SIGMAS: f64 = 1e-3;
/// Residual (standard deviations) of a point that cannot be projected; it keeps steps from moving points behind the camera.
const UNSEEN_SIGMAS: f64 = 1e3;
/// Minimum ratio of the eigenvalues of the normal matrix, scaled to a unit diagonal, for an observable pose.
const MIN_CONDITION: f64 = 1e-12;

/// Refines a pose by Levenberg-Marquardt on the pixel residuals.
///
/// # Arguments
/// * `initial`: `world_from_camera` to start from.
/// * `sigma_px`: standard deviation of a pixel in u and in v.
/// * `iterations`: maximum number; 3 to 6 are needed from a RANSAC pose.
/// * `huber_sigmas`: threshold of Huber's loss in standard deviations; `None` for least squares.
///
/// # Returns
/// `world_from_camera` with the covariance `(J^T W J)^-1` of `[dtheta, dp]` in the world frame, for exact points.
/// Points behind the camera do not contribute.
///
/// # Errors
/// [`PnpError::TooFew`] below three points in front of the camera, [`PnpError::Degenerate`] if the pose is not
/// observable, [`PnpError::InvalidInput`] on NaN or infinity or a sigma that is not positive.
pub fn refine(
    camera: &Camera,
    correspondences: &[Correspondence],
    initial: &Pose,
    sigma_px: f64,
    iterations: usize,
    huber_sigmas: Option<f64>,
) -> Result<PoseWithCovariance, PnpError> {
    let valid_sigma = sigma_px.is_finite() && sigma_px > 0.0;
    if !valid_sigma || !initial.is_finite() || !correspondences.iter().all(Correspondence::is_finite) {
        return Err(PnpError::InvalidInput);
    }
    let threshold = huber_sigmas.unwrap_or(f64::INFINITY);
    let problem = Problem { camera, correspondences, inverse_sigma: 1.0 / sigma_px, threshold };
    let mut pose = *initial;
    let mut current = problem.linearize(&pose);
    let mut damping = INITIAL_DAMPING;
    for _ in 0..iterations {
        let mut damped = current.information;
        for i in 0..6 {
            damped[(i, i)] *= 1.0 + damping;
        }
        let Some(step) = damped.cholesky().map(|factor| factor.solve(&current.gradient)) else { break };
        let candidate = pose.retract(&step);
        if damping <= INITIAL_DAMPING && step.dot(&current.gradient) <= LAST_STEP_SIGMAS.powi(2) {
            pose = candidate;
            break;
        }
        let next = problem.linearize(&candidate);
        if next.cost <= current.cost {
            (pose, current) = (candidate, next);
            damping *= 0.1;
        } else {
            damping = (damping * 100.0).max(1e-3);
        }
    }
    if current.visible < 3 {
        return Err(PnpError::TooFew { given: current.visible, needed: 3 });
    }
    let covariance = invert_information(&current.information).ok_or(PnpError::Degenerate)?;
    Ok(PoseWithCovariance::new(pose, covariance))
}

struct Problem<'a> {
    camera: &'a Camera,
    correspondences: &'a [Correspondence],
    inverse_sigma: f64,
    threshold: f64,
}

/// Cost, gradient and Gauss-Newton matrix at one pose.
struct Linearization {
    cost: f64,
    gradient: Vector6<f64>,
    information: Matrix6<f64>,
    /// Number of points that can be projected.
    visible: usize,
}

impl Linearization {
    fn zero() -> Self {
        Self { cost: 0.0, gradient: Vector6::zeros(), information: Matrix6::zeros(), visible: 0 }
    }
}

impl Problem<'_> {
    /// With `f` from the camera to the point in the world frame, and `u`, `v` the derivatives of the pixel with respect to it, the
    /// rows of the Jacobian are `[u x f, -u]` and `[v x f, -v]`.
    fn linearize(&self, world_from_camera: &Pose) -> Linearization {
        let unseen_length = UNSEEN_SIGMAS.max(f64::from(self.camera.width) * self.inverse_sigma);
        let mut sum = Linearization::zero();
        let (mut by_theta, mut by_p) = (Vector3::zeros(), Vector3::zeros());
        let (mut theta_theta, mut theta_p, mut p_p) = (Matrix3::zeros(), Matrix3::zeros(), Matrix3::zeros());
        let camera_from_world = world_from_camera.rotation.to_rotation_matrix().inverse();
        for correspondence in self.correspondences {
            let f = correspondence.point - world_from_camera.translation;
            let in_camera = camera_from_world * f;
            let Ok((pixel, by_point)) = self.camera.project_with_jacobian(&in_camera) else {
                sum.cost += huber(unseen_length, self.threshold).1;
                continue;
            };
            let residual = (correspondence.pixel - pixel) * self.inverse_sigma;
            let by_world = by_point * camera_from_world.matrix() * self.inverse_sigma;
            let (weight, loss) = huber(residual.norm(), self.threshold);
            sum.cost += loss;
            sum.visible += 1;

            let [u, v] = [by_world.row(0).transpose(), by_world.row(1).transpose()];
            let (turned_u, turned_v) = (u.cross(&f), v.cross(&f));
            let of_both = residual * weight;
            by_theta += turned_u * of_both.x + turned_v * of_both.y;
            by_p -= u * of_both.x + v * of_both.y;
            theta_theta += outer(&(turned_u * weight), &turned_u) + outer(&(turned_v * weight), &turned_v);
            theta_p -= outer(&(turned_u * weight), &u) + outer(&(turned_v * weight), &v);
            p_p += outer(&(u * weight), &u) + outer(&(v * weight), &v);
        }
        sum.gradient.fixed_rows_mut::<3>(0).copy_from(&by_theta);
        sum.gradient.fixed_rows_mut::<3>(3).copy_from(&by_p);
        sum.information.fixed_view_mut::<3, 3>(0, 0).copy_from(&theta_theta);
        sum.information.fixed_view_mut::<3, 3>(0, 3).copy_from(&theta_p);
        sum.information.fixed_view_mut::<3, 3>(3, 0).copy_from(&theta_p.transpose());
        sum.information.fixed_view_mut::<3, 3>(3, 3).copy_from(&p_p);
        sum
    }
}

/// `a b^T`: written out, which the general product is not.
#[inline]
fn outer(a: &Vector3<f64>, b: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_columns(&[a * b.x, a * b.y, a * b.z])
}

/// The covariance; `None` if the information, scaled to a unit diagonal, is ill-conditioned.
fn invert_information(information: &Matrix6<f64>) -> Option<Matrix6<f64>> {
    let scale = information.diagonal().map(|value| 1.0 / value.sqrt());
    if !scale.iter().all(|value| value.is_finite()) {
        return None;
    }
    let scale = Matrix6::from_diagonal(&scale);
    let eigen = symmetric(&(scale * information * scale)).symmetric_eigen();
    if eigen.eigenvalues.min() < MIN_CONDITION * eigen.eigenvalues.max() {
        return None;
    }
    let inverse = eigen.eigenvectors
        * Matrix6::from_diagonal(&eigen.eigenvalues.map(|value| 1.0 / value))
        * eigen.eigenvectors.transpose();
    Some(symmetric(&(scale * inverse * scale)))
}
