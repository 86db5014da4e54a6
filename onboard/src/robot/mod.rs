//! The robot program around the estimator: plays a recording, asks the map, publishes, records.
//!
//! The estimator runs on the caller's thread. Queries and publications run on the async runtime and
//! are handed over through channels: the estimator never waits for the network.

pub mod answer;
pub mod arguments;
mod asking;
pub mod extraction;
pub mod front_end;
pub mod lifecycle;
pub mod program;
pub mod progress;
pub mod publisher;
pub mod query_client;
pub mod recorder;
pub mod run;
pub mod start;
pub mod summary;

pub use arguments::RobotArguments;
pub use front_end::{FrontEnd, FrontEndError};
pub use lifecycle::Lifecycle;
pub use program::{MapLink, Outcome, run_robot};
pub use run::{RobotRun, RunError, run};
