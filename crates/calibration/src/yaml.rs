//! What the YAML files of calibrations have in common: OpenCV's dialect, matrices, pinhole cameras, noise densities.

use crate::CalibrationError;
use geometry::camera::{Camera, Distortion, check_mount};
use geometry::pose::Pose;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use std::path::Path;
use types::ImuNoise;

/// Largest entry of `R' R - I` for the rotation R of a matrix; EuRoC rounds to 12 decimals, hand-written files to 4.
const ROTATION_TOLERANCE: f64 = 1e-3;

/// A matrix as a list of its rows, or of all its numbers row by row.
#[derive(Deserialize)]
#[serde(from = "WrittenMatrix")]
pub(crate) struct MatrixYaml(Vec<f64>);

#[derive(Deserialize)]
#[serde(untagged)]
enum WrittenMatrix {
    Rows(Vec<Vec<f64>>),
    Flat(Vec<f64>),
    /// OpenCV's, with the numbers of its rows and columns.
    OpenCv {
        data: Vec<f64>,
    },
}

impl From<WrittenMatrix> for MatrixYaml {
    fn from(written: WrittenMatrix) -> Self {
        Self(match written {
            WrittenMatrix::Rows(rows) => rows.concat(),
            WrittenMatrix::Flat(data) | WrittenMatrix::OpenCv { data } => data,
        })
    }
}

impl MatrixYaml {
    /// All numbers, row by row.
    pub(crate) fn numbers(&self) -> &[f64] {
        &self.0
    }
}

/// Noise densities of an IMU, with the same names in EuRoC's and Kalibr's files.
#[derive(Deserialize)]
pub(crate) struct NoiseYaml {
    gyroscope_noise_density: f64,
    gyroscope_random_walk: f64,
    accelerometer_noise_density: f64,
    accelerometer_random_walk: f64,
}

impl NoiseYaml {
    /// The noise, checked.
    pub(crate) fn noise(&self, path: &Path) -> Result<ImuNoise, CalibrationError> {
        let densities = [
            ("gyroscope_noise_density", self.gyroscope_noise_density),
            ("gyroscope_random_walk", self.gyroscope_random_walk),
            ("accelerometer_noise_density", self.accelerometer_noise_density),
            ("accelerometer_random_walk", self.accelerometer_random_walk),
        ];
        imu_noise(path, densities)
    }
}

/// The noise of an IMU, checked.
///
/// # Arguments
/// * `densities`: name and value of the gyroscope's noise and walk, and of the accelerometer's.
pub(crate) fn imu_noise(path: &Path, densities: [(&str, f64); 4]) -> Result<ImuNoise, CalibrationError> {
    for (name, value) in densities {
        check_positive(path, name, value)?;
    }
    let mut noise = ImuNoise::default();
    [noise.gyroscope, noise.gyroscope_walk, noise.accelerometer, noise.accelerometer_walk] =
        densities.map(|(_, value)| value);
    Ok(noise)
}

/// The projection of a camera as a file states it.
pub struct Lens<'a> {
    /// Columns and rows, pixels.
    pub resolution: [u32; 2],
    /// Model of the projection; a pinhole without it.
    pub camera_model: Option<&'a str>,
    /// `[fx, fy, cx, cy]`, pixels.
    pub intrinsics: &'a [f64],
    /// Model of the distortion; none without it.
    pub distortion_model: Option<&'a str>,
    /// Its coefficients.
    pub distortion: &'a [f64],
    /// What the file calls the coefficients of the distortion.
    pub distortion_key: &'static str,
}

impl Lens<'_> {
    /// The camera, checked.
    ///
    /// # Errors
    /// [`CalibrationError`] with the file: it is missing, or an entry is missing or wrong.
    pub fn camera(&self, path: &Path) -> Result<Camera, CalibrationError> {
        let wrong = |problem: String| CalibrationError::entry(path, problem);
        if let Some(model) = self.camera_model.filter(|model| *model != "pinhole") {
            return Err(wrong(format!(
                "camera_model \"{model}\" is unknown: pinhole is the only one, with distortion_model none, \
                 radial-tangential (radtan), equidistant or fov; calibrate again with one of these"
            )));
        }
        let &[fu, fv, cu, cv] = self.intrinsics else {
            return Err(wrong(format!(
                "intrinsics are the 4 numbers fu, fv, cu, cv, but {} are given",
                self.intrinsics.len()
            )));
        };
        let camera = Camera {
            width: self.resolution[0],
            height: self.resolution[1],
            focal: [fu, fv],
            centre: [cu, cv],
            distortion: distortion(path, self.distortion_model, self.distortion_key, self.distortion)?,
        };
        camera.validate().map_err(|error| wrong(error.to_string()))?;
        Ok(camera)
    }
}

fn distortion(
    path: &Path,
    model: Option<&str>,
    key: &str,
    given: &[f64],
) -> Result<Distortion, CalibrationError> {
    let model = model.unwrap_or("none").trim();
    let wrong_count = |wanted: usize| {
        let counts = format!("{model} takes {wanted} {key}, {} are given", given.len());
        CalibrationError::entry(path, counts)
    };
    match model {
        "" | "none" => {
            let none = given.iter().all(|value| *value == 0.0);
            none.then_some(Distortion::None).ok_or_else(|| wrong_count(0))
        }
        "radial-tangential" | "radtan" | "plumb_bob" => {
            given.try_into().map(Distortion::RadialTangential).map_err(|_| wrong_count(4))
        }
        "equidistant" | "equi" => given.try_into().map(Distortion::Equidistant).map_err(|_| wrong_count(4)),
        "fov" => match given {
            [omega] => Ok(Distortion::Fov(*omega)),
            _ => Err(wrong_count(1)),
        },
        _ => Err(CalibrationError::entry(
            path,
            format!(
                "distortion_model \"{model}\" is unknown: use none, radial-tangential (radtan), equidistant or fov"
            ),
        )),
    }
}

/// Checks an entry of a calibration.
pub(crate) fn check_positive(path: &Path, name: &str, value: f64) -> Result<(), CalibrationError> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(CalibrationError::entry(path, format!("{name} is {value}, but must be a positive number")))
}

/// A row-major 4x4 matrix as a pose. `key`: its name in the file.
pub(crate) fn pose_from_matrix(path: &Path, key: &str, data: &[f64]) -> Result<Pose, CalibrationError> {
    let wrong = |problem: &str| CalibrationError::entry(path, format!("{key}: {problem}"));
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
    let pose = Pose::new(rotation, Vector3::new(data[3], data[7], data[11]));
    check_mount(&pose).map_err(|error| wrong(&error.to_string()))?;
    Ok(pose)
}

/// The text of a calibration file.
pub(crate) fn read_text(path: &Path) -> Result<String, CalibrationError> {
    files::read_to_string(path).map_err(|source| match source.kind() {
        std::io::ErrorKind::NotFound => CalibrationError::Missing {
            path: path.to_path_buf(),
            advice: "it holds the sensor's calibration; write it in the EuRoC layout, or lay Kalibr's camchain-imucam.yaml and \
             imu.yaml into the recording's folder"
                .to_owned(),
        },
        _ => CalibrationError::Io { path: path.to_path_buf(), source },
    })
}

/// Parses a calibration file. `kind`: what it should be, for the error.
pub(crate) fn parse<T: for<'de> Deserialize<'de>>(
    path: &Path,
    kind: &str,
    text: &str,
) -> Result<T, CalibrationError> {
    serde_saphyr::from_str(&plain_yaml(text))
        .map_err(|error| CalibrationError::entry(path, format!("it is not a valid {kind}: {error}")))
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
        let distortion =
            |model, given: &[f64]| distortion(Path::new("sensor.yaml"), model, "coefficients", given);
        assert_eq!(distortion(None, &[]).unwrap(), Distortion::None);
        assert_eq!(distortion(Some("none"), &[0.0]).unwrap(), Distortion::None);
        assert_eq!(distortion(Some("fov"), &[0.9]).unwrap(), Distortion::Fov(0.9));
        let four = [0.1, 0.2, 0.3, 0.4];
        assert_eq!(distortion(Some("equidistant"), &four).unwrap(), Distortion::Equidistant(four));
        for model in ["radial-tangential", "radtan"] {
            assert_eq!(distortion(Some(model), &four).unwrap(), Distortion::RadialTangential(four));
        }
        for (model, given) in
            [("none", &four[..]), ("fov", &four), ("equidistant", &four[..3]), ("mei", &four)]
        {
            assert!(distortion(Some(model), given).is_err(), "{model}");
        }
    }

    #[test]
    fn a_matrix_that_is_no_rotation_is_refused() {
        let pose_from_matrix = |data: &[f64]| pose_from_matrix(Path::new("sensor.yaml"), "T_BS", data);
        let mirror = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., -1., 0., 0., 0., 0., 1.];
        assert!(pose_from_matrix(&mirror).is_err());
        assert!(pose_from_matrix(&mirror[..15]).is_err());
        let mut scaled = mirror;
        scaled[10] = 1.1;
        assert!(pose_from_matrix(&scaled).is_err());
        scaled[10] = f64::NAN;
        assert!(pose_from_matrix(&scaled).is_err());
    }
}
