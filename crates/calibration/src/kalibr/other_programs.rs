//! Calibration files of other programs beside those in `rigs`: Kimera's are read, the others are told apart to say what they are.
//!
//! Kimera has one file a sensor with the entries of EuRoC's `sensor.yaml`: `LeftCameraParams.yaml`, `RightCameraParams.yaml`,
//! `ImuParams.yaml`.

use super::{CameraChain, read_text};
use crate::sensor_yaml::read_camera;
use crate::yaml::{checked_time_shift, parse};
use crate::{CalibrationError, relative_time_shifts};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Kimera's file of the IMU.
const KIMERA_IMU: &str = "ImuParams.yaml";
/// What the names of the left and the right camera's file have in the same place.
const SIDES: [(&str, &str); 3] = [("Left", "Right"), ("left", "right"), ("cam0", "cam1")];

/// Entries that only one program writes, at the beginning of a line, and what the file is.
const PROGRAMS: [(&[&str], &str); 5] = [
    (
        &["Camera.type:", "Camera1.fx:", "Camera.fx:"],
        "settings of ORB-SLAM3 of an older version, or without an IMU",
    ),
    (
        &["body_T_cam0:", "imu_topic:", "estimate_extrinsic:", "acc_n:"],
        "a configuration of VINS-Mono or VINS-Fusion",
    ),
    (
        &["relative_config_imu:", "relative_config_imucam:"],
        "OpenVINS's estimator_config.yaml; its kalibr_imucam_chain.yaml is read",
    ),
    (&["cameras:", "camera_parameters:"], "a configuration of OKVIS2 or maplab"),
    (
        &["image_width:", "camera_name:"],
        "the calibration of one camera by ROS's camera_calibration, without the IMU",
    ),
];

#[derive(Deserialize)]
struct ShiftYaml {
    #[serde(default)]
    imu_time_shift: f64,
}

fn has(text: &str, entry: &str) -> bool {
    text.lines().any(|line| line.starts_with(entry))
}

/// Whether a text is Kimera's or EuRoC's file of one camera.
pub(super) fn is_kimera_camera(text: &str) -> bool {
    has(text, "T_BS:") && has(text, "intrinsics:") && has(text, "camera_model:")
}

/// Whether it is Kimera's file of the left camera.
pub fn is_kimera_left(text: &str) -> bool {
    is_kimera_camera(text) && text.lines().any(|line| line.starts_with("camera_id:") && line.contains("left"))
}

/// Whether a text is Kimera's file of the IMU.
pub(super) fn is_kimera_imu(text: &str) -> bool {
    has(text, "imu_preintegration_type:") && has(text, "gyroscope_noise_density:")
}

/// Says what a file of another program is.
///
/// # Errors
/// [`CalibrationError::Entry`] for a known program's file.
pub(super) fn check(path: &Path, text: &str) -> Result<(), CalibrationError> {
    let of = |(entries, what): &(&[&str], &'static str)| {
        entries.iter().any(|entry| has(text, entry)).then_some(*what)
    };
    let Some(what) = PROGRAMS.iter().find_map(of) else { return Ok(()) };
    Err(CalibrationError::entry(
        path,
        format!(
            "this is {what}: write its numbers into Kalibr's camchain-imucam.yaml (of each camera: camera_model, intrinsics, \
             distortion_model, distortion_coeffs, resolution, T_cam_imu) and imu.yaml (the four noise densities, update_rate)"
        ),
    ))
}

/// Reads Kimera's files of one or two cameras.
///
/// # Arguments
/// * `path`: of the left camera; that of the right one and the IMU's are beside it.
///
/// # Errors
/// [`CalibrationError`] with the file.
pub(super) fn read_kimera_cameras(path: &Path, count: usize) -> Result<CameraChain, CalibrationError> {
    let mut paths = vec![path.to_path_buf()];
    if count > 1 {
        paths.push(right_of(path)?);
    }
    let mut sensors = paths.iter().map(|path| read_camera(path)).collect::<Result<Vec<_>, _>>()?;
    // A sensor.yaml of EuRoC's layout is read, too, which states the shift by itself.
    let stated_ns = relative_time_shifts(&mut sensors);
    let time_offset_ns = time_offset_ns(&path.with_file_name(KIMERA_IMU))?.unwrap_or(stated_ns);
    Ok(CameraChain {
        readouts_s: sensors.iter().map(|sensor| sensor.readout_s).collect(),
        time_shifts_s: sensors.iter().map(|sensor| sensor.time_shift_s).collect(),
        cameras: sensors.into_iter().map(|sensor| (sensor.camera, sensor.imu_from_camera)).collect(),
        time_offset_ns,
    })
}

/// The file of the right camera.
fn right_of(path: &Path) -> Result<PathBuf, CalibrationError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let other =
        SIDES.iter().find(|(left, _)| name.contains(left)).map(|(left, right)| name.replacen(left, right, 1));
    let right = other.map(|other| path.with_file_name(other)).filter(|right| right.is_file());
    right.ok_or_else(|| {
        CalibrationError::entry(
            path,
            "it is the calibration of one camera, but the recording has two: lay the right camera's beside it \
             (LeftCameraParams.yaml and RightCameraParams.yaml), or use one camera (of a bag, name it with --camera-topic)",
        )
    })
}

/// Kimera's `t_imu = t_cam + imu_time_shift`, where its file of the IMU is there.
fn time_offset_ns(path: &Path) -> Result<Option<i64>, CalibrationError> {
    if !path.is_file() {
        return Ok(None);
    }
    let ShiftYaml { imu_time_shift: shift } = parse(path, KIMERA_IMU, &read_text(path)?)?;
    Ok(Some((checked_time_shift(path, "imu_time_shift", shift)? * 1e9).round() as i64))
}
