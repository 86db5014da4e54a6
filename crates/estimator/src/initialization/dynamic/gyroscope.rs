//! The gyroscope's bias from how the images say that the body turned, before anything else is known.
//!
//! Two rays to one landmark and the line between both cameras lie in a plane, whatever the depth:
//! `tᵀ (f_i x R_ij f_j) = 0`. The rotation `R_ij` depends on the bias alone, the direction `t` is found
//! for each pair of images beside it. Gauss-Newton on both, with a prior on the bias.
//!
//! Source: Kneip & Lynen, ICCV 2013 (rotation apart from translation); He, Xu, Ouyang & Li, CVPR 2023 (the
//! bias of the gyroscope from it).

use super::window::Window;
use crate::calibration::CalibratedCamera;
use crate::imu::{ImuSample, Readings};
use geometry::Rotation;
use geometry::rotation::{exp, right_jacobian, skew};
use nalgebra::{Matrix2, Matrix2x3, Matrix3, SymmetricEigen, Vector2, Vector3};

/// Images of a pair are so far apart, nanoseconds: far enough for parallax, near enough to share tracks.
const PAIR_NS: i64 = 350_000_000;
/// Fewest shared tracks of a pair.
const LEAST_SHARED: usize = 12;
/// Gauss-Newton steps; a bias of 0.1 rad/s is found to its noise after four.
const STEPS: usize = 6;
/// Residual in standard deviations from which on its weight falls (Huber).
const HUBER: f64 = 1.5;

/// How a body turned between two images, and how that depends on the gyroscope's bias.
pub struct Turn {
    /// `first_from_second`.
    pub rotation: Rotation,
    /// `rotation(b + d) = rotation(b) Exp(-by_bias d)`, seconds.
    pub by_bias: Matrix3<f64>,
}

/// Integrates the gyroscope.
pub fn turn(readings: &[&[ImuSample]], bias: &Vector3<f64>) -> Turn {
    let mut turned = Turn { rotation: Rotation::identity(), by_bias: Matrix3::zeros() };
    for pair in readings.iter().flat_map(|part| part.windows(2)) {
        let dt = (pair[1].stamp_ns - pair[0].stamp_ns) as f64 * 1e-9;
        let angle = (0.5 * (pair[0].gyroscope + pair[1].gyroscope) - bias) * dt;
        let step = exp(&angle);
        turned.by_bias = step.inverse().to_rotation_matrix() * turned.by_bias + right_jacobian(&angle) * dt;
        turned.rotation *= step;
    }
    turned
}

/// Rays of one pair of images in the body's axes at each of them.
struct Pair<'a> {
    readings: Vec<&'a [ImuSample]>,
    rays: Vec<(Vector3<f64>, Vector3<f64>)>,
}

/// The gyroscope's bias that agrees best with the tracks of the first camera, rad/s.
///
/// # Arguments
/// * `prior`: what is believed of the bias, with its standard deviation `prior_sigma` (rad/s).
/// * `sigma_px`: noise of a pixel, px.
pub fn refine_bias(
    window: &Window,
    rig: &[CalibratedCamera],
    prior: &Vector3<f64>,
    prior_sigma: f64,
    sigma_px: f64,
) -> Vector3<f64> {
    let eye = &rig[0];
    let sigma = sigma_px / eye.camera.focal[0].min(eye.camera.focal[1]);
    let pairs = pairs(window, &eye.imu_from_camera.rotation);
    let mut bias = *prior;
    for _ in 0..STEPS {
        let mut information = Matrix3::identity() / prior_sigma.powi(2);
        let mut vector = (prior - bias) / prior_sigma.powi(2);
        for pair in &pairs {
            add_pair(pair, &bias, sigma, &mut information, &mut vector);
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

fn pairs<'a>(window: &'a Window, imu_from_camera: &Rotation) -> Vec<Pair<'a>> {
    let mut pairs = Vec::new();
    for first in 0..window.stamps_ns.len() {
        let second = window.stamps_ns.partition_point(|&stamp| stamp < window.stamps_ns[first] + PAIR_NS);
        if second >= window.stamps_ns.len() {
            break;
        }
        let ray = |track: &super::window::StartTrack, image: usize| {
            let seen = track.iter().find(|sighting| sighting.image == image && sighting.camera == 0)?;
            Some(imu_from_camera * seen.ray.normalize())
        };
        let rays: Vec<_> = window
            .tracks
            .iter()
            .filter_map(|track| Some((ray(track, first)?, ray(track, second)?)))
            .collect();
        if rays.len() >= LEAST_SHARED {
            let readings = window.readings[first..second].iter().map(Readings::as_slice).collect();
            pairs.push(Pair { readings, rays });
        }
    }
    pairs
}

/// Adds what one pair says of the bias, its direction of translation eliminated.
fn add_pair(
    pair: &Pair<'_>,
    bias: &Vector3<f64>,
    sigma: f64,
    information: &mut Matrix3<f64>,
    vector: &mut Vector3<f64>,
) {
    let turned = turn(&pair.readings, bias);
    let matrix = turned.rotation.to_rotation_matrix().into_inner();
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
        let by_bias =
            (direction.transpose() * skew(first) * matrix * skew(second) * turned.by_bias).transpose();
        let by_tangent = Vector2::new(normal.dot(&tangent[0]), normal.dot(&tangent[1]));
        by_direction += by_tangent * by_tangent.transpose() * weight;
        cross += by_tangent * by_bias.transpose() * weight;
        direction_vector -= by_tangent * (residual * weight);
        own += by_bias * by_bias.transpose() * weight;
        own_vector -= by_bias * (residual * weight);
    }
    // A direction that the pair does not know (no parallax) is held by a weak prior of one radian.
    let Some(factor) = (by_direction + Matrix2::identity()).cholesky() else { return };
    *information += own - cross.transpose() * factor.solve(&cross);
    *vector += own_vector - cross.transpose() * factor.solve(&direction_vector);
}

/// The direction that is as square as can be to all normals, outliers weighted down.
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
    let length = residual.abs() / sigma;
    if length <= HUBER { 1.0 } else { HUBER / length }
}

/// Two unit vectors square to `direction` and to each other.
fn tangent(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let mut axis = Vector3::zeros();
    axis[direction.iamin()] = 1.0;
    let first = direction.cross(&axis).normalize();
    [first, direction.cross(&first)]
}
