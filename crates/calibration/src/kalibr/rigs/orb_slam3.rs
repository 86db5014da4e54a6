//! Settings of ORB-SLAM3 with `File.version` 1.0: two cameras as they are, not the rectified ones of older files.

use super::Rig;
use crate::CalibrationError;
use crate::yaml::{Lens, MatrixYaml, check_positive, parse, pose_from_matrix};
use geometry::camera::Camera;
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::collections::BTreeMap;
use std::path::Path;

const KIND: &str = "settings file of ORB-SLAM3";
/// `imu_from_camera` of camera 1.
const IMU_FROM_FIRST: &str = "IMU.T_b_c1";
/// Takes coordinates of camera 2 to those of camera 1.
const FIRST_FROM_SECOND: &str = "Stereo.T_c1_c2";

#[derive(Deserialize)]
#[serde(untagged)]
enum Entry {
    Number(f64),
    Text(String),
    Matrix(MatrixYaml),
    Other(IgnoredAny),
}

struct Settings<'a> {
    path: &'a Path,
    entries: BTreeMap<String, Entry>,
}

pub(super) fn is_settings(text: &str) -> bool {
    let has = |entry: &str| text.lines().any(|line| line.starts_with(entry));
    has("Camera1.fx:") && has("Camera.type:") && has(IMU_FROM_FIRST)
}

pub(super) fn read(path: &Path, text: &str) -> Result<Rig, CalibrationError> {
    let settings = Settings { path, entries: parse(path, KIND, text)? };
    let imu_from_first = settings.pose(IMU_FROM_FIRST)?;
    let mut cameras = vec![(settings.camera("Camera1")?, imu_from_first)];
    if settings.entries.contains_key("Camera2.fx") {
        cameras.push((settings.camera("Camera2")?, imu_from_first * settings.pose(FIRST_FROM_SECOND)?));
    }
    let rate_hz = settings.number("IMU.Frequency")?;
    check_positive(path, "IMU.Frequency", rate_hz)?;
    let mut densities =
        [("IMU.NoiseGyro", 0.0), ("IMU.GyroWalk", 0.0), ("IMU.NoiseAcc", 0.0), ("IMU.AccWalk", 0.0)];
    for (name, value) in &mut densities {
        *value = settings.number(name)?;
    }
    Ok(Rig { cameras, time_offset_ns: 0, imu: super::imu(path, rate_hz, densities)? })
}

impl Settings<'_> {
    fn wrong(&self, problem: String) -> CalibrationError {
        CalibrationError::entry(self.path, problem)
    }

    fn optional(&self, name: &str) -> Option<f64> {
        match self.entries.get(name) {
            Some(Entry::Number(value)) => Some(*value),
            _ => None,
        }
    }

    fn number(&self, name: &str) -> Result<f64, CalibrationError> {
        self.optional(name).ok_or_else(|| self.wrong(format!("{name} is missing, or no number")))
    }

    fn pose(&self, name: &str) -> Result<geometry::pose::Pose, CalibrationError> {
        match self.entries.get(name) {
            Some(Entry::Matrix(matrix)) => pose_from_matrix(self.path, name, matrix.numbers()),
            _ => Err(self.wrong(format!("{name} is missing, or no matrix"))),
        }
    }

    fn side(&self, name: &str) -> Result<u32, CalibrationError> {
        let pixels = self.number(name)?;
        let is_whole = pixels.fract() == 0.0 && (1.0..=f64::from(u16::MAX)).contains(&pixels);
        is_whole
            .then_some(pixels as u32)
            .ok_or_else(|| self.wrong(format!("{name} is {pixels}, and no number of pixels")))
    }

    /// # Arguments
    /// * `name`: `Camera1` or `Camera2`.
    fn camera(&self, name: &str) -> Result<Camera, CalibrationError> {
        let of = |entry: &str| format!("{name}.{entry}");
        let (model, coefficients): (_, &[&str]) = match self.entries.get("Camera.type") {
            Some(Entry::Text(kind)) if kind == "PinHole" => ("radtan", &["k1", "k2", "p1", "p2", "k3"]),
            Some(Entry::Text(kind)) if kind == "KannalaBrandt8" => ("equidistant", &["k1", "k2", "k3", "k4"]),
            _ => {
                return Err(self.wrong(
                    "Camera.type is neither PinHole nor KannalaBrandt8: give the calibration of the images as they were recorded, before \
                     rectification"
                        .to_owned(),
                ));
            }
        };
        let mut intrinsics = [0.0; 4];
        for (value, entry) in intrinsics.iter_mut().zip(["fx", "fy", "cx", "cy"]) {
            *value = self.number(&of(entry))?;
        }
        // Coefficients that are left out are zero.
        let distortion: Vec<f64> =
            coefficients.iter().map(|entry| self.optional(&of(entry)).unwrap_or(0.0)).collect();
        let lens = Lens {
            resolution: [self.side("Camera.width")?, self.side("Camera.height")?],
            camera_model: None,
            intrinsics: &intrinsics,
            distortion_model: Some(model),
            distortion: &distortion,
            distortion_key: "coefficients",
        };
        lens.camera(self.path)
    }
}
