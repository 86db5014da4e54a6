//! What a filter, a front end, a map and a message have in common.
//!
//! | module | what |
//! |---|---|
//! | `ids` | [`KeyframeId`], [`LandmarkId`] |
//! | `imu` | [`ImuSample`], [`ImuNoise`] |
//! | `wheels` | [`WheelBase`], [`WheelReading`], and [`EncoderCounts`], which makes readings of encoders |
//! | `gnss` | [`GnssReading`] |
//! | `track` | [`TrackObservation`], a feature that a front end follows |
//! | [`descriptors`] | [`DescriptorKind`], [`DescriptorFormat`], [`Descriptors`] |
//! | [`features`] | [`FeatureSet`], pixels and descriptors of one image |
//! | [`hexadecimal`] | bytes as digits |
//! | `newest` | [`push_newest`], for queues that keep the newest |
//! | [`bounded`] | lists that are refused at the first element too many |
//!
//! Times are nanoseconds. Pixels are distorted, as measured; (0, 0) is the centre of the top-left pixel.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod bounded;
pub mod descriptors;
pub mod features;
mod gnss;
pub mod hexadecimal;
mod ids;
mod imu;
mod newest;
mod track;
mod wheels;

pub use descriptors::{DescriptorFormat, DescriptorKind, Descriptors};
pub use features::FeatureSet;
pub use gnss::GnssReading;
pub use ids::{KeyframeId, LandmarkId};
pub use imu::{ImuNoise, ImuSample};
pub use newest::push_newest;
pub use track::TrackObservation;
pub use wheels::{
    BaseKind, Encoder, EncoderCounts, EncoderError, MAX_WHEEL_PARAMETERS, MAX_WHEELS, WheelBase, WheelReading,
};
