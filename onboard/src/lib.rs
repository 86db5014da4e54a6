//! The robot program around the estimator: plays a recording, asks the map, publishes, records.
//!
//! The estimator runs on the caller's thread. Queries and publications run on the async runtime and
//! are handed over through channels: the estimator never waits for the network.
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod arguments;
pub mod estimator_supervisor;
pub mod event;
pub mod extraction;
pub mod front_end;
mod imu_window;
pub mod map_conversion;
mod map_queries;
pub mod output;
pub mod program;
pub mod progress;
pub mod publisher;
pub mod recorder;
pub mod run;
pub mod start;
pub mod stdout;
pub mod stop;
pub mod summary;

pub use arguments::RobotArguments;
pub use estimator_supervisor::EstimatorSupervisor;
pub use front_end::{FrontEnd, FrontEndError};
pub use imu_window::ImuWindow;
pub use program::{MapLink, Outcome, run_robot, run_robot_until};
pub use run::{RobotRun, RunError, run};
pub use stop::StopSignal;
