//! Serves keyframe maps over Zenoh.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod serve;

pub use serve::{MapServer, ServeError, ServedMap, ServerOptions, ServerStatistics};
