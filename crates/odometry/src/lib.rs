//! Visual-inertial odometry as a robot runs it, without network and clock.
//!
//! | module | what |
//! |---|---|
//! | [`front_end`] | [`FrontEnd`]: from images and gyroscope readings to feature tracks |
//! | [`estimator_supervisor`] | [`EstimatorSupervisor`]: initializes the estimator, and starts it again when it diverges |
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod estimator_supervisor;
pub mod front_end;

pub use estimator_supervisor::EstimatorSupervisor;
pub use front_end::{FrontEnd, FrontEndError};
