//! What a ROS 2 type is called.

use crate::definition::Definition;
use serde::{Serialize, de::DeserializeOwned};

/// A message that is a topic's type.
pub trait RosMessage: Serialize + DeserializeOwned {
    /// The name as `ros2 topic info` and recordings write it, for example `sensor_msgs/msg/Imu`.
    const TYPE_NAME: &'static str;
    /// The type hash of REP-2016 (`RIHS01_` and 64 hexadecimal digits); the same in Jazzy and Kilted.
    const TYPE_HASH: &'static str;
    /// The fields of the type; see [`definition`](crate::definition).
    const DEFINITION: Definition;
}
