//! Wheels: what a base is, and the readings of its wheels.

mod base;
mod encoder;
mod reading;

pub use base::{BaseKind, MAX_WHEEL_PARAMETERS, WheelBase};
pub use encoder::{Encoder, EncoderCounts, EncoderError};
pub use reading::{MAX_WHEELS, WheelReading};
