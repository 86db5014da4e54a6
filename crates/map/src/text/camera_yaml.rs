//! `camera.yaml`: the intrinsics of a camera, as in the `sensor.yaml` of the EuRoC layout.

use std::fmt::Write as _;
use std::path::Path;

use calibration::read_lens;
use geometry::camera::{Camera, Distortion};

use super::error::MapFileError;
use super::table::shortest;

/// Reads the camera of a map; extrinsics and rate do not matter to keyframes, which are camera poses.
///
/// # Errors
/// [`MapFileError::Camera`] where the file is missing or states no usable camera.
pub fn read_camera(path: &Path) -> Result<Camera, MapFileError> {
    Ok(read_lens(path)?)
}

/// The text of a `camera.yaml` that [`read_camera`] reads back exactly.
pub(super) fn camera_text(camera: &Camera) -> String {
    let (model, coefficients): (&str, &[f64]) = match &camera.distortion {
        Distortion::None => ("none", &[]),
        Distortion::RadialTangential(values) => ("radial-tangential", values),
        Distortion::Equidistant(values) => ("equidistant", values),
        Distortion::Fov(omega) => ("fov", std::slice::from_ref(omega)),
    };
    let mut text = String::from("sensor_type: camera\n");
    let intrinsics = [camera.focal[0], camera.focal[1], camera.centre[0], camera.centre[1]];
    // Writing to a String cannot fail.
    let _ = writeln!(text, "resolution: [{}, {}]", camera.width, camera.height);
    let _ = writeln!(text, "camera_model: pinhole");
    let _ = writeln!(text, "intrinsics: [{}]", list(&intrinsics));
    let _ = writeln!(text, "distortion_model: {model}");
    let _ = writeln!(text, "distortion_coefficients: [{}]", list(coefficients));
    text
}

/// Numbers separated by commas, each in its shortest exact form.
pub(super) fn list(values: &[f64]) -> String {
    values.iter().map(|&value| shortest(value)).collect::<Vec<_>>().join(", ")
}
