//! The sensors of a robot: what they are, where they are mounted, and their noise.

use geometry::camera::Camera;
use geometry::pose::Pose;
use types::ImuNoise;

/// The inertial sensor. Its frame is the body frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuSensor {
    /// Noise densities.
    pub noise: ImuNoise,
    /// Readings a second.
    pub rate_hz: f64,
    /// Magnitude of gravity at the place of the recording, m/s^2, where the calibration states it.
    pub gravity_magnitude: Option<f64>,
}

/// A camera and its mounting.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSensor {
    /// Projection: resolution, intrinsics, distortion.
    pub camera: Camera,
    /// Pose of the camera in the IMU frame: `imu_from_camera`.
    pub imu_from_camera: Pose,
    /// Images a second.
    pub rate_hz: f64,
}

/// Calibration of all sensors of a robot or of a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorCalibration {
    /// The IMU. A recording that only serves to build maps may have none; a robot cannot be localized without it.
    pub imu: Option<ImuSensor>,
    /// One camera, or the two of a stereo pair; frames refer to them by index.
    pub cameras: Vec<CameraSensor>,
}
