//! Calibrations of Basalt: JSON with `T_imu_cam`, cameras, and continuous-time noise.
//!
//! | `camera_type` | here |
//! |---|---|
//! | `pinhole`, `kb4` | without distortion, equidistant |
//! | `pinhole-radtan8` | rational with 8 coefficients; `rpmax`, the largest radius, is not used: the model's own region is |
//! | `ds`, `eucm`; `ucm` | double sphere, extended unified; the latter with `beta = 1` |

use super::Rig;
use crate::CalibrationError;
use crate::mount::checked_mount;
use crate::yaml::{Lens, check_positive, parse};
use geometry::camera::Camera;
use geometry::pose::Pose;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

const KIND: &str = "calibration of Basalt";
/// Scale and misalignment of the IMU below this do not matter.
const IDEAL: f64 = 5e-3;
/// Numbers of `calib_accel_bias` and `calib_gyro_bias` that are the bias; the others are scale and misalignment.
const BIAS: usize = 3;
/// Quaternions are normalized up to this.
const NORM_TOLERANCE: f64 = 1e-3;

#[derive(Deserialize)]
struct File {
    value0: Calibration,
}

#[derive(Deserialize)]
struct Calibration {
    #[serde(rename = "T_imu_cam")]
    imu_from_cameras: Vec<Transform>,
    intrinsics: Vec<Intrinsics>,
    resolution: Vec<[u32; 2]>,
    imu_update_rate: f64,
    gyro_noise_std: Vec<f64>,
    gyro_bias_std: Vec<f64>,
    accel_noise_std: Vec<f64>,
    accel_bias_std: Vec<f64>,
    #[serde(default)]
    cam_time_offset_ns: i64,
    #[serde(default)]
    calib_accel_bias: Vec<f64>,
    #[serde(default)]
    calib_gyro_bias: Vec<f64>,
}

#[derive(Deserialize)]
struct Transform {
    px: f64,
    py: f64,
    pz: f64,
    qx: f64,
    qy: f64,
    qz: f64,
    qw: f64,
}

#[derive(Deserialize)]
struct Intrinsics {
    camera_type: String,
    intrinsics: BTreeMap<String, f64>,
}

pub(super) fn is_calibration(text: &str) -> bool {
    text.contains("\"value0\"") && text.contains("\"T_imu_cam\"")
}

pub(super) fn read(path: &Path, text: &str) -> Result<Rig, CalibrationError> {
    let calibration = parse::<File>(path, KIND, text)?.value0;
    let wrong = |problem: String| CalibrationError::entry(path, problem);
    let count = calibration.imu_from_cameras.len();
    if count == 0 || calibration.intrinsics.len() != count || calibration.resolution.len() != count {
        return Err(wrong("T_imu_cam, intrinsics and resolution are not of equally many cameras".to_owned()));
    }
    let mut cameras = Vec::new();
    for (index, transform) in calibration.imu_from_cameras.iter().enumerate() {
        let pose = transform.pose().ok_or_else(|| {
            wrong(format!("T_imu_cam of camera {index} is no pose: its quaternion is not of length 1"))
        })?;
        checked_mount(path, &format!("T_imu_cam of camera {index}"), &pose)?;
        cameras.push((calibration.intrinsics[index].camera(path, calibration.resolution[index])?, pose));
    }
    check_positive(path, "imu_update_rate", calibration.imu_update_rate)?;
    let is_ideal = |entries: &[f64]| entries.iter().skip(BIAS).all(|entry| entry.abs() < IDEAL);
    if !is_ideal(&calibration.calib_accel_bias) || !is_ideal(&calibration.calib_gyro_bias) {
        tracing::warn!(
            "{}: scale and misalignment of the IMU (calib_accel_bias, calib_gyro_bias) are not applied to its readings",
            path.display()
        );
    }
    let largest = |values: &[f64]| values.iter().copied().fold(f64::NAN, f64::max);
    let densities = [
        ("gyro_noise_std", largest(&calibration.gyro_noise_std)),
        ("gyro_bias_std", largest(&calibration.gyro_bias_std)),
        ("accel_noise_std", largest(&calibration.accel_noise_std)),
        ("accel_bias_std", largest(&calibration.accel_bias_std)),
    ];
    let imu = super::imu(path, calibration.imu_update_rate, densities)?;
    Ok(Rig { cameras, time_offset_ns: calibration.cam_time_offset_ns, imu })
}

impl Transform {
    fn pose(&self) -> Option<Pose> {
        let rotation = Quaternion::new(self.qw, self.qx, self.qy, self.qz);
        let is_unit = (rotation.norm() - 1.0).abs() < NORM_TOLERANCE;
        let translation = Vector3::new(self.px, self.py, self.pz);
        (is_unit && translation.iter().all(|value| value.is_finite()))
            .then(|| Pose::new(UnitQuaternion::new_normalize(rotation), translation))
    }
}

impl Intrinsics {
    fn camera(&self, path: &Path, resolution: [u32; 2]) -> Result<Camera, CalibrationError> {
        let (camera_model, model, before, names): (_, _, &[&str], &[&str]) = match self.camera_type.as_str() {
            "pinhole" => ("pinhole", "none", &[], &[]),
            "kb4" => ("pinhole", "equidistant", &[], &["k1", "k2", "k3", "k4"]),
            "pinhole-radtan8" => {
                ("pinhole", "radtan", &[], &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"])
            }
            "ds" => ("ds", "none", &["xi", "alpha"], &[]),
            "eucm" => ("eucm", "none", &["alpha", "beta"], &[]),
            "ucm" => ("eucm", "none", &["alpha"], &[]),
            other => {
                let problem = format!(
                    "camera_type \"{other}\" is not read: pinhole, pinhole-radtan8, kb4, ds, eucm and ucm are; calibrate with one of these"
                );
                return Err(CalibrationError::entry(path, problem));
            }
        };
        let value = |name: &&str| match (*name, self.intrinsics.get(*name)) {
            (_, Some(value)) => *value,
            // Calibrations with four coefficients have no others.
            ("k3" | "k4" | "k5" | "k6", None) if self.camera_type == "pinhole-radtan8" => 0.0,
            (_, None) => f64::NAN,
        };
        let mut intrinsics: Vec<f64> = before.iter().map(value).collect();
        if self.camera_type == "ucm" {
            intrinsics.push(1.0);
        }
        intrinsics.extend(["fx", "fy", "cx", "cy"].iter().map(value));
        let distortion: Vec<f64> = names.iter().map(value).collect();
        let lens = Lens {
            resolution,
            camera_model: Some(camera_model),
            intrinsics: &intrinsics,
            distortion_model: Some(model),
            distortion: &distortion,
            distortion_key: "coefficients",
        };
        lens.camera(path)
    }
}
