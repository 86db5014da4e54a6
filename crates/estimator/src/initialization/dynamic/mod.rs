//! Dynamic initialization: the state at the newest image of a window of one or two seconds.
//!
//! 1. [`gyroscope_bias`]: gyroscope bias from the rotations between images.
//! 2. [`closed_form`]: velocity and gravity from bearings and IMU samples, linear, without an initial guess.
//! 3. [`bundle_adjustment`]: least squares over poses, velocities, biases and landmarks, and the covariance of the newest
//!    state from its information matrix.
//! 4. [`init_quality`]: acceptance tests.
//!
//! At constant velocity the scale is unobservable with a single camera. The covariance shows it, and the initialization is
//! rejected until the velocity has changed.
//!
//! L has its origin at the newest body, z up and no yaw, as with the static initialization.

pub mod bundle_adjustment;
pub mod closed_form;
pub mod error;
pub mod gyroscope_bias;
pub mod init_quality;
#[cfg(test)]
mod tests;
pub mod window;

pub use error::DynamicInitError;
pub use init_quality::InitQuality;
pub use window::{Window, WindowImage};

use crate::calibration::CalibratedCamera;
use crate::config::EstimatorConfig;
use crate::initialization::static_init::{InitialState, gravity_aligned};
use crate::propagation::{ImuMatrix, ImuState};
use adjustment::{Bundle, InverseDepthLandmark, LandmarkObservation};
use bundle_adjustment::adjust;
use closed_form::{FirstMotion, Integrated};
use geometry::Pose;
use geometry::triangulation::{TriangulationOptions, View, triangulate};
use nalgebra::Vector3;
use window::{MIN_TRACKS, WindowObservation, WindowTrack};

/// Initial inverse depth of a landmark that cannot be triangulated, 1/m.
const UNKNOWN_INVERSE_DEPTH: f64 = 0.1;
/// Huber threshold of the initial triangulation, sigmas.
const TRIANGULATION_HUBER_SIGMAS: f64 = 2.0;

/// Prior of the biases; its standard deviations are those of the settings.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BiasPrior {
    /// Gyroscope bias, rad/s.
    pub gyroscope: Vector3<f64>,
    /// Accelerometer bias, m/s^2.
    pub accelerometer: Vector3<f64>,
}

/// Estimates the state at the newest image of a window.
///
/// # Returns
/// The state with its covariance, and its quality.
///
/// # Errors
/// [`DynamicInitError`]: too few measurements, no parallax, or an acceptance test that failed.
pub fn initialize_dynamic(
    window: &Window,
    cameras: &[CalibratedCamera],
    config: &EstimatorConfig,
    prior: &BiasPrior,
) -> Result<(InitialState, InitQuality), DynamicInitError> {
    if window.tracks.len() < MIN_TRACKS {
        return Err(DynamicInitError::TooFewTracks { have: window.tracks.len(), need: MIN_TRACKS });
    }
    let sigma = config.initial.sigma_gyroscope_bias_rad_s;
    let gyroscope_bias =
        gyroscope_bias::refine_bias(window, cameras, &prior.gyroscope, sigma, config.sigma_track_px);
    let integrated = closed_form::integrate(window, config, &gyroscope_bias);
    let motion = closed_form::solve(window, cameras, &integrated, config.gravity)?;
    let states = initial_states(window, &integrated, &motion, &gyroscope_bias, &prior.accelerometer);
    let landmarks = initial_landmarks(window, cameras, &states, config.sigma_track_px);
    let guess = Bundle {
        poses: states.iter().map(|state| state.local_from_imu).collect(),
        motions: states.iter().map(ImuState::motion).collect(),
        landmarks,
    };
    let adjusted = adjust(window, cameras, config, prior, guess)?;
    let quality = InitQuality::new(&adjusted)?;
    let stamp_ns = window.stamps_ns[window.stamps_ns.len() - 1];
    Ok((without_yaw(stamp_ns, &adjusted.newest, &adjusted.covariance), quality))
}

/// Initial guess of the states at all images, with z up and the origin at the newest.
fn initial_states(
    window: &Window,
    integrated: &Integrated,
    motion: &FirstMotion,
    gyroscope_bias: &Vector3<f64>,
    accelerometer_bias: &Vector3<f64>,
) -> Vec<ImuState> {
    let local_from_first = gravity_aligned(&-motion.gravity);
    let mut states: Vec<ImuState> = (0..window.stamps_ns.len())
        .map(|k| {
            let t = window.seconds(k);
            let body = &integrated.first_from_body[k];
            let position = body.translation + motion.velocity * t + motion.gravity * (0.5 * t * t);
            let velocity = integrated.velocity[k] + motion.velocity + motion.gravity * t;
            ImuState {
                local_from_imu: Pose::new(local_from_first * body.rotation, local_from_first * position),
                velocity: local_from_first * velocity,
                gyroscope_bias: *gyroscope_bias,
                accelerometer_bias: *accelerometer_bias,
            }
        })
        .collect();
    let origin = states[states.len() - 1].local_from_imu.translation;
    for state in &mut states {
        state.local_from_imu.translation -= origin;
    }
    states
}

/// Initial guess of all landmarks, distant where they cannot be triangulated.
fn initial_landmarks(
    window: &Window,
    cameras: &[CalibratedCamera],
    states: &[ImuState],
    sigma_px: f64,
) -> Vec<InverseDepthLandmark> {
    let options =
        TriangulationOptions { huber_sigmas: TRIANGULATION_HUBER_SIGMAS, ..TriangulationOptions::default() };
    let initial_landmark = |track: &WindowTrack| {
        let track_cameras: Vec<_> =
            track.iter().map(|observation| &cameras[observation.camera].camera).collect();
        let views: Vec<View> = track
            .iter()
            .map(|observation| View {
                parent_from_camera: states[observation.image].local_from_imu
                    * cameras[observation.camera].imu_from_camera,
                pixel: observation.pixel,
                sigma_px,
            })
            .collect();
        let found = triangulate(&track_cameras, &views, &options)
            .ok()
            .map(|found| views[0].parent_from_camera.inverse_transform(&found.position));
        let (ray, inverse_depth) = found.map_or((track[0].ray.xy(), UNKNOWN_INVERSE_DEPTH), |point| {
            (point.xy() / point.z, 1.0 / point.z)
        });
        let observation = |seen: &WindowObservation| LandmarkObservation {
            feature: (seen.image, seen.camera),
            camera: seen.camera,
            is_second: false,
            pixel: seen.pixel,
        };
        let observations = track.iter().map(observation).collect();
        InverseDepthLandmark { anchor: 0, ray, inverse_depth, observations, prior: None }
    };
    window.tracks.iter().map(initial_landmark).collect()
}

/// Rotates L about gravity so that the body has no yaw, as L is defined, and moves its origin to the body.
fn without_yaw(stamp_ns: i64, state: &ImuState, covariance: &ImuMatrix) -> InitialState {
    let up = state.local_from_imu.rotation.inverse() * Vector3::z();
    let rotation = gravity_aligned(&up) * state.local_from_imu.rotation.inverse();
    let at_origin =
        ImuState { local_from_imu: Pose::new(state.local_from_imu.rotation, Vector3::zeros()), ..*state };
    let initial = InitialState { stamp_ns, imu: at_origin, covariance: *covariance };
    initial.transformed(&Pose::new(rotation, Vector3::zeros()))
}
