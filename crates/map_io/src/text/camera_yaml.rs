//! `camera.yaml`: the intrinsics of a camera, as in the `sensor.yaml` of the EuRoC layout.

use std::path::Path;

use calibration::{projection_yaml, read_lens};
use geometry::camera::Camera;

use super::error::MapFileError;

/// Reads the camera of a map; extrinsics and rate do not matter to keyframes, which are camera poses.
///
/// # Errors
/// [`MapFileError::Camera`] where the file is missing or states no usable camera.
pub fn read_camera(path: &Path) -> Result<Camera, MapFileError> {
    Ok(read_lens(path)?)
}

/// The text of a `camera.yaml` that [`read_camera`] reads back exactly.
pub(super) fn camera_text(camera: &Camera) -> String {
    format!("sensor_type: camera\n{}", projection_yaml(camera))
}
