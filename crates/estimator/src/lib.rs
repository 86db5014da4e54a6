//! The CS-MSCKF filter: visual-inertial odometry in a local frame L, and localization of L in the global frame G of a
//! map, by Schmidt-Kalman updates with matched landmarks.
//!
//! A sliding-window MSCKF with SLAM features whose state is
//! `[IMU | calibration | wheels | global_from_local | SLAM features | clones]`. Keyframes of the map are nuisance (consider)
//! states: their errors and correlations are accounted for and never corrected. The crate does no I/O: it takes
//! measurements and returns states, and uses no network, clock or file.
//!
//! # Use
//! Once per image: [`Estimator::imu`] for every reading up to the image, [`Estimator::time_update`] to its time,
//! [`Estimator::track_update`] with its feature tracks. When a query is sent to the map, [`Estimator::pin`] keeps the
//! clone of the query image; when the answer comes, [`Estimator::map_update`] with it, then [`Estimator::unpin`].
//! [`Estimator::map_changed`] takes in the announcement of a new map version. `examples/minimal.rs` does all of this on
//! simulated measurements. [`Initializer`] finds the state to start from.
//!
//! # Conventions
//! * `local_from_imu` maps IMU coordinates to L. L has its origin at the first pose and z up; gravity is `(0, 0, -g)`.
//! * A pose error is `[δθ, δp]` in the parent frame (`R = Exp(δθ) R̂`, `p = p̂ + δp`), except that of
//!   `global_from_local` inside of the state, see [`state::retract_locally`].
//! * Metres, radians, seconds, pixels as the camera sees them (distorted); time stamps in nanoseconds.
//!
//! # Modules, from the bottom up
//! | module | content |
//! |---|---|
//! | [`linear_algebra`] | dense matrices with reused memory, null-space projection |
//! | [`imu`] | IMU samples and their buffer |
//! | [`calibration`] | cameras, their extrinsics, time offset, and which of it is estimated online |
//! | [`config`] | all settings |
//! | [`propagation`] | IMU state, its integration and error transition |
//! | [`preintegration`], [`inertial_chain`] | IMU samples between two images, as a residual of their states; all of an adjustment |
//! | [`rolling_shutter`] | poses of the rows of images that are read out while the camera moves |
//! | [`motion`] | pose and velocities with covariance, now and predicted by the IMU |
//! | [`state`] | layout of the active state |
//! | [`schmidt`], [`covariance`] | joint covariance of the active state and the held keyframes |
//! | [`gate`] | chi-square tests |
//! | [`noise_adaptation`] | noise of IMU, tracks and matches from the innovations |
//! | [`wheels`] | wheel odometry: preintegration, measurement, slip |
//! | [`gnss`] | positions by satellites: measurement, alignment, contradictions |
//! | [`odometry`] | feature tracks: MSCKF update, SLAM features, zero-velocity update |
//! | [`map_update`] | answers of the map: verification, linearization, versions |
//! | [`initialization`] | initial state at rest (static) and in motion (dynamic) |
//! | [`health`] | divergence checks |
//! | [`Estimator`] | the filter: the verbs above |
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod calibration;
mod camera_vote;
pub mod config;
pub mod covariance;
mod error;
mod estimator;
mod first_estimates;
pub mod gate;
pub mod gnss;
pub mod health;
pub mod imu;
pub mod inertial_chain;
pub mod initialization;
pub mod linear_algebra;
pub mod map_update;
pub mod measurement;
pub mod motion;
pub mod noise_adaptation;
pub mod odometry;
pub mod preintegration;
pub mod propagation;
pub mod rolling_shutter;
pub mod schmidt;
pub mod state;
#[cfg(test)]
mod test_scene;
pub mod wheels;

pub use calibration::{CalibratedCamera, Calibration, OnlineCalibration};
pub use config::{AdaptiveNoise, ConfigError, EstimatorConfig, InitialSigmas, MapMode, Relinearization};
pub use error::EstimatorError;
pub use estimator::Estimator;
pub use estimator::map_knowledge::MapKnowledge;
pub use estimator::status::{Alarm, Localization, Status, StatusReason};
pub use gnss::BadGnssReading;
pub use gnss::config::GnssConfig;
pub use gnss::report::GnssCounts;
pub use gnss::watch::GnssFault;
pub use health::Divergence;
pub use imu::plausibility::ReadingCheck;
pub use imu::repetition::ImuFault;
pub use imu::{BadImuSample, ImuGap};
pub use initialization::continuation::LastTrustedPose;
pub use initialization::initializer::{InitMethod, InitStatus, Initialization, Initializer};
pub use initialization::static_init::InitialState;
pub use map_update::map_answer::{MapAnswer, MapKeyframe, MatchedLandmark};
pub use map_update::map_gravity::GravityFault;
pub use map_update::map_report::{MapReport, Rejection};
pub use map_update::map_revision::{ChangeSize, KeyframeMotion, MapRevision, RevisionEffect};
pub use map_update::map_watch::MapDrift;
pub use motion::{Motion, MotionPredictor};
pub use noise_adaptation::{LearnedNoise, NoiseBound, NoiseFault};
pub use odometry::msckf_update::TrackReport;
pub use state::CloneId;
pub use types::{
    BaseKind, GnssReading, ImuNoise, ImuSample, KeyframeId, TrackObservation, WheelBase, WheelReading,
};
pub use wheels::config::{InitialWheelSigmas, WheelConfig, WheelNoise};
pub use wheels::report::{Estimated, LearnedWheels, WheelCounts, WheelReport};
pub use wheels::watch::{Wheel, WheelFault};
