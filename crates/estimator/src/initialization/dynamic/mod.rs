//! A start in motion: the state at the newest of a second or two of images.
//!
//! 1. [`gyroscope`]: the gyroscope's bias from how the tracks turned.
//! 2. [`closed_form`]: velocity and gravity from rays and readings, linear, without any first guess.
//! 3. [`adjustment`]: least squares over poses, velocities, biases and landmarks, and from its information
//!    matrix the covariance of the newest state.
//! 4. [`init_quality`]: whether all of that can be believed.
//!
//! One camera that moves at constant velocity does not see how fast: nothing then tells a near small world from
//! a far large one. The covariance shows that, and the start is refused until the velocity has changed.
//!
//! L gets its origin at the newest body, z up and no yaw, as with the other starts.

pub mod adjustment;
pub mod closed_form;
pub mod gyroscope;
pub mod inertial;
pub mod init_quality;
pub mod landmark;
pub mod landmark_block;
pub mod normal_equations;
#[cfg(test)]
mod tests;
pub mod window;

pub use init_quality::InitQuality;
pub use window::{StartImage, Window};

use crate::calibration::CalibratedCamera;
use crate::config::EstimatorConfig;
use crate::initialization::static_initialization::{InitialState, upright};
use crate::propagation::{ImuMatrix, ImuState};
use adjustment::{Entry, Estimate, Settings, adjust};
use closed_form::{FirstMotion, Integrated};
use geometry::Pose;
use geometry::triangulation::{TriangulationOptions, View, triangulate};
use inertial::Interval;
use landmark::Landmark;
use nalgebra::Vector3;

/// Fewest tracks that a start is made from.
pub const LEAST_TRACKS: usize = 15;
/// Inverse depth of a landmark whose depth the first guess does not tell, 1/m.
const UNKNOWN_INVERSE_DEPTH: f64 = 0.1;

/// Why there is no start yet. The next images may bring one.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NotYet {
    /// The window is too short.
    #[error("{have} images so far, {need} are needed")]
    TooFewImages {
        /// Images at hand.
        have: usize,
        /// Images needed.
        need: usize,
    },
    /// The IMU does not cover the window.
    #[error("readings of the IMU are missing between the images")]
    NoImu,
    /// The images share too few features.
    #[error("{have} features could be followed, {need} are needed: more light, or more to see")]
    TooFewTracks {
        /// Tracks at hand.
        have: usize,
        /// Tracks needed.
        need: usize,
    },
    /// Rays without parallax.
    #[error("the features do not move against each other: move sideways or along the view, do not only turn")]
    NoParallax,
    /// No motion explains tracks and readings together.
    #[error(
        "tracks and IMU contradict each other (chi-square {chi_square:.1} times what it should be, {outliers:.0} % \
         outliers): check extrinsics, time stamps and noise"
    )]
    Contradiction {
        /// Sum of squares over its degrees of freedom.
        chi_square: f64,
        /// Outlying sightings, percent.
        outliers: f64,
    },
    /// The length of the way is not known well enough.
    #[error(
        "not enough motion yet to tell how fast it is (known to {percent:.1} %, {need:.1} % needed): change the \
         speed or the direction"
    )]
    ScaleUnknown {
        /// Standard deviation of the way's length, percent.
        percent: f64,
        /// The largest that is accepted, percent.
        need: f64,
    },
}

/// What is believed of the biases beforehand; its standard deviations are those of the configuration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BiasPrior {
    /// rad/s.
    pub gyroscope: Vector3<f64>,
    /// m/s^2.
    pub accelerometer: Vector3<f64>,
}

/// Finds the state at the newest image of a window.
///
/// # Returns
/// The state with its covariance, and why it was believed.
///
/// # Errors
/// [`NotYet`] says what is missing.
pub fn dynamic_start(
    window: &Window,
    rig: &[CalibratedCamera],
    config: &EstimatorConfig,
    prior: &BiasPrior,
) -> Result<(InitialState, InitQuality), NotYet> {
    if window.tracks.len() < LEAST_TRACKS {
        return Err(NotYet::TooFewTracks { have: window.tracks.len(), need: LEAST_TRACKS });
    }
    let sigma = config.initial.gyroscope_bias;
    let gyroscope_bias = gyroscope::refine_bias(window, rig, &prior.gyroscope, sigma, config.sigma_track_px);
    let integrated = closed_form::integrate(window, config, &gyroscope_bias);
    let motion = closed_form::solve(window, rig, &integrated, config.gravity)?;
    let states = first_states(window, &integrated, &motion, &gyroscope_bias, &prior.accelerometer);
    let landmarks = first_landmarks(window, rig, &states, config.sigma_track_px);
    let intervals: Option<Vec<Interval>> = window
        .readings
        .iter()
        .map(|readings| Interval::new(readings, &gyroscope_bias, &prior.accelerometer, config))
        .collect();
    let settings = Settings {
        window,
        intervals: &intervals.ok_or(NotYet::NoImu)?,
        rig,
        config,
        gyroscope_bias: prior.gyroscope,
        accelerometer_bias: prior.accelerometer,
    };
    let adjusted = adjust(&settings, Estimate { states, landmarks })?;
    let init_quality = InitQuality::new(&adjusted)?;
    let stamp_ns = window.stamps_ns[window.stamps_ns.len() - 1];
    Ok((without_yaw(stamp_ns, adjusted.estimate.newest(), &adjusted.covariance), init_quality))
}

/// The states at all images, in axes with z up and the origin at the newest.
fn first_states(
    window: &Window,
    integrated: &Integrated,
    motion: &FirstMotion,
    gyroscope_bias: &Vector3<f64>,
    accelerometer_bias: &Vector3<f64>,
) -> Vec<ImuState> {
    let local_from_first = upright(&-motion.gravity);
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

/// All tracks as landmarks; where the first guess tells no depth, a far one, which the adjustment moves.
fn first_landmarks(
    window: &Window,
    rig: &[CalibratedCamera],
    states: &[ImuState],
    sigma_px: f64,
) -> Vec<Entry> {
    let options = TriangulationOptions { huber_sigmas: 2.0, ..TriangulationOptions::default() };
    let entry = |(place, track): (usize, &window::StartTrack)| {
        let cameras: Vec<_> = track.iter().map(|sighting| &rig[sighting.camera].camera).collect();
        let views: Vec<View> = track
            .iter()
            .map(|sighting| View {
                parent_from_camera: states[sighting.image].local_from_imu
                    * rig[sighting.camera].imu_from_camera,
                pixel: sighting.pixel,
                sigma_px,
            })
            .collect();
        let found = triangulate(&cameras, &views, &options)
            .ok()
            .map(|found| views[0].parent_from_camera.inverse_transform(&found.position));
        let landmark = found.map_or(
            Landmark { normalized: track[0].ray.xy(), inverse_depth: UNKNOWN_INVERSE_DEPTH },
            |point| Landmark { normalized: point.xy() / point.z, inverse_depth: 1.0 / point.z },
        );
        Entry { track: place, landmark, used: vec![true; track.len()] }
    };
    window.tracks.iter().enumerate().map(entry).collect()
}

/// Turns L about gravity so that the body has no yaw in it, as every start defines L.
fn without_yaw(stamp_ns: i64, state: &ImuState, covariance: &ImuMatrix) -> InitialState {
    let up = state.local_from_imu.rotation.inverse() * Vector3::z();
    let turn = upright(&up) * state.local_from_imu.rotation.inverse();
    let at_origin =
        ImuState { local_from_imu: Pose::new(state.local_from_imu.rotation, Vector3::zeros()), ..*state };
    let start = InitialState { stamp_ns, imu: at_origin, covariance: *covariance };
    start.seen_from(&Pose::new(turn, Vector3::zeros()))
}
