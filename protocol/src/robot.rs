//! `robot/{robot}/pose`, `/odometry` and `/status`: published by robots.

use crate::identity::MapIdentity;
use crate::validate::{InvalidField, Validate, require_finite, require_name, require_short, require_valid};
use crate::wire;
use geometry::uncertain_pose::PoseWithCovariance;
use serde::{Deserialize, Serialize};

/// Pose of a robot in its map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobotPose {
    /// Sensor time, nanoseconds.
    pub stamp_ns: i64,
    /// Name of the map that defines the global frame.
    pub map: String,
    /// Version of the map at the last map update.
    pub map_version: u64,
    /// Identity of the map: other maps have versions of the same numbers.
    pub map_identity: MapIdentity,
    /// The IMU in the map's frame.
    #[serde(with = "wire::PoseForm")]
    pub global_from_imu: PoseWithCovariance,
    /// The odometry frame in the map's frame.
    #[serde(with = "wire::PoseForm")]
    pub global_from_local: PoseWithCovariance,
}

impl Validate for RobotPose {
    fn validate(&self) -> Result<(), InvalidField> {
        require_name(&self.map, "map")?;
        require_valid(&self.global_from_imu, "global_from_imu")?;
        require_valid(&self.global_from_local, "global_from_local")
    }
}

/// Pose of a robot in the estimator's odometry frame L, which drifts; available without a map.
///
/// It jumps where the map or GNSS corrects it, and L is another frame after a divergence. Continuous is the topic `odometry` of ROS 2.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobotOdometry {
    /// Sensor time, nanoseconds.
    pub stamp_ns: i64,
    /// The IMU in the odometry frame.
    #[serde(with = "wire::PoseForm")]
    pub local_from_imu: PoseWithCovariance,
    /// Velocity of the IMU in the odometry frame, m/s.
    pub velocity_in_local: [f64; 3],
    /// Angular velocity in the IMU frame, bias removed, rad/s.
    pub angular_velocity_in_imu: [f64; 3],
}

impl Validate for RobotOdometry {
    fn validate(&self) -> Result<(), InvalidField> {
        require_valid(&self.local_from_imu, "local_from_imu")?;
        require_finite(&self.velocity_in_local, "velocity_in_local")?;
        require_finite(&self.angular_velocity_in_imu, "angular_velocity_in_imu")
    }
}

/// Localization state of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RobotState {
    /// Odometry only: no pose in the map yet, or no map.
    OdometryOnly,
    /// A pose in the map, confirmed by recent map updates.
    Localized,
    /// The pose in the map, or the odometry, can no longer be trusted.
    Lost,
    /// No pose yet, and none was lost: odometry is not initialized.
    Starting,
    /// It shuts down in order: the last status that it publishes. Who ends without it was killed, or lost its connection.
    Off,
}

/// Health of a robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobotStatus {
    /// Sensor time, nanoseconds.
    pub stamp_ns: i64,
    /// Localization state.
    pub state: RobotState,
    /// Reason of the state, human-readable.
    pub reason: String,
    /// The map used, if any.
    #[serde(default)]
    pub map: Option<String>,
    /// Sensor time of the last accepted update from the map, nanoseconds.
    #[serde(default)]
    pub last_map_update_ns: Option<i64>,
    /// Keyframes of the map in its state.
    pub keyframes_held: u32,
    /// Match queries sent since the start.
    pub queries_sent: u64,
    /// Those that were answered completely and in time.
    pub queries_answered: u64,
}

impl Validate for RobotStatus {
    fn validate(&self) -> Result<(), InvalidField> {
        require_short(&self.reason, "reason")?;
        self.map.as_ref().map_or(Ok(()), |map| require_name(map, "map"))
    }
}
