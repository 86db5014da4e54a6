//! Closed-form velocity and gravity at the first image from bearings and IMU samples, without an initial guess.
//!
//! With known rotations the problem is linear. In the frame of the first body, image `i` was taken at
//! `c_i = s_i + v t_i + g t_i^2 / 2` (plus the lever arm of the camera), with `s_i` the integrated specific force, and a
//! landmark `p` with the bearing `f` satisfies
//! ```text
//! (I - f fᵀ) (p - c_i) = 0
//! ```
//! Eliminating the landmarks one by one leaves six unknowns `(v, g)`; eliminating the velocity leaves a quadratic form in `g`
//! on the sphere `|g| = gravity`.
//!
//! Source: Dong-Si & Mourikis, IROS 2012; Martinelli, IJCV 2014; for the sphere More & Sorensen, 1983.

use super::error::DynamicInitError;
use super::window::{Window, WindowObservation, WindowTrack};
use crate::calibration::CalibratedCamera;
use crate::config::EstimatorConfig;
use crate::propagation::{ImuState, MotionEstimate, propagate};
use geometry::{Pose, median};
use nalgebra::{Matrix3, Matrix3x6, Matrix6, SymmetricEigen, Vector3, Vector6};
use types::ImuSample;

/// Number of solutions; each weights the bearings by the depths of the one before.
const ROUNDS: usize = 3;
/// Residual of a track, as a multiple of the median, beyond which it is left out of the next round.
const OUTLIER: f64 = 4.0;
/// Lower bound of the depths in the weights, as a fraction of the median depth.
const NEAREST: f64 = 0.1;

/// The integrated IMU samples in the frame of the first body, without gravity and initial velocity.
pub struct Integrated {
    /// Body pose at each image; the position is the double integral of the specific force.
    pub first_from_body: Vec<Pose>,
    /// Derivative of the position, m/s.
    pub velocity: Vec<Vector3<f64>>,
}

/// Integrates the IMU samples of a window.
pub fn integrate(window: &Window, config: &EstimatorConfig, gyroscope_bias: &Vector3<f64>) -> Integrated {
    let mut state = ImuState::at_rest(*gyroscope_bias, Vector3::zeros());
    let mut integrated =
        Integrated { first_from_body: vec![state.local_from_imu], velocity: vec![state.velocity] };
    for readings in &window.readings {
        state = propagate_without_gravity(&state, readings, config);
        integrated.first_from_body.push(state.local_from_imu);
        integrated.velocity.push(state.velocity);
    }
    integrated
}

fn propagate_without_gravity(state: &ImuState, readings: &[ImuSample], config: &EstimatorConfig) -> ImuState {
    let motion = MotionEstimate::of(state);
    propagate(state, &motion, readings, &config.imu_noise, 0.0).state
}

/// Velocity and gravity in the frame of the first body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstMotion {
    /// m/s.
    pub velocity: Vector3<f64>,
    /// m/s^2, pointing down.
    pub gravity: Vector3<f64>,
}

impl FirstMotion {
    /// Displacement after some seconds, to be added to the integrated position.
    fn displacement(&self, seconds: f64) -> Vector3<f64> {
        self.velocity * seconds + self.gravity * (0.5 * seconds * seconds)
    }
}

/// Weights of a track and of its bearings.
struct TrackWeights {
    outlying: bool,
    bearings: Vec<f64>,
}

/// The linear system of one track.
struct TrackSystem {
    landmark: Matrix3<f64>,
    cross: Matrix3x6<f64>,
    landmark_vector: Vector3<f64>,
    motion: Matrix6<f64>,
    motion_vector: Vector6<f64>,
}

/// Velocity and gravity that minimize the residuals of all tracks.
///
/// # Errors
/// [`DynamicInitError::NoParallax`] where the system is degenerate.
pub fn solve(
    window: &Window,
    cameras: &[CalibratedCamera],
    integrated: &Integrated,
    gravity: f64,
) -> Result<FirstMotion, DynamicInitError> {
    let mut weights: Vec<TrackWeights> = window
        .tracks
        .iter()
        .map(|track| TrackWeights { outlying: false, bearings: vec![1.0; track.len()] })
        .collect();
    let mut found = Err(DynamicInitError::NoParallax);
    for _ in 0..ROUNDS {
        let (mut matrix, mut vector) = (Matrix6::zeros(), Vector6::zeros());
        for (track, weights) in window.tracks.iter().zip(&weights) {
            if weights.outlying {
                continue;
            }
            let system = track_system(window, track, &weights.bearings, cameras, integrated);
            let Some(factor) = system.landmark.cholesky() else { continue };
            matrix += system.motion - system.cross.transpose() * factor.solve(&system.cross);
            vector += system.motion_vector - system.cross.transpose() * factor.solve(&system.landmark_vector);
        }
        let motion = solve_on_sphere(&matrix, &vector, gravity).ok_or(DynamicInitError::NoParallax)?;
        found = Ok(motion);
        reweight(window, cameras, integrated, &motion, &mut weights);
    }
    found
}

/// Camera centre and bearing of an observation in the frame of the first body, without velocity and gravity.
fn bearing(
    observation: &WindowObservation,
    cameras: &[CalibratedCamera],
    integrated: &Integrated,
) -> (Vector3<f64>, Vector3<f64>) {
    let first_from_camera =
        integrated.first_from_body[observation.image] * cameras[observation.camera].imu_from_camera;
    (first_from_camera.translation, first_from_camera.rotation * observation.ray.normalize())
}

fn track_system(
    window: &Window,
    track: &WindowTrack,
    weights: &[f64],
    cameras: &[CalibratedCamera],
    integrated: &Integrated,
) -> TrackSystem {
    let mut system = TrackSystem {
        landmark: Matrix3::zeros(),
        cross: Matrix3x6::zeros(),
        landmark_vector: Vector3::zeros(),
        motion: Matrix6::zeros(),
        motion_vector: Vector6::zeros(),
    };
    for (observation, &weight) in track.iter().zip(weights) {
        let (centre, ray) = bearing(observation, cameras, integrated);
        let across = (Matrix3::identity() - ray * ray.transpose()) * weight;
        let t = window.seconds(observation.image);
        let mut wrt_motion = Matrix3x6::zeros();
        wrt_motion.fixed_view_mut::<3, 3>(0, 0).copy_from(&(Matrix3::identity() * -t));
        wrt_motion.fixed_view_mut::<3, 3>(0, 3).copy_from(&(Matrix3::identity() * (-0.5 * t * t)));
        system.landmark += across;
        system.cross += across * wrt_motion;
        system.landmark_vector += across * centre;
        system.motion += wrt_motion.transpose() * across * wrt_motion;
        system.motion_vector += wrt_motion.transpose() * across * centre;
    }
    system
}

/// New weights from a solution: angular residuals, without outlying tracks.
fn reweight(
    window: &Window,
    cameras: &[CalibratedCamera],
    integrated: &Integrated,
    motion: &FirstMotion,
    weights: &mut [TrackWeights],
) {
    let mut residuals = Vec::with_capacity(window.tracks.len());
    let mut depths = Vec::with_capacity(window.tracks.len());
    for (track, weights) in window.tracks.iter().zip(&*weights) {
        let system = track_system(window, track, &weights.bearings, cameras, integrated);
        let unknown = Vector6::from_fn(|k, _| if k < 3 { motion.velocity[k] } else { motion.gravity[k - 3] });
        let landmark = system
            .landmark
            .cholesky()
            .map(|factor| factor.solve(&(system.landmark_vector - system.cross * unknown)));
        let Some(landmark) = landmark else {
            residuals.push(f64::INFINITY);
            depths.push(vec![1.0; track.len()]);
            continue;
        };
        let mut squared = 0.0;
        let mut depth = Vec::with_capacity(track.len());
        for observation in track {
            let (centre, ray) = bearing(observation, cameras, integrated);
            let offset = landmark - centre - motion.displacement(window.seconds(observation.image));
            squared += (offset - ray * ray.dot(&offset)).norm_squared() / offset.norm_squared().max(1e-12);
            depth.push(offset.norm());
        }
        residuals.push((squared / track.len() as f64).sqrt());
        depths.push(depth);
    }
    let Some(middle) = median(&mut residuals.clone()) else { return };
    let Some(depth) = median(&mut depths.iter().map(|depths| depths[0]).collect::<Vec<_>>()) else { return };
    for ((weights, residual), depths) in weights.iter_mut().zip(&residuals).zip(&depths) {
        weights.outlying = *residual > OUTLIER * middle;
        for (weight, own) in weights.bearings.iter_mut().zip(depths) {
            *weight = (depth / own.max(NEAREST * depth)).powi(2);
        }
    }
}

/// Minimizes `xᵀ A x - 2 bᵀ x` over `x = (v, g)` with `|g| = gravity`.
fn solve_on_sphere(matrix: &Matrix6<f64>, vector: &Vector6<f64>, gravity: f64) -> Option<FirstMotion> {
    let velocity_block: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 0).into();
    let cross: Matrix3<f64> = matrix.fixed_view::<3, 3>(0, 3).into();
    let velocity_vector: Vector3<f64> = vector.fixed_rows::<3>(0).into();
    let factor = velocity_block.cholesky()?;
    let reduced: Matrix3<f64> = matrix.fixed_view::<3, 3>(3, 3) - cross.transpose() * factor.solve(&cross);
    let right = vector.fixed_rows::<3>(3) - cross.transpose() * factor.solve(&velocity_vector);
    let down = minimize_on_sphere(&reduced, &right, gravity)?;
    let velocity = factor.solve(&(velocity_vector - cross * down));
    let found = FirstMotion { velocity, gravity: down };
    (found.velocity.iter().all(|value| value.is_finite())).then_some(found)
}

/// The `x` of length `radius` that minimizes `xᵀ S x / 2 - sᵀ x`.
///
/// Its Lagrange multiplier is the root above `-smallest eigenvalue` of `|(S + λ I)⁻¹ s| = radius`, where the left-hand side
/// decreases monotonically, found by bisection.
pub fn minimize_on_sphere(matrix: &Matrix3<f64>, vector: &Vector3<f64>, radius: f64) -> Option<Vector3<f64>> {
    let eigen = SymmetricEigen::try_new((matrix + matrix.transpose()) * 0.5, 1e-14, 200)?;
    let along = eigen.eigenvectors.transpose() * vector;
    let smallest = eigen.eigenvalues.imin();
    let floor = eigen.eigenvalues[smallest];
    let solution = |shift: f64| Vector3::from_fn(|k, _| along[k] / (eigen.eigenvalues[k] - floor + shift));
    let (mut low, mut high) = (along[smallest].abs() / radius, vector.norm() / radius);
    if high.is_nan() || high <= 0.0 || low <= 0.0 {
        return None;
    }
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if solution(middle).norm() > radius {
            low = middle;
        } else {
            high = middle;
        }
    }
    let found = eigen.eigenvectors * solution(0.5 * (low + high));
    found.iter().all(|value| value.is_finite()).then(|| found * (radius / found.norm()))
}
