//! The gyroscope bias from the rotations between images, before anything else is known.
//!
//! Epipolar constraint: two bearings of a landmark and the baseline lie in a plane, `tᵀ (f_i x R_ij f_j) = 0`. The rotation
//! `R_ij` depends on the bias only; the direction `t` of the baseline is estimated for each pair of images. Gauss-Newton on
//! both, with a prior on the bias.
//!
//! Source: Kneip & Lynen, ICCV 2013 (rotation independent of translation); He, Xu, Ouyang & Li, CVPR 2023 (gyroscope bias
//! from it).

use super::window::{Window, WindowTrack};
use crate::calibration::CalibratedCamera;
use crate::imu::Readings;
use geometry::Rotation;
use geometry::robust::huber;
use geometry::rotation::{exp, right_jacobian, skew};
use nalgebra::{Matrix2, Matrix2x3, Matrix3, SymmetricEigen, Vector2, Vector3};
use types::ImuSample;

/// Time between the images of a pair, nanoseconds: enough for parallax, little enough to share tracks.
const PAIR_NS: i64 = 350_000_000;
/// Minimum number of shared tracks of a pair.
const MIN_SHARED_TRACKS: usize = 12;
/// Gauss-Newton steps; a bias of 0.1 rad/s converges in four.
const STEPS: usize = 6;
/// Residual from which on Huber's loss is linear, sigmas.
const HUBER_SIGMAS: f64 = 1.5;

/// Rotation of the body between two images, and its dependence on the gyroscope bias.
pub struct RelativeRotation {
    /// `first_from_second`.
    pub rotation: Rotation,
    /// `rotation(b + d) = rotation(b) Exp(-wrt_bias d)`, seconds.
    pub wrt_bias: Matrix3<f64>,
}

/// Integrates the gyroscope.
pub fn integrate_gyroscope(readings: &[&[ImuSample]], bias: &Vector3<f64>) -> RelativeRotation {
    let mut relative = RelativeRotation { rotation: Rotation::identity(), wrt_bias: Matrix3::zeros() };
    for pair in readings.iter().flat_map(|part| part.windows(2)) {
        let dt = (pair[1].stamp_ns - pair[0].stamp_ns) as f64 * 1e-9;
        let angle = (0.5 * (pair[0].gyroscope + pair[1].gyroscope) - bias) * dt;
        let step = exp(&angle);
        relative.wrt_bias =
            step.inverse().to_rotation_matrix() * relative.wrt_bias + right_jacobian(&angle) * dt;
        relative.rotation *= step;
    }
    relative
}

/// Bearings of one pair of images of a camera, each in the frame of its body.
struct Pair<'a> {
    readings: Vec<&'a [ImuSample]>,
    rays: Vec<(Vector3<f64>, Vector3<f64>)>,
    /// Noise of a bearing, rad.
    sigma: f64,
}

/// The gyroscope bias that minimizes the epipolar residuals of all cameras, of a stereo pair of the first one, rad/s.
///
/// # Arguments
/// * `prior`, `prior_sigma`: prior of the bias and its standard deviation, rad/s.
/// * `sigma_px`: noise of a pixel, px.
pub fn refine_bias(
    window: &Window,
    cameras: &[CalibratedCamera],
    prior: &Vector3<f64>,
    prior_sigma: f64,
    sigma_px: f64,
) -> Vector3<f64> {
    let of_camera = |(index, calibrated)| pairs(window, index, calibrated, sigma_px);
    let pairs: Vec<Pair<'_>> = cameras.iter().enumerate().flat_map(of_camera).collect();
    let mut bias = *prior;
    for _ in 0..STEPS {
        let mut information = Matrix3::identity() / prior_sigma.powi(2);
        let mut vector = (prior - bias) / prior_sigma.powi(2);
        for pair in &pairs {
            add_pair(pair, &bias, &mut information, &mut vector);
        }
        let Some(factor) = information.cholesky() else { break };
        let step = factor.solve(&vector);
        bias += step;
        if step.norm() < 1e-6 {
            break;
        }
    }
    bias
}

/// The pairs of images of a camera. A feature that several cameras see is that of the first of them.
fn pairs<'a>(
    window: &'a Window,
    camera: usize,
    calibrated: &CalibratedCamera,
    sigma_px: f64,
) -> Vec<Pair<'a>> {
    let imu_from_camera = calibrated.imu_from_camera.rotation;
    let sigma = sigma_px / calibrated.camera.focal[0].min(calibrated.camera.focal[1]);
    let is_of_camera =
        |track: &&WindowTrack| track.iter().map(|observation| observation.camera).min() == Some(camera);
    let mut pairs = Vec::new();
    for first in 0..window.stamps_ns.len() {
        let second = window.stamps_ns.partition_point(|&stamp| stamp < window.stamps_ns[first] + PAIR_NS);
        if second >= window.stamps_ns.len() {
            break;
        }
        let ray = |track: &WindowTrack, image: usize| {
            let mut seen = track.iter().filter(|observation| observation.camera == camera);
            let seen = seen.find(|observation| observation.image == image)?;
            Some(imu_from_camera * seen.ray.normalize())
        };
        let rays: Vec<_> = window
            .tracks
            .iter()
            .filter(is_of_camera)
            .filter_map(|track| Some((ray(track, first)?, ray(track, second)?)))
            .collect();
        if rays.len() >= MIN_SHARED_TRACKS {
            let readings = window.readings[first..second].iter().map(Readings::as_slice).collect();
            pairs.push(Pair { readings, rays, sigma });
        }
    }
    pairs
}

/// Adds the normal equations of one pair, direction of the baseline eliminated.
fn add_pair(pair: &Pair<'_>, bias: &Vector3<f64>, information: &mut Matrix3<f64>, vector: &mut Vector3<f64>) {
    let sigma = pair.sigma;
    let relative = integrate_gyroscope(&pair.readings, bias);
    let matrix = relative.rotation.to_rotation_matrix().into_inner();
    let normals: Vec<Vector3<f64>> =
        pair.rays.iter().map(|(first, second)| first.cross(&(matrix * second))).collect();
    let Some(direction) = direction(&normals, sigma) else { return };
    let tangent = tangent(&direction);
    let (mut by_direction, mut cross) = (Matrix2::zeros(), Matrix2x3::zeros());
    let (mut direction_vector, mut own, mut own_vector) =
        (Vector2::zeros(), Matrix3::zeros(), Vector3::zeros());
    for ((first, second), normal) in pair.rays.iter().zip(&normals) {
        let residual = direction.dot(normal);
        let weight = huber_weight(residual, sigma) / sigma.powi(2);
        // R(b + d) f = R f + R [f]x J d
        let wrt_bias =
            (direction.transpose() * skew(first) * matrix * skew(second) * relative.wrt_bias).transpose();
        let wrt_tangent = Vector2::new(normal.dot(&tangent[0]), normal.dot(&tangent[1]));
        by_direction += wrt_tangent * wrt_tangent.transpose() * weight;
        cross += wrt_tangent * wrt_bias.transpose() * weight;
        direction_vector -= wrt_tangent * (residual * weight);
        own += wrt_bias * wrt_bias.transpose() * weight;
        own_vector -= wrt_bias * (residual * weight);
    }
    // Weak prior of one radian on the direction, for pairs without parallax.
    let Some(factor) = (by_direction + Matrix2::identity()).cholesky() else { return };
    *information += own - cross.transpose() * factor.solve(&cross);
    *vector += own_vector - cross.transpose() * factor.solve(&direction_vector);
}

/// The direction most orthogonal to all normals, with Huber weights.
fn direction(normals: &[Vector3<f64>], sigma: f64) -> Option<Vector3<f64>> {
    let mut weights = vec![1.0; normals.len()];
    let mut direction = None;
    for _ in 0..3 {
        let scatter: Matrix3<f64> =
            normals.iter().zip(&weights).map(|(normal, weight)| normal * normal.transpose() * *weight).sum();
        let eigen = SymmetricEigen::try_new(scatter, 1e-14, 100)?;
        let smallest = eigen.eigenvalues.imin();
        let found: Vector3<f64> = eigen.eigenvectors.column(smallest).into();
        for (weight, normal) in weights.iter_mut().zip(normals) {
            *weight = huber_weight(found.dot(normal), sigma);
        }
        direction = Some(found);
    }
    direction
}

fn huber_weight(residual: f64, sigma: f64) -> f64 {
    huber(residual.abs() / sigma, HUBER_SIGMAS).0
}

/// Two unit vectors orthogonal to `direction` and to each other.
fn tangent(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let mut axis = Vector3::zeros();
    axis[direction.iamin()] = 1.0;
    let first = direction.cross(&axis).normalize();
    [first, direction.cross(&first)]
}
