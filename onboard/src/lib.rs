//! The robot program as a library: plays a sensor source through the estimator, queries the map, publishes, records.
//!
//! The estimator runs on the caller's thread. Queries and publications run on the async runtime and are handed over
//! through channels: the estimator never waits for the network.
//!
//! | module | what |
//! |---|---|
//! | [`arguments`] | switches of the robot and settings of the estimator |
//! | `cli` (feature `ros`) | the command line of `onboard`, and its settings file |
//! | [`program`] | [`run_robot`] and its kin: builds a robot from the switches, scores the run, writes the output folder |
//! | [`run`](mod@run), `map_queries` | [`Robot`]: the loop over frames; sending queries, applying answers and map changes |
//! | [`output`], [`estimate`], [`event`], [`report`], [`counts`] | [`Output`]: who takes what the robot gives out; what that is |
//! | [`settings`], [`error`] | [`RobotSettings`]; why a robot cannot be made or a run ends early |
//! | `input` | reads a [`SensorSource`](sensors::SensorSource) ahead; the window of IMU readings |
//! | [`start`] | initial state and excerpt of a recording |
//! | [`alarms`], `run_status` | what contradicts the sensors or the map: logged when it begins and ends, kept for the summary |
//! | [`native`], `ros_sensors`, `ros_camera_info`, `topic_watch` (feature `ros`) | live sensors over Zenoh, as ROS 2 topics; projections of their cameras; why a topic is silent |
//! | [`initial_pose`] | poses that an operator sets, as priors of map queries |
//! | `prediction` | odometry at the rate of the IMU |
//! | [`extraction`] | features from images; tracks are made by the crate `odometry` |
//! | [`outputs`] | files, summary, messages, ROS 2 topics |
//! | [`stop`], [`progress`], [`stdout`] | signals and terminal |
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

pub mod alarms;
pub mod arguments;
#[cfg(feature = "ros")]
pub mod cli;
pub mod counts;
pub mod error;
pub mod estimate;
pub mod event;
pub mod extraction;
pub mod initial_pose;
mod input;
pub mod link;
pub mod map_conversion;
mod map_queries;
pub mod native;
pub mod output;
pub mod outputs;
mod prediction;
pub mod program;
pub mod progress;
pub mod report;
#[cfg(feature = "ros")]
pub mod ros_camera_info;
#[cfg(feature = "ros")]
pub mod ros_sensors;
pub mod run;
mod run_status;
pub mod settings;
pub mod start;
pub mod stdout;
pub mod stop;
#[cfg(feature = "ros")]
mod topic_watch;

pub use arguments::RobotArguments;
pub use counts::PairSummary;
pub use error::{RobotError, RunError};
pub use estimate::{Estimate, GlobalEstimate, StatusReport};
pub use event::Event;
pub use link::{LinkError, MapLink, OpeningLink, RobotLink};
pub use output::Output;
pub use outputs::{EndedLost, Recorder, RobotMetrics, Summary};
pub use program::{Outcome, run_robot, run_robot_until, run_source_until};
pub use report::RunReport;
pub use run::Robot;
pub use settings::{RobotSettings, estimator_config};
pub use stop::StopSignal;
