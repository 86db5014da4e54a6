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
