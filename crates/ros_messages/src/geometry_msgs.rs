//! Package `geometry_msgs`.

use crate::definition::{self, Definition};
use crate::message::RosMessage;
use crate::std_msgs::Header;
use serde::{Deserialize, Serialize};
use serde_big_array::BigArray;

/// A free vector.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vector3 {
    /// Along the frame's x axis.
    pub x: f64,
    /// Along the frame's y axis.
    pub y: f64,
    /// Along the frame's z axis.
    pub z: f64,
}

impl From<[f64; 3]> for Vector3 {
    fn from([x, y, z]: [f64; 3]) -> Self {
        Self { x, y, z }
    }
}

impl From<Vector3> for [f64; 3] {
    fn from(Vector3 { x, y, z }: Vector3) -> Self {
        [x, y, z]
    }
}

/// A position in metres. On the wire as [`Vector3`].
pub type Point = Vector3;

/// A rotation; unit norm, scalar last.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// i
    pub x: f64,
    /// j
    pub y: f64,
    /// k
    pub z: f64,
    /// Scalar.
    pub w: f64,
}

impl Default for Quaternion {
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

/// Position and orientation of a body in the header's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Metres.
    pub position: Point,
    /// `header.frame_id` from body.
    pub orientation: Quaternion,
}

/// A pose with the time at which it holds and its frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseStamped {
    /// Time and frame of the pose.
    pub header: Header,
    /// The pose in the header's frame.
    pub pose: Pose,
}

/// A 6x6 matrix by rows: x, y, z, then rotations about the fixed x, y and z axes of the header's frame.
pub type Covariance6 = [f64; 36];

/// A pose with its covariance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovariance {
    /// The mean.
    pub pose: Pose,
    /// m^2, m rad and rad^2.
    #[serde(with = "BigArray")]
    pub covariance: Covariance6,
}

impl Default for PoseWithCovariance {
    fn default() -> Self {
        Self { pose: Pose::default(), covariance: [0.0; 36] }
    }
}

/// `geometry_msgs/msg/PoseWithCovarianceStamped`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovarianceStamped {
    /// Time and frame of the pose.
    pub header: Header,
    /// The pose in the header's frame.
    pub pose: PoseWithCovariance,
}

impl RosMessage for PoseWithCovarianceStamped {
    const TYPE_NAME: &'static str = "geometry_msgs/msg/PoseWithCovarianceStamped";
    const TYPE_HASH: &'static str = "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e";
    const DEFINITION: Definition = definition::POSE_STAMPED;
}

/// Velocities of a body.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// m/s.
    pub linear: Vector3,
    /// rad/s.
    pub angular: Vector3,
}

/// A twist with its covariance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TwistWithCovariance {
    /// The mean.
    pub twist: Twist,
    /// Linear, then angular, by rows; SI units.
    #[serde(with = "BigArray")]
    pub covariance: Covariance6,
}

impl Default for TwistWithCovariance {
    fn default() -> Self {
        Self { twist: Twist::default(), covariance: [0.0; 36] }
    }
}

/// A child frame's pose in its parent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// Metres.
    pub translation: Vector3,
    /// Parent from child.
    pub rotation: Quaternion,
}

/// A transform with the names of its frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TransformStamped {
    /// Time, and the parent frame.
    pub header: Header,
    /// The child frame.
    pub child_frame_id: String,
    /// Parent from child.
    pub transform: Transform,
}
