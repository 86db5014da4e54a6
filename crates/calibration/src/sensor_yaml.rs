//! `sensor.yaml`: intrinsics, extrinsics and noise of a sensor.
//!
//! EuRoC's files are OpenCV YAML: a `%YAML:1.0` line, tabs and tags that standard YAML does not allow are removed
//! first. The body frame is the IMU's, as in EuRoC.

use crate::mount::checked_mount;
use crate::yaml::{
    Lens, NoiseYaml, check_positive, checked_time_shift, parse, pose_from_matrix, projection_yaml, read_text,
    readout_time,
};
use crate::{CalibrationError, CameraSensor, GnssSensor, ImuSensor, kalibr};
use geometry::camera::Camera;
use geometry::{Geodetic, Pose};
use nalgebra::{UnitQuaternion, Vector3};
use serde::Deserialize;
use std::fmt::Write as _;
use std::path::Path;

/// Largest distance of the IMU from the body frame (metres, radians): they are meant to be the same.
const BODY_TOLERANCE: f64 = 1e-6;
const KIND: &str = "sensor.yaml";

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
}

/// Extrinsics, rate and shutter of a camera.
#[derive(Deserialize)]
struct MountYaml {
    #[serde(rename = "T_BS")]
    body_from_sensor: Matrix4Yaml,
    rate_hz: f64,
    #[serde(default)]
    line_delay: f64,
    #[serde(default)]
    timeshift_cam_imu: f64,
}

/// Antenna, frame and noise of GNSS.
#[derive(Deserialize)]
struct GnssYaml {
    antenna: [f64; 3],
    origin: Option<[f64; 3]>,
    noise: Option<[f64; 3]>,
    correlation_time: Option<f64>,
}

/// Intrinsics and distortion of a camera.
#[derive(Deserialize)]
struct IntrinsicsYaml {
    resolution: [u32; 2],
    #[serde(default)]
    camera_model: Option<String>,
    intrinsics: Vec<f64>,
    #[serde(default)]
    distortion_model: Option<String>,
    #[serde(default)]
    distortion_coefficients: Vec<f64>,
}

/// Reads the IMU's `sensor.yaml`.
///
/// # Errors
/// [`CalibrationError`] with the file: it is missing, or an entry is missing or wrong.
pub fn read_imu(path: &Path) -> Result<ImuSensor, CalibrationError> {
    imu_of_text(path, &read_text(path)?)
}

/// Reads the IMU from the text of such a file. `path`: what it is called in errors.
///
/// # Errors
/// [`CalibrationError`] with the file: it is missing, or an entry is missing or wrong.
pub fn imu_of_text(path: &Path, text: &str) -> Result<ImuSensor, CalibrationError> {
    let yaml: ImuYaml = parse(path, KIND, text)?;
    let noise: NoiseYaml = parse(path, KIND, text)?;
    if let Some(matrix) = &yaml.body_from_sensor {
        let pose = pose_from_matrix(path, "T_BS", &matrix.data)?;
        if pose.rotation.angle() > BODY_TOLERANCE || pose.translation.norm() > BODY_TOLERANCE {
            return Err(CalibrationError::entry(
                path,
                "T_BS is not the identity, but the body frame is the IMU's here: \
                 give the cameras' T_BS and the ground truth with respect to the IMU",
            ));
        }
    }
    let noise = noise.noise(path)?;
    check_positive(path, "rate_hz", yaml.rate_hz)?;
    check_positive(path, "gravity_magnitude", yaml.gravity_magnitude.unwrap_or(1.0))?;
    Ok(ImuSensor {
        noise,
        rate_hz: yaml.rate_hz,
        gravity_magnitude: yaml.gravity_magnitude,
        intrinsics: None,
    })
}

/// Reads a camera's `sensor.yaml`. Of a rolling shutter, `line_delay` is the time from row to row, seconds, as in Kalibr's files, and
/// `timeshift_cam_imu` what is added to the camera's stamps to obtain the IMU's, seconds, which here becomes `time_shift_s` as it is
/// ([`crate::relative_time_shifts`]).
///
/// # Errors
/// [`CalibrationError`] with the file: it is missing, or an entry is missing or wrong.
pub fn read_camera(path: &Path) -> Result<CameraSensor, CalibrationError> {
    camera_of_text(path, &read_text(path)?)
}

/// Reads a camera from the text of such a file. `path`: what it is called in errors.
///
/// # Errors
/// As [`read_camera`].
pub fn camera_of_text(path: &Path, text: &str) -> Result<CameraSensor, CalibrationError> {
    let camera = lens(path, text)?;
    let mount: MountYaml = parse(path, KIND, text)?;
    check_positive(path, "rate_hz", mount.rate_hz)?;
    let imu_from_camera = pose_from_matrix(path, "T_BS", &mount.body_from_sensor.data)?;
    let readout_s = readout_time(path, "line_delay", mount.line_delay, &camera)?;
    let time_shift_s = checked_time_shift(path, "timeshift_cam_imu", mount.timeshift_cam_imu)?;
    Ok(CameraSensor { camera, imu_from_camera, rate_hz: mount.rate_hz, readout_s, time_shift_s })
}

/// The text of the `sensor.yaml` of an IMU. Scale and misalignment are those of its readings, which are corrected already.
pub fn text_of_imu(imu: &ImuSensor) -> String {
    let mut text =
        format!("sensor_type: imu\n{}rate_hz: {}\n", text_of_mount(&Pose::identity()), imu.rate_hz);
    if let Some(gravity) = imu.gravity_magnitude {
        let _ = writeln!(text, "gravity_magnitude: {gravity}");
    }
    let noise = &imu.noise;
    let _ = writeln!(text, "gyroscope_noise_density: {}", noise.gyroscope);
    let _ = writeln!(text, "gyroscope_random_walk: {}", noise.gyroscope_walk);
    let _ = writeln!(text, "accelerometer_noise_density: {}", noise.accelerometer);
    let _ = writeln!(text, "accelerometer_random_walk: {}", noise.accelerometer_walk);
    text
}

/// The text of the `sensor.yaml` of a camera. A shift of its stamps that is no delay is in the stamps already, and not stated.
pub fn text_of_camera(sensor: &CameraSensor) -> String {
    let mut text = format!(
        "sensor_type: camera\n{}rate_hz: {}\n",
        text_of_mount(&sensor.imu_from_camera),
        sensor.rate_hz
    );
    if sensor.readout_s != 0.0 {
        let _ = writeln!(text, "line_delay: {}", sensor.readout_s / f64::from(sensor.camera.height));
    }
    if sensor.delay_s() != 0.0 {
        let _ = writeln!(text, "timeshift_cam_imu: {}", sensor.delay_s());
    }
    text + &projection_yaml(&sensor.camera)
}

fn text_of_mount(pose: &Pose) -> String {
    let rotation = pose.rotation.to_rotation_matrix();
    let mut text = String::from("T_BS:\n  cols: 4\n  rows: 4\n");
    for row in 0..3 {
        let cells = (0..3).map(|column| rotation[(row, column)].to_string() + ", ").collect::<String>();
        let opening = if row == 0 { "  data: [" } else { "         " };
        let _ = writeln!(text, "{opening}{cells}{},", pose.translation[row]);
    }
    text + "         0.0, 0.0, 0.0, 1.0]\n"
}

/// Reads the `sensor.yaml` of GNSS: `antenna` in the IMU's frame (m), and where they are known `origin`, latitude and longitude (deg) and
/// altitude (m) of the frame's, `noise`, east, north and up (m), and `correlation_time` (s).
///
/// # Errors
/// [`CalibrationError`] with the file: it is missing, or an entry is missing or wrong.
pub fn read_gnss(path: &Path) -> Result<GnssSensor, CalibrationError> {
    gnss_of_text(path, &read_text(path)?)
}

/// Reads GNSS from the text of such a file. `path`: what it is called in errors.
///
/// # Errors
/// As [`read_gnss`].
pub fn gnss_of_text(path: &Path, text: &str) -> Result<GnssSensor, CalibrationError> {
    let yaml: GnssYaml = parse(path, KIND, text)?;
    let antenna_in_imu = Vector3::from(yaml.antenna);
    checked_mount(path, "antenna", &Pose::new(UnitQuaternion::identity(), antenna_in_imu))?;
    let origin = yaml.origin.map(|[latitude_deg, longitude_deg, altitude_m]| Geodetic {
        latitude_deg,
        longitude_deg,
        altitude_m,
    });
    if origin.is_some_and(|origin| !origin.is_valid()) {
        let problem =
            "origin is no place on the earth: latitude and longitude in degrees, altitude in metres";
        return Err(CalibrationError::entry(path, problem));
    }
    for sigma in yaml.noise.iter().flatten() {
        check_positive(path, "noise", *sigma)?;
    }
    check_positive(path, "correlation_time", yaml.correlation_time.unwrap_or(1.0))?;
    let (sigma_m, correlation_time_s) = (yaml.noise.map(Vector3::from), yaml.correlation_time);
    Ok(GnssSensor { antenna_in_imu, origin, sigma_m, correlation_time_s })
}

/// Reads the projection of a camera: resolution, intrinsics and distortion, without the extrinsics.
///
/// The file is a camera's `sensor.yaml`, or a camera chain of Kalibr, of which `cam0` is taken.
///
/// # Errors
/// [`CalibrationError`] with the file: it is missing, an entry is missing or wrong, or the model is unknown.
pub fn read_lens(path: &Path) -> Result<Camera, CalibrationError> {
    lens_of_text(path, &read_text(path)?)
}

/// The projection of a camera from the text of such a file.
///
/// # Arguments
/// * `name`: of the text, for errors.
///
/// # Errors
/// [`CalibrationError::Entry`]: an entry is missing or wrong, or the model is unknown.
pub fn lens_of_text(name: &Path, text: &str) -> Result<Camera, CalibrationError> {
    if kalibr::is_camera_chain(text) || kalibr::is_rig(text) {
        kalibr::first_lens(name, text)
    } else {
        lens(name, text)
    }
}

fn lens(path: &Path, text: &str) -> Result<Camera, CalibrationError> {
    let yaml: IntrinsicsYaml = parse(path, KIND, text)?;
    let lens = Lens {
        resolution: yaml.resolution,
        camera_model: yaml.camera_model.as_deref(),
        intrinsics: &yaml.intrinsics,
        distortion_model: yaml.distortion_model.as_deref(),
        distortion: &yaml.distortion_coefficients,
        distortion_key: "distortion_coefficients",
    };
    lens.camera(path)
}
