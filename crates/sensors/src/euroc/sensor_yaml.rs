//! `sensor.yaml`: intrinsics, extrinsics and noise of a sensor.
//!
//! EuRoC's files are OpenCV YAML: a `%YAML:1.0` line, tabs and tags that standard YAML does not allow are removed
//! first. The body frame is the IMU's, as in EuRoC.

use crate::{CameraSensor, ImuNoise, ImuSensor, SequenceError};
use geometry::camera::{Camera, Distortion};
use geometry::pose::Pose;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use std::path::Path;

/// Largest entry of `R' R - I` for the rotation R of `T_BS`; EuRoC rounds to 12 decimals, hand-written files to 4.
const ROTATION_TOLERANCE: f64 = 1e-3;
/// Largest distance of the IMU from the body frame (metres, radians): they are meant to be the same.
const BODY_TOLERANCE: f64 = 1e-6;

#[derive(Deserialize)]
struct Matrix4Yaml {
    data: Vec<f64>,
}

#[derive(Deserialize)]
struct ImuYaml {
    #[serde(rename = "T_BS")]
    body_from_sensor: Option<Matrix4Yaml>,
    rate_hz: f64,
    gravity_magnitude: Option<f64>,
    gyroscope_noise_density: f64,
    gyroscope_random_walk: f64,
    accelerometer_noise_density: f64,
    accelerometer_random_walk: f64,
}

/// Extrinsics and rate of a camera.
#[derive(Deserialize)]
struct MountYaml {
    #[serde(rename = "T_BS")]
    body_from_sensor: Matrix4Yaml,
    rate_hz: f64,
}

/// Intrinsics and distortion of a camera.
#[derive(Deserialize)]
struct IntrinsicsYaml {
    resolution: [u32; 2],
    #[serde(default)]
    camera_model: Option<String>,
    intrinsics: [f64; 4],
    #[serde(default)]
    distortion_model: Option<String>,
    #[serde(default)]
    distortion_coefficients: Vec<f64>,
}

/// Reads the IMU's `sensor.yaml`.
pub(crate) fn read_imu(path: &Path) -> Result<ImuSensor, SequenceError> {
    let yaml: ImuYaml = read_yaml(path)?;
    if let Some(matrix) = &yaml.body_from_sensor {
        let pose = pose_from_matrix(path, &matrix.data)?;
        if pose.rotation.angle() > BODY_TOLERANCE || pose.translation.norm() > BODY_TOLERANCE {
            return Err(SequenceError::calibration(
                path,
                "T_BS is not the identity, but the body frame is the IMU's here: \
                 give the cameras' T_BS and the ground truth with respect to the IMU",
            ));
        }
    }
    let mut noise = ImuNoise::default();
    noise.gyroscope = yaml.gyroscope_noise_density;
    noise.gyroscope_walk = yaml.gyroscope_random_walk;
    noise.accelerometer = yaml.accelerometer_noise_density;
    noise.accelerometer_walk = yaml.accelerometer_random_walk;
    let positive = [
        ("rate_hz", yaml.rate_hz),
        ("gyroscope_noise_density", noise.gyroscope),
        ("gyroscope_random_walk", noise.gyroscope_walk),
        ("accelerometer_noise_density", noise.accelerometer),
        ("accelerometer_random_walk", noise.accelerometer_walk),
        ("gravity_magnitude", yaml.gravity_magnitude.unwrap_or(1.0)),
    ];
    for (name, value) in positive {
        check_positive(path, name, value)?;
    }
    Ok(ImuSensor { noise, rate_hz: yaml.rate_hz, gravity_magnitude: yaml.gravity_magnitude })
}

/// Reads a camera's `sensor.yaml`.
pub(crate) fn read_camera(path: &Path) -> Result<CameraSensor, SequenceError> {
    let camera = read_lens(path)?;
    let mount: MountYaml = read_yaml(path)?;
    check_positive(path, "rate_hz", mount.rate_hz)?;
    let imu_from_camera = pose_from_matrix(path, &mount.body_from_sensor.data)?;
    Ok(CameraSensor { camera, imu_from_camera, rate_hz: mount.rate_hz })
}

/// Reads the projection of a camera's `sensor.yaml`: resolution, intrinsics and distortion, without the extrinsics.
///
/// # Errors
/// [`SequenceError`] with the file: it is missing, an entry is missing or wrong, or the model is unknown.
pub fn read_lens(path: &Path) -> Result<Camera, SequenceError> {
    let yaml: IntrinsicsYaml = read_yaml(path)?;
    if let Some(model) = yaml.camera_model.as_deref().filter(|model| *model != "pinhole") {
        return Err(SequenceError::calibration(
            path,
            format!("camera_model \"{model}\" is unknown: pinhole is the only one"),
        ));
    }
    let [fu, fv, cu, cv] = yaml.intrinsics;
    let camera = Camera {
        width: yaml.resolution[0],
        height: yaml.resolution[1],
        focal: [fu, fv],
        centre: [cu, cv],
        distortion: distortion(path, yaml.distortion_model.as_deref(), &yaml.distortion_coefficients)?,
    };
    camera.validate().map_err(|error| SequenceError::calibration(path, error.to_string()))?;
    Ok(camera)
}

fn distortion(path: &Path, model: Option<&str>, given: &[f64]) -> Result<Distortion, SequenceError> {
    let model = model.unwrap_or("none").trim();
    let wrong_count = |wanted: usize| {
        let counts = format!("{model} takes {wanted} distortion_coefficients, {} are given", given.len());
        SequenceError::calibration(path, counts)
    };
    match model {
        "" | "none" => {
            let none = given.iter().all(|value| *value == 0.0);
            none.then_some(Distortion::None).ok_or_else(|| wrong_count(0))
        }
        "radial-tangential" | "radtan" | "plumb_bob" => {
            given.try_into().map(Distortion::RadialTangential).map_err(|_| wrong_count(4))
        }
        "equidistant" => given.try_into().map(Distortion::Equidistant).map_err(|_| wrong_count(4)),
        "fov" => match given {
            [omega] => Ok(Distortion::Fov(*omega)),
            _ => Err(wrong_count(1)),
        },
        _ => Err(SequenceError::calibration(
            path,
            format!(
                "distortion_model \"{model}\" is unknown: use none, radial-tangential, equidistant or fov"
            ),
        )),
    }
}

fn check_positive(path: &Path, name: &str, value: f64) -> Result<(), SequenceError> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(SequenceError::calibration(path, format!("{name} is {value}, but must be a positive number")))
}

/// A row-major 4x4 matrix as a pose.
fn pose_from_matrix(path: &Path, data: &[f64]) -> Result<Pose, SequenceError> {
    let wrong = |problem: &str| SequenceError::calibration(path, format!("T_BS: {problem}"));
    if data.len() != 16 || data.iter().any(|value| !value.is_finite()) {
        return Err(wrong("it must hold 16 finite numbers, row by row"));
    }
    if data[12..] != [0.0, 0.0, 0.0, 1.0] {
        return Err(wrong("its last row must be 0, 0, 0, 1"));
    }
    let matrix =
        Matrix3::new(data[0], data[1], data[2], data[4], data[5], data[6], data[8], data[9], data[10]);
    let off = (matrix.transpose() * matrix - Matrix3::identity()).amax();
    if off > ROTATION_TOLERANCE || matrix.determinant() < 0.0 {
        return Err(wrong("its upper left 3x3 block is not a rotation"));
    }
    let rounded = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    let rotation = UnitQuaternion::new_normalize(rounded.into_inner());
    Ok(Pose::new(rotation, Vector3::new(data[3], data[7], data[11])))
}

fn read_yaml<T: for<'de> Deserialize<'de>>(path: &Path) -> Result<T, SequenceError> {
    let text = std::fs::read_to_string(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => {
            SequenceError::missing(path, "it holds the sensor's calibration; write it in the EuRoC layout")
        }
        _ => SequenceError::io(path, source),
    })?;
    serde_saphyr::from_str(&plain_yaml(&text))
        .map_err(|error| SequenceError::calibration(path, format!("it is not a valid sensor.yaml: {error}")))
}

/// OpenCV's dialect as YAML, line for line, so that the line numbers in errors are right.
fn plain_yaml(text: &str) -> String {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    text.lines()
        .map(|line| match line {
            _ if line.starts_with('%') || line.trim_end() == "---" => "\n".to_owned(),
            _ => line.replace('\t', "  ").replace("!!opencv-matrix", "") + "\n",
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opencv_dialect_becomes_yaml_line_for_line() {
        let text = "%YAML:1.0\n---\nT_BS: !!opencv-matrix\n\tdata: [1,\t2]\t# two\n";
        assert_eq!(plain_yaml(text), "\n\nT_BS: \n  data: [1,  2]  # two\n");
    }

    #[test]
    fn every_distortion_model_wants_its_coefficients() {
        let path = Path::new("sensor.yaml");
        assert_eq!(distortion(path, None, &[]).unwrap(), Distortion::None);
        assert_eq!(distortion(path, Some("none"), &[0.0]).unwrap(), Distortion::None);
        assert_eq!(distortion(path, Some("fov"), &[0.9]).unwrap(), Distortion::Fov(0.9));
        let four = [0.1, 0.2, 0.3, 0.4];
        assert_eq!(distortion(path, Some("equidistant"), &four).unwrap(), Distortion::Equidistant(four));
        assert_eq!(
            distortion(path, Some("radial-tangential"), &four).unwrap(),
            Distortion::RadialTangential(four)
        );
        for (model, given) in
            [("none", &four[..]), ("fov", &four), ("equidistant", &four[..3]), ("mei", &four)]
        {
            assert!(distortion(path, Some(model), given).is_err(), "{model}");
        }
    }

    #[test]
    fn a_matrix_that_is_no_rotation_is_refused() {
        let path = Path::new("sensor.yaml");
        let mirror = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., -1., 0., 0., 0., 0., 1.];
        assert!(pose_from_matrix(path, &mirror).is_err());
        assert!(pose_from_matrix(path, &mirror[..15]).is_err());
        let mut scaled = mirror;
        scaled[10] = 1.1;
        assert!(pose_from_matrix(path, &scaled).is_err());
        scaled[10] = f64::NAN;
        assert!(pose_from_matrix(path, &scaled).is_err());
    }
}
