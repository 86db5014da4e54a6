//! The `driftless` command: simulate, build maps, query, evaluate, plot and demo.
//!
//! Each subcommand is one file in [`command`]; what it does is a library beside it, so that tests and other programs
//! can do the same without a shell.
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod benchmark;
pub mod calibration_check;
pub mod cli;
pub mod command;
pub mod demo;
#[cfg(feature = "secure")]
pub mod fleet;
pub mod in_process;
pub mod maintenance_job;
mod map_aliases;
#[cfg(feature = "releases")]
mod map_difference;
pub mod map_place;
#[cfg(feature = "ros")]
mod map_topics;
mod old_spellings;
mod open_page;
mod own_map;
pub mod playback;
pub mod plotting;
pub mod query_image;
#[cfg(feature = "releases")]
pub mod review;
pub mod run_tracks;
pub mod server_query;
pub mod session_files;
pub mod stage_bar;
