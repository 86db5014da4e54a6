//! Package `nav_msgs`.

use crate::builtin_interfaces::Time;
use crate::definition::{self, Definition};
use crate::geometry_msgs::{Pose, PoseStamped, PoseWithCovariance, TwistWithCovariance};
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

/// `nav_msgs/msg/Path`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Path {
    /// Time of the path, and its frame.
    pub header: Header,
    /// Where it leads, in order.
    pub poses: Vec<PoseStamped>,
}

impl RosMessage for Path {
    const TYPE_NAME: &'static str = "nav_msgs/msg/Path";
    const TYPE_HASH: &'static str = "RIHS01_1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b";
    const DEFINITION: Definition = definition::PATH;
}

/// Size and place of a grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MapMetaData {
    /// When the map was loaded.
    pub map_load_time: Time,
    /// Side of a cell, metres.
    pub resolution: f32,
    /// Cells along x.
    pub width: u32,
    /// Cells along y.
    pub height: u32,
    /// The outer corner of cell (0, 0) in the header's frame.
    pub origin: Pose,
}

/// `nav_msgs/msg/OccupancyGrid`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OccupancyGrid {
    /// Time and frame of the map.
    pub header: Header,
    /// Size and place.
    pub info: MapMetaData,
    /// Cells by rows of equal y, beginning at the origin: percent of being occupied, or -1 where that is unknown.
    pub data: Vec<i8>,
}

impl RosMessage for OccupancyGrid {
    const TYPE_NAME: &'static str = "nav_msgs/msg/OccupancyGrid";
    const TYPE_HASH: &'static str = "RIHS01_8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7";
    const DEFINITION: Definition = definition::OCCUPANCY_GRID;
}
