//! The header of a session file: who recorded it, with which sensors, and how numbers are rounded.

use std::path::Path;

use calibration::sensor_yaml::{camera_of_text, imu_of_text, text_of_camera, text_of_imu};
use calibration::{CameraSensor, ImuSensor};
use serde::{Deserialize, Serialize};
use types::ImuNoise;

use crate::error::HandInError;

/// Readings are rounded to this part of the standard deviation of their white noise. Rounding has the variance `step^2 / 12`, a
/// 192nd part of that of the noise.
const STEP_PER_SIGMA: f64 = 0.25;
/// Steps of readings whose noise is not stated, or not believable (rad/s, m/s^2).
const DEFAULT_STEPS: [f64; 2] = [1e-4, 1e-3];
/// Least and largest step.
const STEP_LIMITS: [f64; 2] = [1e-7, 0.1];
/// Most bytes of a name.
const MAX_NAME_BYTES: usize = 256;
/// Most cameras.
const MAX_CAMERAS: usize = 64;

/// What holds for a whole session.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Name of the robot.
    pub robot: String,
    /// Name of the session, for display.
    pub name: String,
    /// The program that recorded it, with its version.
    pub program: String,
    /// When it began by the robot's clock, seconds since 1970.
    pub started_unix_s: u64,
    /// The IMU.
    pub imu: ImuSensor,
    /// The cameras.
    pub cameras: Vec<CameraSensor>,
}

impl Header {
    /// What readings are rounded to: of the gyroscope (rad/s) and of the accelerometer (m/s^2).
    pub(crate) fn steps(&self) -> [f64; 2] {
        steps(&self.imu.noise, self.imu.rate_hz)
    }
}

/// See [`Header::steps`].
fn steps(noise: &ImuNoise, rate_hz: f64) -> [f64; 2] {
    let step = |density: f64, default: f64| {
        let step = STEP_PER_SIGMA * density * rate_hz.sqrt();
        let [least, most] = STEP_LIMITS;
        if step.is_finite() && step > 0.0 { step.clamp(least, most) } else { default }
    };
    [step(noise.gyroscope, DEFAULT_STEPS[0]), step(noise.accelerometer, DEFAULT_STEPS[1])]
}

/// How a header is written. Calibrations are the texts of `sensor.yaml` files.
#[derive(Deserialize, Serialize)]
struct Written {
    robot: String,
    name: String,
    program: String,
    started_unix_s: u64,
    gyroscope_step_rad_s: f64,
    accelerometer_step_m_s2: f64,
    imu: String,
    cameras: Vec<String>,
}

/// The bytes of a header.
pub(crate) fn encode(header: &Header) -> Result<Vec<u8>, serde_json::Error> {
    let [gyroscope_step_rad_s, accelerometer_step_m_s2] = header.steps();
    serde_json::to_vec(&Written {
        robot: header.robot.clone(),
        name: header.name.clone(),
        program: header.program.clone(),
        started_unix_s: header.started_unix_s,
        gyroscope_step_rad_s,
        accelerometer_step_m_s2,
        imu: text_of_imu(&header.imu),
        cameras: header.cameras.iter().map(text_of_camera).collect(),
    })
}

/// The header of some bytes, and its steps.
pub(crate) fn decode(path: &Path, bytes: &[u8]) -> Result<(Header, [f64; 2]), HandInError> {
    let written: Written = serde_json::from_slice(bytes)
        .map_err(|source| HandInError::Header { path: path.to_owned(), source })?;
    let wrong = |problem| HandInError::HeaderValue { path: path.to_owned(), problem };
    let names = [&written.robot, &written.name, &written.program];
    if names.iter().any(|name| name.len() > MAX_NAME_BYTES || name.chars().any(char::is_control)) {
        return Err(wrong("a name has more than 256 bytes or control characters"));
    }
    let steps = [written.gyroscope_step_rad_s, written.accelerometer_step_m_s2];
    if steps.iter().any(|step| !(step.is_finite() && *step > 0.0)) {
        return Err(wrong("the steps of readings are not positive"));
    }
    if written.cameras.is_empty() || written.cameras.len() > MAX_CAMERAS {
        return Err(wrong("there is no camera, or more than 64"));
    }
    let calibration = |source| HandInError::Calibration { path: path.to_owned(), source };
    let imu = imu_of_text(&path.join("imu0"), &written.imu).map_err(calibration)?;
    let cameras = written
        .cameras
        .iter()
        .enumerate()
        .map(|(index, text)| camera_of_text(&path.join(format!("cam{index}")), text))
        .collect::<Result<_, _>>()
        .map_err(calibration)?;
    let header = Header {
        robot: written.robot,
        name: written.name,
        program: written.program,
        started_unix_s: written.started_unix_s,
        imu,
        cameras,
    };
    Ok((header, steps))
}
