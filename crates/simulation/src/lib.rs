//! Simulated recordings of a world: one run to build a map from, one to localize in that map; and Monte-Carlo runs of the
//! estimator.
//!
//! Trajectories are splines with exact derivatives, so that IMU, tracks, features and ground truth agree to the last digit
//! before noise is added. The same seed gives the same bytes.
//!
//! | module | content |
//! |---|---|
//! | [`Scenario`], [`SimulationOptions`] | what is simulated |
//! | [`simulate`] | both recordings with tracks and features, as [`sensors::Sequence`] |
//! | [`ChangingPlace`] | many sessions in a world whose landmarks are moved between them |
//! | [`images`] | both recordings with rendered images instead |
//! | [`drive`] | a trajectory of a robot on wheels |
//! | [`spline`] | continuous trajectories with velocity, acceleration and angular velocity |
//! | [`monte_carlo`] | many seeded runs of the estimator against the simulated truth, and their NEES |
//!
//! World frame: z up, gravity along -z, metres. Body frame: x forward, y left, z up.
//!
//! ```
//! use simulation::{SimulationOptions, simulate};
//! let options = SimulationOptions { seed: 7, speed: 12.0, ..SimulationOptions::default() };
//! let scenario = simulate(&options)?;
//! assert!(scenario.map.reference_poses.is_some() && scenario.live.groundtruth.is_some());
//! # Ok::<(), simulation::SimulationError>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod changing_place;
pub mod drive;
mod exposure;
mod features;
pub mod images;
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

pub use changing_place::ChangingPlace;
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
    /// The built-in trajectory, where none is given.
    pub scenario: Scenario,
    /// Cruising speed on a built-in street, m/s.
    pub speed: f64,
    /// Length of the runs, seconds; unset, to the end of the trajectory.
    pub duration_s: Option<f64>,
    /// Trajectory of the map's run instead of a built-in one: the body (x forward, y left) in a world with z up.
    pub map_trajectory: Option<Vec<StampedPose>>,
    /// Trajectory of the live run; unset, that of the map's run, 1 m to the left.
    pub live_trajectory: Option<Vec<StampedPose>>,
    /// Images a second.
    pub frame_rate_hz: f64,
    /// Readout time of the cameras' rolling shutters, seconds; 0 for global ones.
    pub readout_s: f64,
    /// Time of the second camera's images after those of the first, seconds, which the calibration states; at most 5 ms, beyond which
    /// it would be one of the stamps.
    pub second_delay_s: f64,
    /// Whether there is a third camera, which looks back, with tracks and features of its own.
    pub rear_camera: bool,
    /// IMU samples a second.
    pub imu_rate_hz: f64,
    /// Noise densities of the IMU as its calibration states them; EuRoC's by default.
    pub imu_noise: ImuNoise,
    /// White noise of the IMU as a multiple of the stated one: data sheets state a sensor at rest.
    pub imu_noise_scale: f64,
    /// An IMU without noise and bias, for tests of integration.
    pub noise_free_imu: bool,
    /// Landmarks per metre of trajectory.
    pub landmarks_per_metre: f64,
    /// Range of depths at which landmarks are placed in front of the camera, metres.
    pub depth_m: [f64; 2],
    /// Range of distances at which a landmark is visible, metres.
    pub sight_m: [f64; 2],
    /// Most tracks of a stereo pair or single camera in a frame.
    pub max_tracks: usize,
    /// Standard deviation of a tracked pixel, px.
    pub sigma_track_px: f64,
    /// Fraction of tracked pixels that are 10 to 50 px off.
    pub outlier_fraction: f64,
    /// Time between images with features in the map's run, seconds.
    pub map_feature_period_s: f64,
    /// The same in the live run.
    pub live_feature_period_s: f64,
    /// Most features of landmarks in an image.
    pub max_features: usize,
    /// Features in an image that belong to no landmark.
    pub clutter: usize,
    /// Standard deviation of a feature's pixel, px.
    pub sigma_feature_px: f64,
    /// Probability that the extractor detects a visible landmark.
    pub repeatability: f64,
    /// Probability that a bit of a descriptor is wrong.
    pub bit_flips: f64,
    /// Fraction of landmarks with the descriptor of another one.
    pub repeated_texture: f64,
    /// Fraction of the live run without features.
    pub dropout_fraction: f64,
    /// Standard deviation of the reference positions, metres an axis. The paper's map has 0.1.
    pub sigma_reference_p_m: f64,
    /// Standard deviation of the reference rotations, rad an axis. The paper's map has 0.0158.
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
            readout_s: 0.0,
            second_delay_s: 0.0,
            rear_camera: false,
            imu_rate_hz: 200.0,
            imu_noise: ImuNoise::default(),
            imu_noise_scale: 1.0,
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
    /// The cameras of the robot.
    fn cameras(&self) -> Vec<CameraSensor> {
        let mut cameras = rig::stereo(self.frame_rate_hz, self.readout_s, self.second_delay_s);
        if self.rear_camera {
            cameras.push(rig::rear(&cameras[0]));
        }
        cameras
    }

    /// Checks that the options can be simulated.
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
        let not_negative = [
            ("readout_s", self.readout_s),
            ("second_delay_s", self.second_delay_s),
            ("sigma_track_px", self.sigma_track_px),
            ("sigma_feature_px", self.sigma_feature_px),
        ];
        for (name, value) in not_negative {
            if !(value.is_finite() && value >= 0.0) {
                return Err(SimulationError::Option { name, value, wanted: "not negative" });
            }
        }
        let delayed = &rig::stereo(self.frame_rate_hz, self.readout_s, self.second_delay_s)[1];
        if delayed.stamp_shift_ns() != 0 {
            let (name, value) = ("second_delay_s", self.second_delay_s);
            return Err(SimulationError::Option {
                name,
                value,
                wanted: "a delay within a frame, up to 0.005",
            });
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

/// Why a simulation is impossible.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum SimulationError {
    /// An option is out of range.
    #[error("{name} is {value}, but must be {wanted}")]
    Option {
        /// The option.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The permitted values.
        wanted: &'static str,
    },
    /// A given trajectory is too short.
    #[error("the trajectory lasts {seconds:.1} s; at least {wanted} s are needed")]
    TrajectoryTooShort {
        /// Its duration.
        seconds: f64,
        /// The least duration.
        wanted: f64,
    },
    /// Images are simulated in a room, which other trajectories leave.
    #[error("images are simulated for the built-in flight only: other trajectories leave its room")]
    NoRoom,
}

/// Two recordings of one simulated world.
#[derive(Clone, Debug)]
pub struct SimulatedScenario {
    /// The run to build the map from, with reference poses that are off by what they state.
    pub map: Sequence,
    /// The run to localize, with drop-outs: stretches without features to match.
    pub live: Sequence,
}

/// Simulates a world and two runs through it; see the [example of the crate](crate).
///
/// The ground truth of both runs is in one world frame, z up, gravity along -z.
///
/// # Errors
/// [`SimulationError`] for options out of range and trajectories that are too short.
pub fn simulate(options: &SimulationOptions) -> Result<SimulatedScenario, SimulationError> {
    let world = simulate_world(options)?;
    Ok(SimulatedScenario {
        map: world.record(options, run::Kind::Map),
        live: world.record(options, run::Kind::Live),
    })
}

/// A world and two trajectories through it, before anything is recorded.
pub(crate) struct SimulatedWorld {
    /// Left and right camera, then the rear one.
    pub(crate) cameras: Vec<CameraSensor>,
    /// All landmarks.
    pub(crate) landmarks: Vec<Landmark>,
    /// Trajectory of the map's run: `world_from_imu`.
    pub(crate) map_trajectory: Spline,
    /// Trajectory of the live run: `world_from_imu`.
    pub(crate) live_trajectory: Spline,
}

/// Simulates a world and the trajectories through it; see [`simulate`].
pub(crate) fn simulate_world(options: &SimulationOptions) -> Result<SimulatedWorld, SimulationError> {
    options.check()?;
    let trajectories = run::trajectories(options)?;
    let cameras = options.cameras();
    let landmarks = world::landmarks(options, &cameras, &trajectories.first_laps);
    Ok(SimulatedWorld {
        cameras,
        landmarks,
        map_trajectory: trajectories.map,
        live_trajectory: trajectories.live,
    })
}

impl SimulatedWorld {
    /// Records one of the runs.
    pub(crate) fn record(&self, options: &SimulationOptions, kind: run::Kind) -> Sequence {
        let trajectory = match kind {
            run::Kind::Map => &self.map_trajectory,
            run::Kind::Live => &self.live_trajectory,
        };
        run::record(options, kind, trajectory, &self.cameras, &self.landmarks)
    }
}
