//! Visual-inertial odometry as a robot runs it, without network and clock.
//!
//! | module | what |
//! |---|---|
//! | [`front_end`] | [`FrontEnd`]: from images and gyroscope readings to feature tracks |
//! | `group_tracker` | the tracker of a stereo pair or a single camera |
//! | [`estimator_supervisor`] | [`EstimatorSupervisor`]: initializes the estimator, and starts it again when it diverges |
//! | `repeated_warning` | [`RepeatedWarning`]: what would be logged at every image |
//! | `rig` | [`calibrated_cameras()`]: cameras as the estimator takes them |
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod estimator_supervisor;
pub mod front_end;
mod group_tracker;
mod repeated_warning;
mod rig;

pub use estimator_supervisor::EstimatorSupervisor;
pub use front_end::{FrontEnd, FrontEndError, FrontEndReport};
pub use repeated_warning::RepeatedWarning;
pub use rig::calibrated_cameras;
