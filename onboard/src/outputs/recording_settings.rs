//! Settings of the recording of a run.

use super::ros::RosBody;
use sensors::SensorCalibration;

/// What is recorded, and how it is called.
#[derive(Clone, Debug)]
#[cfg_attr(not(feature = "bags"), expect(dead_code, reason = "such a build writes no recordings"))]
pub(crate) struct RecordingSettings {
    /// Frames and the robot's place in them.
    pub(crate) body: RosBody,
    /// The sensors: projections and mounting of the cameras, noise of the IMU.
    pub(crate) calibration: SensorCalibration,
    /// Name of the robot.
    pub(crate) robot: String,
    /// Whether odometry without a pose in the map is worth a warning.
    pub(crate) map_expected: bool,
    /// Whether readings and images are recorded.
    pub(crate) sensors: bool,
    /// Whether messages are dropped where the disk is too slow, instead of waiting for it.
    pub(crate) realtime: bool,
}
