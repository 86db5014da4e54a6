//! Recordings as MCAP, rosbag2 or rosbag1.
//!
//! The stamps of readings and images are those in their headers, not the times at which they were recorded.

mod accelerometer;
mod calibration;
mod camera_topics;
mod foxglove;
mod gnss_topic;
mod image;
mod imu_topics;
mod index;
mod messages;
mod recorded_calibration;
mod recording;
mod rows;
mod topics;
mod wheel_topic;

pub use bags::BagError;
pub use topics::{BagCamera, BagSensors};

pub(crate) use recording::BagRecording;
