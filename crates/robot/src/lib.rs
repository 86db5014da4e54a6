//! A robot as a library: plays a sensor source through the estimator, queries the map, and hands what comes out to its
//! outputs.
//!
//! The estimator runs on the caller's thread. Queries run on an async runtime and are handed over through channels: the
//! estimator never waits for the network. There is no command line, no file and no format of messages here: the program
//! `onboard` adds them.
//!
//! | module | what |
//! |---|---|
//! | `settings` | [`RobotSettings`], [`estimator_config()`], [`wheel_config, wheel_sensor()`], [`gnss_config, gnss_sensor()`] |
//! | `run`, `run_status` | [`Robot`]: the loop over frames; its status and alarms |
//! | `output` | [`Output`]: takes what the robot gives out; [`Connection`], [`PublishMotion`] |
//! | `estimate`, `event`, `report`, [`counts`] | what that is: [`Estimate`], [`StatusReport`], [`Event`], [`RunReport`] |
//! | `link` | [`RobotLink`]: its session, which may come up after the robot |
//! | `map_queries`, [`map_conversion`] | sending queries, applying answers and map changes; messages as the estimator's types |
//! | `extraction` | features from images; tracks are made by the crate `odometry` |
//! | [`initial_pose`] | poses that an operator sets, as priors of map queries |
//! | `input` | reads a [`SensorSource`](sensors::SensorSource) ahead; the one buffer of IMU readings; what is wrong with the sensors |
//! | `prediction` | odometry at the rate of the IMU |
//! | `query_cameras` | which camera the map is asked about next |
//! | `alarms` | what contradicts the sensors or the map: logged when it begins and ends, kept for the report |
//! | `error` | [`RobotError`], [`RunError`] |
//! | [`stop`] | [`StopSignal`](stop::StopSignal), and a runtime whose end does not wait |
//!
//! The example `own_robot` is a program of one page: images and a map server in, poses and their covariance out.
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod alarms;
pub mod counts;
mod error;
mod estimate;
mod event;
mod extraction;
pub mod initial_pose;
mod input;
mod link;
pub mod map_conversion;
mod map_queries;
mod output;
mod prediction;
mod query_cameras;
mod report;
mod run;
mod run_status;
mod settings;
pub mod stop;

pub use alarms::Alarm;
pub use error::{RobotError, RunError};
pub use estimate::{Estimate, GlobalEstimate, StatusReport};
pub use event::Event;
pub use link::{LinkError, MapLink, OpeningLink, RobotLink};
pub use output::{Connection, Output, PublishMotion};
pub use query_cameras::QueryImage;
pub use report::RunReport;
pub use run::Robot;
pub use settings::{RobotSettings, estimator_config, gnss_config, gnss_sensor, wheel_config, wheel_sensor};

/// The examples of the README run as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
