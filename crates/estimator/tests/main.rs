//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

mod allocations;
mod bad_measurements;
mod common;
mod filter_laws;
mod gtsam;
mod initializer;
mod keyframe_motions;
mod map_change;
mod map_initialization;
mod map_measurement;
mod schmidt;
mod slam_features;
