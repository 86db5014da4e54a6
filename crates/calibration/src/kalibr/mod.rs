//! Calibrations as Kalibr writes them: `camchain-imucam.yaml` and `imu.yaml`.
//!
//! | entry | meaning | here |
//! |---|---|---|
//! | `T_cam_imu` | takes coordinates in the IMU's frame to the camera's | `imu_from_camera` is its inverse |
//! | `T_cn_cnm1` | takes coordinates in the frame of the camera before to this one's | used where `T_cam_imu` is not there |
//! | `T_imu_cam` | the inverse, as OpenVINS writes it | `imu_from_camera` |
//! | `timeshift_cam_imu` | `t_imu = t_cam + timeshift_cam_imu`, seconds | that of camera 0 is added to the stamps of frames, those of the others are `time_shift_s` against it |
//! | `line_delay` | time from row to row of a rolling shutter, seconds | `readout_s`, that of all rows; stamps are those of the middle row |
//!
//! Camera models are `pinhole` (`none`, `radtan`, `equidistant`, `fov`), `ds`, `eucm` and `omni` (`radtan`, `none`), with Kalibr's order of
//! intrinsics.
//!
//! Matrices are lists of rows, or as msckf_vio has them of 16 numbers. The IMU is read by `imu_file`. What other programs write is in `rigs` and `other_programs`.

mod imu_file;
mod other_programs;
mod rigs;
mod topics;

pub use imu_file::read_imu;
pub use other_programs::is_kimera_left;
pub use rigs::is_rig;
pub use topics::{COMPRESSED, camera_topics, chosen_cameras, is_same_camera};

use crate::yaml::{Lens, MatrixYaml, checked_time_shift, parse, pose_from_matrix, read_text, readout_time};
use crate::{CalibrationError, CameraSensor};
use geometry::camera::Camera;
use geometry::pose::Pose;
use serde::Deserialize;
use std::path::Path;

const CHAIN: &str = "camera chain of Kalibr";

#[derive(Deserialize)]
struct ChainYaml {
    cam0: CameraYaml,
    cam1: Option<CameraYaml>,
    cam2: Option<CameraYaml>,
    cam3: Option<CameraYaml>,
    cam4: Option<CameraYaml>,
    cam5: Option<CameraYaml>,
    cam6: Option<CameraYaml>,
    cam7: Option<CameraYaml>,
}

impl ChainYaml {
    fn cameras(&self) -> impl Iterator<Item = &CameraYaml> {
        let others = [&self.cam1, &self.cam2, &self.cam3, &self.cam4, &self.cam5, &self.cam6, &self.cam7];
        std::iter::once(&self.cam0).chain(others.into_iter().map_while(Option::as_ref))
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
    camera_from_imu: Option<MatrixYaml>,
    /// OpenVINS's.
    #[serde(rename = "T_imu_cam")]
    imu_from_camera: Option<MatrixYaml>,
    #[serde(rename = "T_cn_cnm1")]
    camera_from_previous: Option<MatrixYaml>,
    #[serde(default)]
    timeshift_cam_imu: f64,
    /// That of `kalibr_calibrate_rs_cameras`.
    #[serde(default)]
    line_delay: f64,
    /// The topic of the images that the camera was calibrated with.
    rostopic: Option<String>,
}

/// The cameras of a chain.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraChain {
    /// Projection and `imu_from_camera` of each camera.
    pub cameras: Vec<(Camera, Pose)>,
    /// Readout time of each of them, seconds: 0 where the file states none, which is a global shutter.
    pub readouts_s: Vec<f64>,
    /// Added to the time stamps of the first of them to obtain the IMU's, nanoseconds.
    pub time_offset_ns: i64,
    /// Of each of them, what is added to its time stamps besides, seconds: 0 for the first.
    pub time_shifts_s: Vec<f64>,
}

impl CameraChain {
    /// Whose cameras have one time shift and global shutters.
    fn with_one_shift(cameras: Vec<(Camera, Pose)>, time_offset_ns: i64) -> Self {
        let none = vec![0.0; cameras.len()];
        Self { cameras, readouts_s: none.clone(), time_offset_ns, time_shifts_s: none }
    }

    /// The cameras as sensors.
    ///
    /// # Arguments
    /// * `rates_hz`: images a second of each of them.
    pub fn sensors(self, rates_hz: impl IntoIterator<Item = f64>) -> Vec<CameraSensor> {
        let times = self.readouts_s.into_iter().zip(self.time_shifts_s);
        let sensor = |(((camera, imu_from_camera), (readout_s, time_shift_s)), rate_hz)| CameraSensor {
            readout_s,
            time_shift_s,
            ..CameraSensor::new(camera, imu_from_camera, rate_hz)
        };
        self.cameras.into_iter().zip(times).zip(rates_hz).map(sensor).collect()
    }
}

/// Whether a text is a camera chain.
pub fn is_camera_chain(text: &str) -> bool {
    text.lines().any(|line| line.starts_with("cam0:"))
}

/// Most cameras that a chain may state.
const MAX_CAMERAS: usize = 8;

/// Number of cameras that a file states, at most eight; of Kimera's, with the file of the right camera beside it.
///
/// # Errors
/// [`CalibrationError`] with the file: it is missing, or an entry is missing or wrong.
pub fn camera_count(path: &Path) -> Result<usize, CalibrationError> {
    let text = read_text(path)?;
    Ok(if is_camera_chain(&text) {
        let states = |camera: &usize| text.lines().any(|line| line.starts_with(&format!("cam{camera}:")));
        (0..MAX_CAMERAS).take_while(states).count()
    } else if is_rig(&text) {
        rigs::read(path, &text)?.cameras.len()
    } else if other_programs::is_kimera_left(&text) && other_programs::read_kimera_cameras(path, 2).is_ok() {
        2
    } else {
        1
    })
}

/// Whether a text is the calibration of an IMU; EuRoC's `sensor.yaml` has the same entries, and `T_BS` or a `sensor_type`.
pub fn is_imu(text: &str) -> bool {
    let has = |entry: &str| text.lines().any(|line| line.starts_with(entry));
    has("imu0:")
        || is_rig(text)
        || other_programs::is_kimera_imu(text)
        || (has("accelerometer_noise_density:") && has("update_rate:"))
}

/// Reads a camera chain with the poses of the cameras on the IMU.
///
/// # Arguments
/// * `known`: for each camera of the recording, its projection as the recording itself states it; used
///   where the file leaves `intrinsics` out.
/// * `chosen`: which camera of the chain each of them is.
///
/// # Errors
/// [`CalibrationError`] with the file: it is missing, or an entry is missing or wrong.
pub fn read_camera_chain(
    path: &Path,
    known: &[Option<Camera>],
    chosen: &[usize],
) -> Result<CameraChain, CalibrationError> {
    read_camera_chain_at(path, known, chosen, None)
}

/// [`read_camera_chain`] of a file that may leave out where camera 0 is on the IMU.
///
/// # Arguments
/// * `camera0_from_imu`: where it is then.
///
/// # Errors
/// As [`read_camera_chain`].
pub fn read_camera_chain_at(
    path: &Path,
    known: &[Option<Camera>],
    chosen: &[usize],
    camera0_from_imu: Option<Pose>,
) -> Result<CameraChain, CalibrationError> {
    let text = read_text(path)?;
    if !is_camera_chain(&text) {
        if is_rig(&text) {
            return cameras_of_rig(path, &rigs::read(path, &text)?, chosen);
        }
        if other_programs::is_kimera_camera(&text) {
            return other_programs::read_kimera_cameras(path, known.len());
        }
        other_programs::check(path, &text)?;
    }
    let chain: ChainYaml = parse(path, CHAIN, &text)?;
    let mut from_imu: Vec<Pose> = Vec::new();
    let needed = chosen.iter().max().map_or(0, |last| last + 1);
    for (index, camera) in chain.cameras().take(needed).enumerate() {
        let pose = match (
            camera_from_imu(path, index, camera)?.or(camera0_from_imu.filter(|_| index == 0)),
            &camera.camera_from_previous,
            from_imu.last(),
        ) {
            (Some(pose), _, _) => pose,
            (None, Some(rows), Some(previous)) => {
                pose_from_matrix(path, &format!("cam{index}: T_cn_cnm1"), rows.numbers())? * *previous
            }
            (None, _, None) => {
                return Err(CalibrationError::entry(
                    path,
                    "cam0 has neither T_cam_imu nor T_imu_cam: this is the result of kalibr_calibrate_cameras; give camchain-imucam.yaml, the \
                     result of kalibr_calibrate_imu_camera",
                ));
            }
            (None, None, Some(_)) => {
                let problem = format!("cam{index} has none of T_cam_imu, T_imu_cam and T_cn_cnm1");
                return Err(CalibrationError::entry(path, problem));
            }
        };
        from_imu.push(pose);
    }
    let yaml: Vec<&CameraYaml> = chain.cameras().collect();
    let (mut cameras, mut readouts_s, mut shifts) = (Vec::new(), Vec::new(), Vec::new());
    for (place, &index) in chosen.iter().enumerate() {
        let (Some(camera), Some(pose)) = (yaml.get(index), from_imu.get(index)) else {
            return Err(CalibrationError::entry(
                path,
                format!(
                    "it has no cam{index}, but the recording has {} cameras: calibrate all, or use fewer (move mav0/cam{index} away; \
                     of a bag, name them with --camera-topic)",
                    chosen.len()
                ),
            ));
        };
        let projection = lens(path, camera, known.get(place))?;
        let name = format!("line_delay of cam{index}");
        readouts_s.push(readout_time(path, &name, camera.line_delay, &projection)?);
        cameras.push((projection, pose.inverse()));
        shifts.push(time_shift(path, index, camera)?);
    }
    let shift = shifts.first().copied().unwrap_or(0.0);
    let time_shifts_s = shifts.iter().map(|own| own - shift).collect();
    Ok(CameraChain { cameras, readouts_s, time_offset_ns: (shift * 1e9).round() as i64, time_shifts_s })
}

/// The cameras of a rig that a recording has.
fn cameras_of_rig(path: &Path, rig: &rigs::Rig, chosen: &[usize]) -> Result<CameraChain, CalibrationError> {
    let camera = |index: &usize| {
        let problem = || {
            format!(
                "it is the calibration of {} cameras, but the recording has {}: calibrate all, or use fewer (of a bag, name them with \
                 --camera-topic)",
                rig.cameras.len(),
                chosen.len()
            )
        };
        rig.cameras.get(*index).cloned().ok_or_else(|| CalibrationError::entry(path, problem()))
    };
    let cameras = chosen.iter().map(camera).collect::<Result<Vec<_>, _>>()?;
    Ok(CameraChain::with_one_shift(cameras, rig.time_offset_ns))
}

/// Whether a chain states the intrinsics of all of its cameras.
///
/// # Errors
/// [`CalibrationError`] with the file: it is missing, or an entry is missing or wrong.
pub fn states_intrinsics(path: &Path) -> Result<bool, CalibrationError> {
    let text = read_text(path)?;
    if !is_camera_chain(&text) {
        if !is_rig(&text) {
            other_programs::check(path, &text)?;
        }
        return Ok(true);
    }
    let chain: ChainYaml = parse(path, CHAIN, &text)?;
    Ok(chain.cameras().all(|camera| !camera.intrinsics.is_empty()))
}

/// The projection of the first camera of a chain or a rig.
pub(crate) fn first_lens(path: &Path, text: &str) -> Result<Camera, CalibrationError> {
    if is_rig(text) {
        let first = rigs::read(path, text)?.cameras.into_iter().next();
        return first
            .map(|(camera, _)| camera)
            .ok_or_else(|| CalibrationError::entry(path, "it has no camera"));
    }
    let chain: ChainYaml = parse(path, CHAIN, text)?;
    lens(path, &chain.cam0, None)
}

fn lens(path: &Path, yaml: &CameraYaml, known: Option<&Option<Camera>>) -> Result<Camera, CalibrationError> {
    if yaml.intrinsics.is_empty()
        && let Some(Some(camera)) = known
    {
        return Ok(camera.clone());
    }
    let (Some(model), Some(resolution)) = (&yaml.camera_model, yaml.resolution) else {
        let problem = "a camera needs camera_model, intrinsics and resolution, unless a bag or a ROS 2 topic has its CameraInfo";
        return Err(CalibrationError::entry(path, problem));
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

fn camera_from_imu(path: &Path, index: usize, yaml: &CameraYaml) -> Result<Option<Pose>, CalibrationError> {
    let pose = |name: &str, matrix: &MatrixYaml| {
        pose_from_matrix(path, &format!("cam{index}: {name}"), matrix.numbers())
    };
    match (&yaml.camera_from_imu, &yaml.imu_from_camera) {
        (Some(matrix), _) => pose("T_cam_imu", matrix).map(Some),
        (None, Some(matrix)) => pose("T_imu_cam", matrix).map(|pose| Some(pose.inverse())),
        (None, None) => Ok(None),
    }
}

fn time_shift(path: &Path, index: usize, yaml: &CameraYaml) -> Result<f64, CalibrationError> {
    checked_time_shift(path, &format!("timeshift_cam_imu of cam{index}"), yaml.timeshift_cam_imu)
}
