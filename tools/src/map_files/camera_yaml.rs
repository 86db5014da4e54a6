//! `camera.yaml`: the intrinsics of a camera, as in the `sensor.yaml` of the EuRoC layout.

use std::fmt::Write as _;
use std::path::Path;

use geometry::camera::{Camera, Distortion};
use serde::Deserialize;

use super::error::MapFileError;
use super::table::shortest;

/// What is read of the file; the rest (extrinsics, rate) does not matter to keyframes, which are camera poses.
#[derive(Deserialize)]
struct CameraYaml {
    resolution: [u32; 2],
    #[serde(default = "pinhole")]
    camera_model: String,
    intrinsics: [f64; 4],
    #[serde(default = "none")]
    distortion_model: String,
    #[serde(default)]
    distortion_coefficients: Vec<f64>,
}

fn pinhole() -> String {
    "pinhole".to_owned()
}

fn none() -> String {
    "none".to_owned()
}

/// Reads the camera of a map.
///
/// # Errors
/// [`MapFileError::Read`] where the file is missing, [`MapFileError::File`] where it states no usable camera.
pub fn read_camera(path: &Path) -> Result<Camera, MapFileError> {
    let text = std::fs::read_to_string(path).map_err(|reason| MapFileError::Read {
        path: path.to_owned(),
        reason,
        remedy: "a map needs its camera: copy the sensor.yaml of the camera that took the keyframes"
            .to_owned(),
    })?;
    parse_camera(path, &text)
}

fn parse_camera(path: &Path, text: &str) -> Result<Camera, MapFileError> {
    let fail = |problem: String| {
        MapFileError::file(
            path,
            problem,
            "it needs resolution: [width, height], intrinsics: [fu, fv, cu, cv], distortion_model: \
             radial-tangential, equidistant, fov or none, and distortion_coefficients",
        )
    };
    // OpenCV's header `%YAML:1.0` is no YAML directive, and YAML knows no tabs.
    let lines = text.lines().filter(|line| !line.starts_with('%'));
    let body = lines.collect::<Vec<_>>().join("\n").replace('\t', " ");
    let yaml: CameraYaml = serde_saphyr::from_str(&body).map_err(|error| fail(error.to_string()))?;
    if yaml.camera_model != "pinhole" {
        return Err(fail(format!("camera_model {:?} is not known, only pinhole", yaml.camera_model)));
    }
    let [fu, fv, cu, cv] = yaml.intrinsics;
    let camera = Camera {
        width: yaml.resolution[0],
        height: yaml.resolution[1],
        focal: [fu, fv],
        centre: [cu, cv],
        distortion: distortion(&yaml.distortion_model, &yaml.distortion_coefficients).map_err(&fail)?,
    };
    camera.validate().map_err(|error| fail(error.to_string()))?;
    Ok(camera)
}

fn distortion(model: &str, coefficients: &[f64]) -> Result<Distortion, String> {
    let count = |wanted: usize| {
        format!("distortion {model} has {} coefficients, expected {wanted}", coefficients.len())
    };
    match model.to_ascii_lowercase().as_str() {
        "none" => Ok(Distortion::None),
        "radial-tangential" | "radtan" | "plumb_bob" => {
            Ok(Distortion::RadialTangential(coefficients.try_into().map_err(|_| count(4))?))
        }
        "equidistant" => Ok(Distortion::Equidistant(coefficients.try_into().map_err(|_| count(4))?)),
        "fov" => match coefficients {
            [omega] => Ok(Distortion::Fov(*omega)),
            _ => Err(count(1)),
        },
        _ => Err(format!("distortion_model {model:?} is not known")),
    }
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
