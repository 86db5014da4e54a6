//! The estimator (pure, no I/O) and the robot program around it.
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod estimator;
pub mod evaluation;
pub mod robot;
pub mod sequence;
pub mod trajectory;
