//! Simulates a place and two runs through it: one to build a map from, one to localize in it.
//!
//! Trajectories are splines with exact derivatives, so that IMU, tracks, features and truth agree to the last digit
//! before noise is added. The same seed gives the same bytes.
//!
//! ```
//! use simulation::{SimulationOptions, simulate};
//! let options = SimulationOptions { seed: 7, speed: 12.0, ..SimulationOptions::default() };
//! let place = simulate(&options)?;
//! assert!(place.map.reference_poses.is_some() && place.live.groundtruth.is_some());
//! # Ok::<(), simulation::SimulationError>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod features;
mod imu;
pub mod monte_carlo;
mod path;
pub(crate) mod random;
mod rig;
pub(crate) mod run;
mod scenario;
pub mod spline;
pub(crate) mod tracks;
pub(crate) mod world;

#[cfg(test)]
mod tests;

use evaluation::trajectory::StampedPose;
pub use scenario::Scenario;
use sensors::{CameraSensor, ImuNoise, Sequence};
use spline::Spline;
use thiserror::Error;
use world::Landmark;

/// Gravity in the simulated world, m/s^2, along -z.
pub const GRAVITY: f64 = 9.81;

/// What is simulated.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulationOptions {
    /// Same seed, same bytes.
    pub seed: u64,
    /// The built-in way, where no trajectory is given.
    pub scenario: Scenario,
    /// Cruising speed on a built-in street, m/s.
    pub speed: f64,
    /// Ends the runs after so many seconds; unset, at the end of the way.
    pub duration_s: Option<f64>,
    /// The way of the map's run instead of a built-in one: the body (x forward, y left) in a world with z up.
    pub map_trajectory: Option<Vec<StampedPose>>,
    /// The way of the live run; unset, the map's way a metre to the left.
    pub live_trajectory: Option<Vec<StampedPose>>,
    /// Images a second.
    pub frame_rate_hz: f64,
    /// IMU samples a second.
    pub imu_rate_hz: f64,
    /// Noise densities of the IMU; EuRoC's by default.
    pub imu_noise: ImuNoise,
    /// An IMU without noise and bias, for tests of integration.
    pub noise_free_imu: bool,
    /// Landmarks a metre of way.
    pub landmarks_per_metre: f64,
    /// Depth at which landmarks are put before the camera, nearest and furthest, metres.
    pub depth_m: [f64; 2],
    /// Distance from which and up to which a landmark is seen, metres.
    pub sight_m: [f64; 2],
    /// Tracks alive in a frame, at most.
    pub max_tracks: usize,
    /// Noise of a tracked pixel, px.
    pub sigma_track_px: f64,
    /// Fraction of tracked pixels that are 10 to 50 px off.
    pub outlier_fraction: f64,
    /// Time between images with features in the map's run, seconds.
    pub map_feature_period_s: f64,
    /// The same in the live run.
    pub live_feature_period_s: f64,
    /// Features of landmarks in an image, at most.
    pub max_features: usize,
    /// Features of nothing in an image.
    pub clutter: usize,
    /// Noise of a feature's pixel, px.
    pub sigma_feature_px: f64,
    /// Probability that the extractor finds a landmark that is in view.
    pub repeatability: f64,
    /// Probability that a bit of a descriptor is wrong.
    pub bit_flips: f64,
    /// Fraction of landmarks that look like another one.
    pub repeated_texture: f64,
    /// Fraction of the live run without features.
    pub dropout_fraction: f64,
    /// Error of the reference poses, metres along each axis. The paper's map has 0.1.
    pub sigma_reference_p_m: f64,
    /// Error of the reference poses, rad about each axis. The paper's map has 0.0158.
    pub sigma_reference_theta_rad: f64,
}

impl Default for SimulationOptions {
    fn default() -> Self {
        Self {
            seed: 1,
            scenario: Scenario::default(),
            speed: 4.0,
            duration_s: None,
            map_trajectory: None,
            live_trajectory: None,
            frame_rate_hz: 10.0,
            imu_rate_hz: 200.0,
            imu_noise: ImuNoise::default(),
            noise_free_imu: false,
            landmarks_per_metre: 16.0,
            depth_m: [4.0, 30.0],
            sight_m: [1.0, 35.0],
            max_tracks: 100,
            sigma_track_px: 1.0,
            outlier_fraction: 0.0,
            map_feature_period_s: 0.5,
            live_feature_period_s: 1.0,
            max_features: 100,
            clutter: 30,
            sigma_feature_px: 1.0,
            repeatability: 0.7,
            bit_flips: 0.05,
            repeated_texture: 0.1,
            dropout_fraction: 0.25,
            sigma_reference_p_m: 0.1,
            sigma_reference_theta_rad: 0.0158,
        }
    }
}

impl SimulationOptions {
    /// Complains about what cannot be simulated.
    fn check(&self) -> Result<(), SimulationError> {
        let positive = [
            ("speed", self.speed),
            ("duration_s", self.duration_s.unwrap_or(1.0)),
            ("frame_rate_hz", self.frame_rate_hz),
            ("imu_rate_hz", self.imu_rate_hz),
            ("landmarks_per_metre", self.landmarks_per_metre),
            ("depth_m", self.depth_m[0]),
            ("depth_m", self.depth_m[1] - self.depth_m[0]),
            ("map_feature_period_s", self.map_feature_period_s),
            ("live_feature_period_s", self.live_feature_period_s),
            ("sigma_reference_p_m", self.sigma_reference_p_m),
            ("sigma_reference_theta_rad", self.sigma_reference_theta_rad),
        ];
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(SimulationError::Option { name, value, wanted: "positive (and in order)" });
            }
        }
        let not_negative =
            [("sigma_track_px", self.sigma_track_px), ("sigma_feature_px", self.sigma_feature_px)];
        for (name, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return Err(SimulationError::Option { name, value, wanted: "not negative" });
            }
        }
        let fractions = [
            ("outlier_fraction", self.outlier_fraction),
            ("repeatability", self.repeatability),
            ("bit_flips", self.bit_flips),
            ("repeated_texture", self.repeated_texture),
            ("dropout_fraction", self.dropout_fraction),
        ];
        for (name, value) in fractions {
            if !(0.0..=1.0).contains(&value) {
                return Err(SimulationError::Option { name, value, wanted: "between 0 and 1" });
            }
        }
        Ok(())
    }
}

/// Why nothing could be simulated.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SimulationError {
    /// An option makes no sense.
    #[error("{name} is {value}, but must be {wanted}")]
    Option {
        /// Which.
        name: &'static str,
        /// What it was.
        value: f64,
        /// What it must be.
        wanted: &'static str,
    },
    /// A given trajectory is over too soon.
    #[error("the trajectory lasts {seconds:.1} s; at least {wanted} s are needed")]
    TrajectoryTooShort {
        /// How long it lasts.
        seconds: f64,
        /// How long it must.
        wanted: f64,
    },
}

/// A place, as two recordings of it.
#[derive(Clone, Debug)]
pub struct SimulatedScenario {
    /// The run to build the map from, with reference poses that are off by what they state.
    pub map: Sequence,
    /// The run to localize, with stretches in which the map is of no use.
    pub live: Sequence,
}

/// Simulates a place and two runs through it.
///
/// Both runs are in one world frame with z up, gravity along -z; the truth of both is in it.
///
/// # Errors
/// [`SimulationError`] for options that make no sense and trajectories that are too short.
pub fn simulate(options: &SimulationOptions) -> Result<SimulatedScenario, SimulationError> {
    let world = simulate_world(options)?;
    Ok(SimulatedScenario {
        map: world.record(options, run::Kind::Map),
        live: world.record(options, run::Kind::Live),
    })
}

/// A place and two ways through it, of which nothing is recorded yet.
pub(crate) struct SimulatedWorld {
    /// The rig: left and right camera.
    pub(crate) cameras: Vec<CameraSensor>,
    /// All that there is to see.
    pub(crate) landmarks: Vec<Landmark>,
    /// The way of the map's run: `world_from_imu`.
    pub(crate) map_way: Spline,
    /// The way of the live run.
    pub(crate) live_way: Spline,
}

/// Makes a place and the ways through it; see [`simulate`].
pub(crate) fn simulate_world(options: &SimulationOptions) -> Result<SimulatedWorld, SimulationError> {
    options.check()?;
    let ways = run::ways(options)?;
    let cameras = rig::stereo(options.frame_rate_hz);
    let landmarks = world::landmarks(options, &cameras[0], &ways.first_laps);
    Ok(SimulatedWorld { cameras, landmarks, map_way: ways.map, live_way: ways.live })
}

impl SimulatedWorld {
    /// Records one of the runs.
    pub(crate) fn record(&self, options: &SimulationOptions, kind: run::Kind) -> Sequence {
        let way = if kind == run::Kind::Map { &self.map_way } else { &self.live_way };
        run::record(options, kind, way, &self.cameras, &self.landmarks)
    }
}
