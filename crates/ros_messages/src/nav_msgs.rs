//! Package `nav_msgs`.

use crate::definition::{self, Definition};
use crate::geometry_msgs::{PoseWithCovariance, TwistWithCovariance};
use crate::message::RosMessage;
use crate::std_msgs::Header;
use serde::{Deserialize, Serialize};

/// `nav_msgs/msg/Odometry`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// Time, and the frame of the pose.
    pub header: Header,
    /// The frame whose pose this is, and of the twist.
    pub child_frame_id: String,
    /// Pose of the child frame in the header's frame.
    pub pose: PoseWithCovariance,
    /// Velocity in the child frame.
    pub twist: TwistWithCovariance,
}

impl RosMessage for Odometry {
    const TYPE_NAME: &'static str = "nav_msgs/msg/Odometry";
    const TYPE_HASH: &'static str = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0";
    const DEFINITION: Definition = definition::ODOMETRY;
}
