//! Files of other programs that hold a whole rig: its cameras, their poses on the IMU, and the IMU's noise.

mod basalt;
mod orb_slam3;

use crate::yaml::imu_noise;
use crate::{CalibrationError, ImuSensor};
use geometry::camera::Camera;
use geometry::pose::Pose;
use std::path::Path;

/// A rig as a file states it.
pub(super) struct Rig {
    /// Projection and `imu_from_camera` of each camera.
    pub(super) cameras: Vec<(Camera, Pose)>,
    /// Added to the stamps of the cameras to obtain the IMU's, nanoseconds.
    pub(super) time_offset_ns: i64,
    pub(super) imu: ImuSensor,
}

/// Whether a text is such a file.
pub fn is_rig(text: &str) -> bool {
    basalt::is_calibration(text) || orb_slam3::is_settings(text)
}

/// The rig of such a file.
///
/// # Errors
/// [`CalibrationError`] with the file and the entry.
pub(super) fn read(path: &Path, text: &str) -> Result<Rig, CalibrationError> {
    if basalt::is_calibration(text) { basalt::read(path, text) } else { orb_slam3::read(path, text) }
}

/// The IMU of a rig.
///
/// # Arguments
/// * `densities`: name and value of the gyroscope's noise and walk, and of the accelerometer's.
fn imu(path: &Path, rate_hz: f64, densities: [(&str, f64); 4]) -> Result<ImuSensor, CalibrationError> {
    let noise = imu_noise(path, densities)?;
    Ok(ImuSensor { noise, rate_hz, gravity_magnitude: None, intrinsics: None })
}
