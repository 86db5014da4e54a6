//! The robot program as a library: the crate `robot` with a command line, settings in files, and its outputs: files, messages
//! over Zenoh, topics of ROS 2, recordings, metrics.
//!
//! | module | what |
//! |---|---|
//! | [`arguments`] | switches of the robot and settings of the estimator |
//! | `cli` (feature `ros`) | the command line of `onboard`, and its settings file |
//! | [`program`] | [`run_robot`] and its kin: builds a [`robot::Robot`] from the switches, scores the run, writes the output folder |
//! | [`start`] | initial state and excerpt of a recording |
//! | [`native`], `ros_sensors`, `ros_camera_info`, `ros_mount`, `topic_watch` (feature `ros`) | live sensors over Zenoh, as ROS 2 topics; projections of their cameras; where the robot is on its IMU; why a topic is silent |
//! | [`outputs`] | each a [`robot::Output`]: files, messages, ROS 2 topics, recordings, metrics, the status in the log; the summary |
//! | [`progress`], [`stdout`], [`stop`] | terminal and signals |
//!
//! A robot without map and network, on a simulated recording:
//! ```
//! use onboard::arguments::Mode;
//! use onboard::{RobotArguments, run_robot};
//! use simulation::{SimulationOptions, simulate};
//!
//! let recording = simulate(&SimulationOptions { duration_s: Some(5.0), ..SimulationOptions::default() })?.live;
//! let folder = tempfile::tempdir()?;
//! let mut arguments = RobotArguments::with_defaults(folder.path())?;
//! arguments.mode = Some(Mode::Odometry);
//! let outcome = run_robot(&recording, &arguments, None, |_frame| {})?;
//! assert_eq!(outcome.states()?.len(), outcome.summary.frames);
//! # Ok::<(), anyhow::Error>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod arguments;
#[cfg(feature = "ros")]
pub mod cli;
pub mod native;
pub mod outputs;
pub mod program;
pub mod progress;
#[cfg(feature = "ros")]
pub mod ros_camera_info;
#[cfg(feature = "ros")]
pub mod ros_mount;
#[cfg(feature = "ros")]
pub mod ros_sensors;
#[cfg(feature = "ros")]
pub mod ros_wheels;
pub mod start;
pub mod stdout;
#[cfg(feature = "ros")]
mod topic_watch;

pub use arguments::RobotArguments;
pub use outputs::{EndedLost, Recorder, RobotMetrics, Summary};
pub use program::{Outcome, run_robot, run_robot_until, run_source_until};
pub use robot::counts::{ClockShiftSummary, PairSummary};
pub use robot::stop::{self, StopSignal};
pub use robot::{Event, MapLink, OpeningLink, RobotLink};
