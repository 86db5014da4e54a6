//! Package `rosgraph_msgs`.

use crate::builtin_interfaces::Time;
use crate::definition::{self, Definition};
use crate::message::RosMessage;
use serde::{Deserialize, Serialize};

/// `rosgraph_msgs/msg/Clock`: the time of nodes with `use_sim_time`, on the topic `/clock`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clock {
    /// Now.
    pub clock: Time,
}

impl RosMessage for Clock {
    const TYPE_NAME: &'static str = "rosgraph_msgs/msg/Clock";
    const TYPE_HASH: &'static str = "RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564";
    const DEFINITION: Definition = definition::CLOCK;
}
