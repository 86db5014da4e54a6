//! The IMU of Kalibr: `imu.yaml`, as it goes into Kalibr or as it comes out.
//!
//! | `model` | here |
//! |---|---|
//! | `calibrated`, or none | readings are taken as they are |
//! | `scale-misalignment` | `M` of `accelerometers`, and `M`, `C_gyro_i` and `A` of `gyroscopes` are [`ImuIntrinsics`] |
//! | `scale-misalignment-size-effect` | the same; `rx_i`, `ry_i` and `rz_i`, where the accelerometers are, are ignored below a centimetre |
//! | `kalibr`, `rpng` | OpenVINS's, with the matrices of an ideal IMU |

use super::{is_rig, other_programs, rigs};
use crate::yaml::{
    MatrixYaml, NoiseYaml, check_positive, parse, pose_from_matrix, read_text, rotation_of, square3,
};
use crate::{CalibrationError, ImuIntrinsics, ImuSensor};
use nalgebra::Matrix3;
use serde::Deserialize;
use std::path::Path;

/// Largest distance of the IMU from the body frame (metres, radians): they are meant to be the same.
const BODY_TOLERANCE: f64 = 1e-6;
/// Models of an IMU whose readings are taken as they are; OpenVINS's have matrices, which must be the identity.
const IDEAL_MODELS: [&str; 3] = ["calibrated", "kalibr", "rpng"];
const SCALED_MODEL: &str = "scale-misalignment";
const SIZE_MODEL: &str = "scale-misalignment-size-effect";
/// Accelerometers that are nearer to the origin of the IMU are taken to be there, metres: at 2 rad/s they differ by 0.04 m/s^2.
const MAX_SIZE_M: f64 = 0.01;

const IMU: &str = "imu.yaml of Kalibr";

/// `accelerometers` of a result.
#[derive(Deserialize)]
struct AccelerometersYaml {
    #[serde(rename = "M")]
    matrix: MatrixYaml,
    rx_i: Option<[f64; 3]>,
    ry_i: Option<[f64; 3]>,
    rz_i: Option<[f64; 3]>,
}

/// `gyroscopes` of a result.
#[derive(Deserialize)]
struct GyroscopesYaml {
    #[serde(rename = "M")]
    matrix: MatrixYaml,
    #[serde(rename = "A")]
    g_sensitivity: Option<MatrixYaml>,
    #[serde(rename = "C_gyro_i")]
    gyroscope_from_imu: Option<MatrixYaml>,
}

#[derive(Deserialize)]
struct ImuYaml {
    update_rate: Option<f64>,
    #[serde(rename = "T_i_b")]
    imu_from_body: Option<MatrixYaml>,
    #[serde(default)]
    model: Option<String>,
    /// OpenVINS's: matrices of gyroscope and accelerometer, rotations from the IMU to each, effect of gravity on the gyroscope.
    #[serde(rename = "Tw")]
    gyroscope: Option<MatrixYaml>,
    #[serde(rename = "Ta")]
    accelerometer: Option<MatrixYaml>,
    #[serde(rename = "R_IMUtoGYRO")]
    gyroscope_from_imu: Option<MatrixYaml>,
    #[serde(rename = "R_IMUtoACC")]
    accelerometer_from_imu: Option<MatrixYaml>,
    #[serde(rename = "Tg")]
    gravity_on_gyroscope: Option<MatrixYaml>,
    /// Kalibr's, of the models with scale and misalignment.
    accelerometers: Option<AccelerometersYaml>,
    gyroscopes: Option<GyroscopesYaml>,
    #[serde(flatten)]
    noise: NoiseYaml,
}

impl ImuYaml {
    /// Refuses scale and misalignment: readings are taken as those of an ideal IMU.
    fn check_ideal(&self, path: &Path) -> Result<(), CalibrationError> {
        let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        for (name, matrix, ideal) in [
            ("Tw", &self.gyroscope, identity),
            ("Ta", &self.accelerometer, identity),
            ("R_IMUtoGYRO", &self.gyroscope_from_imu, identity),
            ("R_IMUtoACC", &self.accelerometer_from_imu, identity),
            ("Tg", &self.gravity_on_gyroscope, [0.0; 9]),
        ] {
            if matrix.as_ref().is_some_and(|matrix| matrix.numbers() != ideal) {
                let should = if name == "Tg" { "zero" } else { "the identity" };
                return Err(CalibrationError::entry(
                    path,
                    format!(
                        "{name} is not {should}: OpenVINS's matrices are not applied to readings; calibrate with Kalibr's --imu-models \
                         scale-misalignment and give its imu.yaml, or correct the readings and state {should}"
                    ),
                ));
            }
        }
        Ok(())
    }

    /// Scale and misalignment of the models that have them.
    fn intrinsics(&self, path: &Path) -> Result<Option<ImuIntrinsics>, CalibrationError> {
        let model = self.model.as_deref().unwrap_or(IDEAL_MODELS[0]);
        let wrong = |problem: String| CalibrationError::entry(path, problem);
        if IDEAL_MODELS.contains(&model) {
            return Ok(None);
        }
        if ![SCALED_MODEL, SIZE_MODEL].contains(&model) {
            return Err(wrong(format!(
                "model \"{model}\" is unknown: known are calibrated, {SCALED_MODEL} and {SIZE_MODEL} (with identity matrices also \
                 OpenVINS's kalibr and rpng); calibrate with --imu-models {SCALED_MODEL}"
            )));
        }
        let (Some(accelerometers), Some(gyroscopes)) = (&self.accelerometers, &self.gyroscopes) else {
            return Err(wrong(format!(
                "model is {model}, but accelerometers (M) or gyroscopes (M, A, C_gyro_i) are missing: give the result of \
                 kalibr_calibrate_imu_camera, or state model: calibrated"
            )));
        };
        let rotation = |matrix: &MatrixYaml| rotation_of(path, "C_gyro_i", matrix.numbers());
        let g_sensitivity = |matrix: &MatrixYaml| square3(path, "A of gyroscopes", matrix.numbers());
        let intrinsics = ImuIntrinsics::new(
            square3(path, "M of accelerometers", accelerometers.matrix.numbers())?,
            square3(path, "M of gyroscopes", gyroscopes.matrix.numbers())?,
            gyroscopes.gyroscope_from_imu.as_ref().map_or(Ok(Matrix3::identity()), rotation)?,
            gyroscopes.g_sensitivity.as_ref().map_or(Ok(Matrix3::zeros()), g_sensitivity)?,
        );
        let intrinsics = intrinsics.ok_or_else(|| {
            let problem = "M of accelerometers or gyroscopes is no scale with misalignment (it is near the identity), or A of gyroscopes is \
                           above 0.1 (rad/s)/(m/s^2): the calibration failed, or is of other units";
            wrong(problem.to_owned())
        })?;
        accelerometers.check_size(path)?;
        Ok(Some(intrinsics))
    }
}

impl AccelerometersYaml {
    /// Says that it is ignored where the accelerometers are, or refuses them.
    fn check_size(&self, path: &Path) -> Result<(), CalibrationError> {
        let places = [&self.rx_i, &self.ry_i, &self.rz_i];
        let distance = |place: &[f64; 3]| place.iter().map(|metres| metres * metres).sum::<f64>().sqrt();
        let farthest_m = places.into_iter().flatten().map(distance).fold(0.0, f64::max);
        if farthest_m.is_nan() || farthest_m > MAX_SIZE_M {
            let problem = format!(
                "rx_i, ry_i, rz_i: an accelerometer is {:.1} cm from the origin of the IMU, which is not corrected beyond {:.0} cm: calibrate with \
                 --imu-models {SCALED_MODEL}",
                farthest_m * 1e2,
                MAX_SIZE_M * 1e2
            );
            return Err(CalibrationError::entry(path, problem));
        }
        if farthest_m > 0.0 {
            tracing::warn!(
                "{}: where the accelerometers are (rx_i, ry_i, rz_i, up to {:.1} mm) is ignored: scale and misalignment are applied",
                path.display(),
                farthest_m * 1e3
            );
        }
        Ok(())
    }
}

/// `imu.yaml` as Kalibr's calibration of cameras and IMU writes it.
#[derive(Deserialize)]
struct ResultYaml {
    imu0: ImuYaml,
}

/// Reads `imu.yaml`, as it goes into Kalibr or as it comes out.
///
/// # Arguments
/// * `measured_hz`: readings a second, where the file does not state them.
///
/// # Errors
/// [`CalibrationError`] with the file: it is missing, or an entry is missing or wrong.
pub fn read_imu(path: &Path, measured_hz: Option<f64>) -> Result<ImuSensor, CalibrationError> {
    let text = read_text(path)?;
    if is_rig(&text) {
        return Ok(rigs::read(path, &text)?.imu);
    }
    if other_programs::is_kimera_imu(&text) {
        return crate::sensor_yaml::read_imu(path);
    }
    other_programs::check(path, &text)?;
    let yaml = if text.lines().any(|line| line.starts_with("imu0:")) {
        parse::<ResultYaml>(path, IMU, &text)?.imu0
    } else {
        parse::<ImuYaml>(path, IMU, &text)?
    };
    let intrinsics = yaml.intrinsics(path)?;
    yaml.check_ideal(path)?;
    if let Some(rows) = &yaml.imu_from_body {
        let pose = pose_from_matrix(path, "T_i_b", rows.numbers())?;
        if pose.rotation.angle() > BODY_TOLERANCE || pose.translation.norm() > BODY_TOLERANCE {
            return Err(CalibrationError::entry(path, "T_i_b is not the identity: give the reference IMU"));
        }
    }
    let Some(rate_hz) = yaml.update_rate.or(measured_hz) else {
        return Err(CalibrationError::entry(path, "update_rate is missing: the readings a second"));
    };
    check_positive(path, "update_rate", rate_hz)?;
    let noise = yaml.noise.noise(path)?;
    Ok(ImuSensor { noise, rate_hz, gravity_magnitude: None, intrinsics })
}
