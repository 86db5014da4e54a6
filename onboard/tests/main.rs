//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

mod names;
#[cfg(unix)]
mod program;
#[cfg(feature = "bags")]
mod recording;
mod repeated_readings;
#[cfg(feature = "bags")]
mod sensor_recording;
mod sensor_source;
