//! Calibrations as Kalibr writes them: `camchain-imucam.yaml` and `imu.yaml`.
//!
//! | entry | meaning | here |
//! |---|---|---|
//! | `T_cam_imu` | takes coordinates in the IMU's frame to the camera's | `imu_from_camera` is its inverse |
//! | `T_cn_cnm1` | takes coordinates in the frame of the camera before to this one's | used where `T_cam_imu` is not there |
//! | `timeshift_cam_imu` | `t_imu = t_cam + timeshift_cam_imu`, seconds | added to the stamps of frames |

mod files;

pub use files::CalibrationFiles;

use crate::calibration_yaml::{Lens, NoiseYaml, check_positive, parse, pose_from_matrix, read_text};
use crate::{ImuSensor, SequenceError};
use geometry::camera::Camera;
use geometry::pose::Pose;
use serde::Deserialize;
use std::path::Path;

/// The cameras of a pair are exposed at the same time; a difference of their time shifts above this is reported, seconds.
const MAX_SHIFT_DIFFERENCE_S: f64 = 1e-3;
/// Time shifts beyond this are mistakes: other units, or recordings of different times, seconds.
const MAX_SHIFT_S: f64 = 10.0;
/// Largest distance of the IMU from the body frame (metres, radians): they are meant to be the same.
const BODY_TOLERANCE: f64 = 1e-6;

const CHAIN: &str = "camera chain of Kalibr";
const IMU: &str = "imu.yaml of Kalibr";

#[derive(Deserialize)]
struct ChainYaml {
    cam0: CameraYaml,
    cam1: Option<CameraYaml>,
    cam2: Option<CameraYaml>,
    cam3: Option<CameraYaml>,
}

impl ChainYaml {
    fn cameras(&self) -> impl Iterator<Item = &CameraYaml> {
        std::iter::once(&self.cam0)
            .chain([&self.cam1, &self.cam2, &self.cam3].into_iter().map_while(Option::as_ref))
    }
}

#[derive(Deserialize)]
struct CameraYaml {
    camera_model: Option<String>,
    /// Left out where a bag or a topic has the camera's `CameraInfo`.
    #[serde(default)]
    intrinsics: Vec<f64>,
    #[serde(default)]
    distortion_model: Option<String>,
    #[serde(default)]
    distortion_coeffs: Vec<f64>,
    resolution: Option<[u32; 2]>,
    #[serde(rename = "T_cam_imu")]
    camera_from_imu: Option<Vec<Vec<f64>>>,
    #[serde(rename = "T_cn_cnm1")]
    camera_from_previous: Option<Vec<Vec<f64>>>,
    #[serde(default)]
    timeshift_cam_imu: f64,
    /// The topic of the images that the camera was calibrated with.
    rostopic: Option<String>,
}

#[derive(Deserialize)]
struct ImuYaml {
    update_rate: Option<f64>,
    #[serde(rename = "T_i_b")]
    imu_from_body: Option<Vec<Vec<f64>>>,
    #[serde(default)]
    model: Option<String>,
    #[serde(flatten)]
    noise: NoiseYaml,
}

/// `imu.yaml` as Kalibr's calibration of cameras and IMU writes it.
#[derive(Deserialize)]
struct ResultYaml {
    imu0: ImuYaml,
}

/// The cameras of a chain.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CameraChain {
    /// Projection and `imu_from_camera` of one or two cameras.
    pub(crate) cameras: Vec<(Camera, Pose)>,
    /// Added to the time stamps of the cameras to obtain the IMU's, nanoseconds.
    pub(crate) time_offset_ns: i64,
}

/// Whether a text is a camera chain.
pub(crate) fn is_camera_chain(text: &str) -> bool {
    text.lines().any(|line| line.starts_with("cam0:"))
}

/// Whether a text is the calibration of an IMU; EuRoC's `sensor.yaml` has the same entries, and `T_BS` or a `sensor_type`.
pub(crate) fn is_imu(text: &str) -> bool {
    let has = |entry: &str| text.lines().any(|line| line.starts_with(entry));
    has("imu0:") || (has("accelerometer_noise_density:") && has("update_rate:"))
}

/// The topic of each camera of a chain, where the file states it.
pub(crate) fn camera_topics(path: &Path) -> Result<Vec<Option<String>>, SequenceError> {
    let chain: ChainYaml = parse(path, CHAIN, &read_text(path)?)?;
    let topic = |camera: &CameraYaml| camera.rostopic.clone().filter(|topic| !topic.is_empty());
    Ok(chain.cameras().map(topic).collect())
}

/// Reads a camera chain with the poses of the cameras on the IMU.
///
/// # Arguments
/// * `known`: for each of the one or two cameras of the recording, its projection as the recording itself states it; used
///   where the file leaves `intrinsics` out.
/// * `chosen`: which camera of the chain each of them is.
pub(crate) fn read_camera_chain(
    path: &Path,
    known: &[Option<Camera>],
    chosen: &[usize],
) -> Result<CameraChain, SequenceError> {
    let chain: ChainYaml = parse(path, CHAIN, &read_text(path)?)?;
    let mut from_imu: Vec<Pose> = Vec::new();
    let needed = chosen.iter().max().map_or(0, |last| last + 1);
    for (index, camera) in chain.cameras().take(needed).enumerate() {
        let pose = match (
            camera_from_imu(path, index, camera)?,
            &camera.camera_from_previous,
            from_imu.last(),
        ) {
            (Some(pose), _, _) => pose,
            (None, Some(rows), Some(previous)) => {
                pose_from_matrix(path, &format!("cam{index}: T_cn_cnm1"), &rows.concat())? * *previous
            }
            (None, _, None) => {
                return Err(SequenceError::calibration(
                    path,
                    "cam0 has no T_cam_imu: this is the result of kalibr_calibrate_cameras; give camchain-imucam.yaml, the \
                     result of kalibr_calibrate_imu_camera",
                ));
            }
            (None, None, Some(_)) => {
                let problem = format!("cam{index} has neither T_cam_imu nor T_cn_cnm1");
                return Err(SequenceError::calibration(path, problem));
            }
        };
        from_imu.push(pose);
    }
    let yaml: Vec<&CameraYaml> = chain.cameras().collect();
    let (mut cameras, mut shifts) = (Vec::new(), Vec::new());
    for (place, &index) in chosen.iter().enumerate() {
        let (Some(camera), Some(pose)) = (yaml.get(index), from_imu.get(index)) else {
            return Err(SequenceError::calibration(
                path,
                format!(
                    "it has no cam{index}, but the recording has two cameras: calibrate both, or use one (move mav0/cam1 away; \
                     of a bag, name it with --camera-topic)"
                ),
            ));
        };
        cameras.push((lens(path, camera, known.get(place))?, pose.inverse()));
        shifts.push(time_shift(path, index, camera)?);
    }
    let shift = shifts.first().copied().unwrap_or(0.0);
    if let Some(difference) = shifts.get(1).map(|second| second - shift)
        && difference.abs() > MAX_SHIFT_DIFFERENCE_S
    {
        tracing::warn!(
            "{}: the timeshift_cam_imu of the two cameras differ by {:.1} ms; that of camera 0 is used for both",
            path.display(),
            difference * 1e3
        );
    }
    Ok(CameraChain { cameras, time_offset_ns: (shift * 1e9).round() as i64 })
}

/// Whether a chain states the intrinsics of all of its cameras.
pub(crate) fn states_intrinsics(path: &Path) -> Result<bool, SequenceError> {
    let chain: ChainYaml = parse(path, CHAIN, &read_text(path)?)?;
    let mut cameras = chain.cameras().take(2);
    Ok(cameras.all(|camera| !camera.intrinsics.is_empty()))
}

/// The projection of `cam0` of a chain.
pub(crate) fn first_lens(path: &Path, text: &str) -> Result<Camera, SequenceError> {
    let chain: ChainYaml = parse(path, CHAIN, text)?;
    lens(path, &chain.cam0, None)
}

/// Reads `imu.yaml`, as it goes into Kalibr or as it comes out.
///
/// # Arguments
/// * `measured_hz`: readings a second, where the file does not state them.
pub(crate) fn read_imu(path: &Path, measured_hz: Option<f64>) -> Result<ImuSensor, SequenceError> {
    let text = read_text(path)?;
    let yaml = if text.lines().any(|line| line.starts_with("imu0:")) {
        parse::<ResultYaml>(path, IMU, &text)?.imu0
    } else {
        parse::<ImuYaml>(path, IMU, &text)?
    };
    if let Some(model) = yaml.model.as_deref().filter(|model| *model != "calibrated") {
        return Err(SequenceError::calibration(
            path,
            format!(
                "model \"{model}\" is unknown: calibrated is the only one; calibrate with --imu-models calibrated"
            ),
        ));
    }
    if let Some(rows) = &yaml.imu_from_body {
        let pose = pose_from_matrix(path, "T_i_b", &rows.concat())?;
        if pose.rotation.angle() > BODY_TOLERANCE || pose.translation.norm() > BODY_TOLERANCE {
            return Err(SequenceError::calibration(
                path,
                "T_i_b is not the identity: give the reference IMU",
            ));
        }
    }
    let Some(rate_hz) = yaml.update_rate.or(measured_hz) else {
        return Err(SequenceError::calibration(path, "update_rate is missing: the readings a second"));
    };
    check_positive(path, "update_rate", rate_hz)?;
    Ok(ImuSensor { noise: yaml.noise.noise(path)?, rate_hz, gravity_magnitude: None })
}

fn lens(path: &Path, yaml: &CameraYaml, known: Option<&Option<Camera>>) -> Result<Camera, SequenceError> {
    if yaml.intrinsics.is_empty()
        && let Some(Some(camera)) = known
    {
        return Ok(camera.clone());
    }
    let (Some(model), Some(resolution)) = (&yaml.camera_model, yaml.resolution) else {
        let problem = "a camera needs camera_model, intrinsics and resolution, unless a bag or a ROS 2 topic has its CameraInfo";
        return Err(SequenceError::calibration(path, problem));
    };
    let lens = Lens {
        resolution,
        camera_model: Some(model),
        intrinsics: &yaml.intrinsics,
        distortion_model: yaml.distortion_model.as_deref(),
        distortion: &yaml.distortion_coeffs,
        distortion_key: "distortion_coeffs",
    };
    lens.camera(path)
}

fn camera_from_imu(path: &Path, index: usize, yaml: &CameraYaml) -> Result<Option<Pose>, SequenceError> {
    let key = format!("cam{index}: T_cam_imu");
    yaml.camera_from_imu.as_ref().map(|rows| pose_from_matrix(path, &key, &rows.concat())).transpose()
}

fn time_shift(path: &Path, index: usize, yaml: &CameraYaml) -> Result<f64, SequenceError> {
    let shift = yaml.timeshift_cam_imu;
    if shift.is_finite() && shift.abs() < MAX_SHIFT_S {
        return Ok(shift);
    }
    let problem =
        format!("timeshift_cam_imu of cam{index} is {shift}, but is in seconds, and below {MAX_SHIFT_S}");
    Err(SequenceError::calibration(path, problem))
}
