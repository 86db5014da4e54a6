//! Package `std_msgs`.

use crate::builtin_interfaces::Time;
use serde::{Deserialize, Serialize};

/// When and in which frame a message's values were measured.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Time of measurement.
    pub stamp: Time,
    /// Name of the frame (REP-105).
    pub frame_id: String,
}

impl Header {
    /// A header of a time and a frame; `None` for a time that ROS cannot write ([`Time::from_nanoseconds`]).
    pub fn new(stamp_ns: i64, frame_id: &str) -> Option<Self> {
        Some(Self { stamp: Time::from_nanoseconds(stamp_ns)?, frame_id: frame_id.to_owned() })
    }
}
