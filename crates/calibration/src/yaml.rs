//! What the YAML files of calibrations have in common: OpenCV's dialect, matrices, pinhole cameras, noise densities.

use crate::CalibrationError;
use crate::mount::checked_mount;
use crate::noise_check::warn_of_implausible;
use crate::numbers::list;
use geometry::camera::{Camera, Distortion};
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

/// The noise of an IMU, checked; values that are unusual are warned of.
///
/// # Arguments
/// * `densities`: name and value of the gyroscope's noise and walk, and of the accelerometer's.
pub(crate) fn imu_noise(path: &Path, densities: [(&str, f64); 4]) -> Result<ImuNoise, CalibrationError> {
    for (name, value) in densities {
        check_positive(path, name, value)?;
    }
    warn_of_implausible(path, &densities);
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
        let ([fu, fv, cu, cv], distortion) = self.intrinsics_and_distortion(path)?;
        let camera = Camera {
            width: self.resolution[0],
            height: self.resolution[1],
            focal: [fu, fv],
            centre: [cu, cv],
            distortion,
        };
        camera.validate().map_err(|error| wrong(error.to_string()))?;
        Ok(camera)
    }

    /// `[fu, fv, cu, cv]`, and the distortion with the parameters that stand before them in the intrinsics of other models than the pinhole.
    fn intrinsics_and_distortion(&self, path: &Path) -> Result<([f64; 4], Distortion), CalibrationError> {
        let model = self.camera_model.unwrap_or("pinhole");
        let wrong_count = |names: &str| {
            let problem =
                format!("intrinsics of {model} are {names}, but {} numbers are given", self.intrinsics.len());
            CalibrationError::entry(path, problem)
        };
        let distortion = distortion(path, self.distortion_model, self.distortion_key, self.distortion)?;
        let mismatch = |takes: &str| {
            let problem =
                format!("camera_model {model} takes distortion_model {takes}, not {}", distortion.name());
            CalibrationError::entry(path, problem)
        };
        match model {
            "pinhole" => {
                let Ok(pinhole) = self.intrinsics.try_into() else {
                    return Err(wrong_count("fu, fv, cu, cv"));
                };
                Ok((pinhole, distortion))
            }
            "ds" | "eucm" => {
                let first = if model == "ds" { "xi, alpha" } else { "alpha, beta" };
                let &[a, b, fu, fv, cu, cv] = self.intrinsics else {
                    return Err(wrong_count(&format!("{first}, fu, fv, cu, cv")));
                };
                if distortion != Distortion::None {
                    return Err(mismatch("none"));
                }
                let distortion = if model == "ds" {
                    Distortion::DoubleSphere { xi: a, alpha: b }
                } else {
                    Distortion::Eucm { alpha: a, beta: b }
                };
                Ok(([fu, fv, cu, cv], distortion))
            }
            "omni" => {
                let &[xi, fu, fv, cu, cv] = self.intrinsics else {
                    return Err(wrong_count("xi, fu, fv, cu, cv"));
                };
                let distortion = match distortion {
                    Distortion::None => [0.0; 4],
                    Distortion::RadialTangential(k) => k,
                    _ => return Err(mismatch("none or radial-tangential (radtan) with 4 coefficients")),
                };
                Ok(([fu, fv, cu, cv], Distortion::Omni { xi, distortion }))
            }
            _ => Err(CalibrationError::entry(
                path,
                format!(
                    "camera_model \"{model}\" is unknown: use pinhole with distortion_model none, radial-tangential (radtan), equidistant, \
                     fov or thin-prism-fisheye, or ds, eucm or omni"
                ),
            )),
        }
    }
}

fn distortion(
    path: &Path,
    model: Option<&str>,
    key: &str,
    given: &[f64],
) -> Result<Distortion, CalibrationError> {
    let model = model.unwrap_or("none").trim();
    let wrong_count = |wanted: &str| {
        let counts = format!("{model} takes {wanted} {key}, {} are given", given.len());
        CalibrationError::entry(path, counts)
    };
    match model {
        "" | "none" => {
            let none = given.iter().all(|value| *value == 0.0);
            none.then_some(Distortion::None).ok_or_else(|| wrong_count("0"))
        }
        "radial-tangential" | "radtan" | "plumb_bob" | "rational_polynomial" => {
            Distortion::from_opencv(given).ok_or_else(|| wrong_count("4, 5, 8 or 12"))
        }
        "equidistant" | "equi" => given.try_into().map(Distortion::Equidistant).map_err(|_| wrong_count("4")),
        "fov" => match given {
            [omega] => Ok(Distortion::Fov(*omega)),
            _ => Err(wrong_count("1")),
        },
        "thin-prism-fisheye" | "thin_prism_fisheye" => {
            given.try_into().map(Distortion::ThinPrismFisheye).map_err(|_| wrong_count("8"))
        }
        _ => Err(CalibrationError::entry(
            path,
            format!(
                "distortion_model \"{model}\" is unknown: use none, radial-tangential (radtan, plumb_bob, rational_polynomial), equidistant, \
                 fov or thin-prism-fisheye"
            ),
        )),
    }
}

/// The entries of a projection in a `sensor.yaml`, which [`lens_of_text`](crate::lens_of_text) reads back exactly: `resolution`,
/// `camera_model`, `intrinsics`, `distortion_model`, `distortion_coefficients`.
///
/// The models `ds`, `eucm` and `omni` have their parameters before the focal lengths, as Kalibr writes them.
pub fn projection_yaml(camera: &Camera) -> String {
    let ([fu, fv], [cu, cv]) = (camera.focal, camera.centre);
    let pinhole = [fu, fv, cu, cv];
    let coefficients = camera.distortion.coefficients();
    let (model, before, distortion_model, after): (_, &[f64], _, &[f64]) = match &camera.distortion {
        Distortion::DoubleSphere { .. } | Distortion::Eucm { .. } => {
            (camera.distortion.name(), &coefficients, "none", &[])
        }
        Distortion::Omni { xi, distortion } => {
            ("omni", std::slice::from_ref(xi), "radial-tangential", distortion)
        }
        other => ("pinhole", &[], other.name(), &coefficients),
    };
    format!(
        "resolution: [{}, {}]\ncamera_model: {model}\nintrinsics: [{}]\ndistortion_model: {distortion_model}\n\
         distortion_coefficients: [{}]\n",
        camera.width,
        camera.height,
        list(&[before, &pinhole].concat()),
        list(after)
    )
}

/// Checks an entry of a calibration.
pub(crate) fn check_positive(path: &Path, name: &str, value: f64) -> Result<(), CalibrationError> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(CalibrationError::entry(path, format!("{name} is {value}, but must be a positive number")))
}

/// Longest readout time of an image, seconds: a longer one is in other units.
const MAX_READOUT_S: f64 = 0.2;

/// Readout time of an image, seconds, by the time from row to row; negative where images are turned by 180 degrees after they were
/// read out.
pub(crate) fn readout_time(
    path: &Path,
    name: &str,
    line_delay_s: f64,
    camera: &Camera,
) -> Result<f64, CalibrationError> {
    let readout_s = line_delay_s * f64::from(camera.height);
    if readout_s.abs() < MAX_READOUT_S {
        return Ok(readout_s);
    }
    let rows = camera.height;
    let problem = format!(
        "{name} is {line_delay_s}, but is the time from row to row in seconds: for {rows} rows below {}",
        MAX_READOUT_S / f64::from(rows)
    );
    Err(CalibrationError::entry(path, problem))
}

/// Time shifts beyond this are mistakes: other units, or recordings of different times, seconds.
const MAX_SHIFT_S: f64 = 10.0;

/// Checks what is added to the stamps of a camera, seconds.
pub(crate) fn checked_time_shift(path: &Path, name: &str, shift_s: f64) -> Result<f64, CalibrationError> {
    if shift_s.is_finite() && shift_s.abs() < MAX_SHIFT_S {
        return Ok(shift_s);
    }
    let problem = format!("{name} is {shift_s}, but is in seconds, and below {MAX_SHIFT_S}");
    Err(CalibrationError::entry(path, problem))
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
    let rotation =
        rounded_rotation(matrix).ok_or_else(|| wrong("its upper left 3x3 block is not a rotation"))?;
    let pose = Pose::new(rotation, Vector3::new(data[3], data[7], data[11]));
    checked_mount(path, key, &pose)?;
    Ok(pose)
}

/// The rotation that a matrix is up to what files round; `None` where it is none.
fn rounded_rotation(matrix: Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let off = (matrix.transpose() * matrix - Matrix3::identity()).amax();
    let is_rotation = off <= ROTATION_TOLERANCE && matrix.determinant() > 0.0;
    let rounded = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix));
    is_rotation.then(|| UnitQuaternion::new_normalize(rounded.into_inner()))
}

/// A matrix of 3 rows and columns.
pub(crate) fn square3(path: &Path, key: &str, data: &[f64]) -> Result<Matrix3<f64>, CalibrationError> {
    if data.len() != 9 || data.iter().any(|value| !value.is_finite()) {
        return Err(CalibrationError::entry(
            path,
            format!("{key}: it must hold 9 finite numbers, row by row"),
        ));
    }
    Ok(Matrix3::from_row_slice(data))
}

/// A rotation as a matrix of 3 rows and columns.
pub(crate) fn rotation_of(path: &Path, key: &str, data: &[f64]) -> Result<Matrix3<f64>, CalibrationError> {
    let rotation = rounded_rotation(square3(path, key, data)?)
        .ok_or_else(|| CalibrationError::entry(path, format!("{key}: it is not a rotation")))?;
    Ok(rotation.to_rotation_matrix().into_inner())
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
        for (model, given) in [
            ("none", &four[..]),
            ("fov", &four),
            ("equidistant", &four[..3]),
            ("mei", &four),
            ("radtan", &four[..3]),
        ] {
            assert!(distortion(Some(model), given).is_err(), "{model}");
        }
        let twelve: [f64; 12] = std::array::from_fn(|k| 0.01 * k as f64);
        for count in [5, 8, 12] {
            for model in ["radial-tangential", "plumb_bob", "rational_polynomial"] {
                let read = distortion(Some(model), &twelve[..count]).unwrap();
                assert_eq!(read.coefficients(), twelve[..count]);
            }
        }
    }

    #[test]
    fn every_projection_is_read_back_as_it_was_written() {
        let full = |count: usize| {
            Distortion::from_opencv(
                &[0.01, -2e-7, 0.1, 0.3, 1e-9, 0.2, 0.1, 0.05, 1e-3, 0.0, 0.0, -1e-3][..count],
            )
        };
        let eight = [0.01, -0.02, 1e-3, 2e-6, 0.003, -4e-4, 1e-3, -1e-12];
        for distortion in [
            Distortion::None,
            Distortion::RadialTangential([-0.28, 0.07, 1.9e-4, 1.76e-5]),
            Distortion::Equidistant([0.01, -0.02, 0.003, -4e-4]),
            Distortion::Fov(0.93),
            full(5).unwrap(),
            full(8).unwrap(),
            full(12).unwrap(),
            Distortion::ThinPrismFisheye(eight),
            Distortion::DoubleSphere { xi: -0.2, alpha: 0.57 },
            Distortion::Eucm { alpha: 0.63, beta: 1.04 },
            Distortion::Omni { xi: 1.85, distortion: [-0.07, 0.4, -1.2e-6, 8e-4] },
        ] {
            let camera = Camera {
                width: 640,
                height: 480,
                focal: [320.1, 321.0 / 0.7],
                centre: [320.0, 1e-7],
                distortion,
            };
            assert_eq!(
                crate::lens_of_text(Path::new("sensor.yaml"), &projection_yaml(&camera)).unwrap(),
                camera
            );
        }
    }

    #[test]
    fn a_camera_model_wants_its_intrinsics() {
        let lens = |model, intrinsics: &[f64], distortion_model| {
            let lens = Lens {
                resolution: [640, 480],
                camera_model: Some(model),
                intrinsics,
                distortion_model: Some(distortion_model),
                distortion: if distortion_model == "none" { &[] } else { &[0.1, 0.2, 0.003, 0.004] },
                distortion_key: "distortion_coeffs",
            };
            lens.camera(Path::new("camchain.yaml")).map_err(|error| error.to_string())
        };
        let pinhole = [300.0, 301.0, 320.0, 240.0];
        let six = [&[0.1, 0.6], &pinhole[..]].concat();
        let five = [&[0.9], &pinhole[..]].concat();
        assert_eq!(
            lens("ds", &six, "none").unwrap().distortion,
            Distortion::DoubleSphere { xi: 0.1, alpha: 0.6 }
        );
        assert_eq!(
            lens("eucm", &six, "none").unwrap().distortion,
            Distortion::Eucm { alpha: 0.1, beta: 0.6 }
        );
        let omni = lens("omni", &five, "radtan").unwrap();
        assert_eq!(omni.distortion, Distortion::Omni { xi: 0.9, distortion: [0.1, 0.2, 0.003, 0.004] });
        assert_eq!((omni.focal, omni.centre), ([300.0, 301.0], [320.0, 240.0]));
        assert_eq!(
            lens("omni", &five, "none").unwrap().distortion,
            Distortion::Omni { xi: 0.9, distortion: [0.0; 4] }
        );
        for (model, intrinsics, distortion, words) in [
            ("ds", &pinhole[..], "none", "xi, alpha, fu"),
            ("eucm", &five, "none", "alpha, beta, fu"),
            ("omni", &six, "radtan", "xi, fu"),
            ("pinhole", &five, "radtan", "fu, fv, cu, cv"),
            ("ds", &six, "radtan", "takes distortion_model none"),
            ("omni", &five, "equidistant", "not equidistant"),
            ("cata", &five, "none", "\"cata\" is unknown"),
        ] {
            let error = lens(model, intrinsics, distortion).unwrap_err();
            assert!(error.contains(words), "{error}");
        }
        let folded = [&[0.1, 1.6], &pinhole[..]].concat();
        assert!(lens("ds", &folded, "none").unwrap_err().contains("alpha"));
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
