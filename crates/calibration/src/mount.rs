//! Where a sensor is mounted, as a file states it.

use std::path::Path;

use geometry::{Pose, check_mount};

use crate::CalibrationError;

/// A sensor farther from the IMU is warned of, metres: only large vehicles have one, and millimetres are a common mistake.
const FAR_M: f64 = 10.0;

/// Checks where a sensor is in the frame of the IMU. `name`: what the file calls it.
pub(crate) fn checked_mount(path: &Path, name: &str, imu_from_sensor: &Pose) -> Result<(), CalibrationError> {
    check_mount(imu_from_sensor)
        .map_err(|error| CalibrationError::entry(path, format!("{name}: {error}")))?;
    let distance = imu_from_sensor.translation.norm();
    if distance > FAR_M {
        tracing::warn!(
            "{}: {name} is a translation of {distance:.0} m: the file is in metres, is this one in millimetres?",
            path.display()
        );
    }
    Ok(())
}
