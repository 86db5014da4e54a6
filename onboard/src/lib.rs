//! The estimator (pure, no I/O) and the robot program around it.
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod estimator;
pub mod evaluation;
pub mod sequence;
pub mod robot;
pub mod trajectory;
