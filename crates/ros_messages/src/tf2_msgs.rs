//! Package `tf2_msgs`.

use crate::definition::{self, Definition};
use crate::geometry_msgs::TransformStamped;
use crate::message::RosMessage;
use serde::{Deserialize, Serialize};

/// `tf2_msgs/msg/TFMessage`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TFMessage {
    /// Transforms, each with its time.
    pub transforms: Vec<TransformStamped>,
}

impl RosMessage for TFMessage {
    const TYPE_NAME: &'static str = "tf2_msgs/msg/TFMessage";
    const TYPE_HASH: &'static str = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087";
    const DEFINITION: Definition = definition::TRANSFORMS;
}
