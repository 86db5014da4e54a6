//! The calibration of a robot that plays no recording.

use crate::CalibrationFiles;
use crate::{FolderCalibration, SensorCalibration, SequenceError};
use calibration::kalibr;
use geometry::camera::Camera;
use std::path::{Path, PathBuf};

/// Kalibr does not state the rate of the cameras; this stands in its place and is compared with nothing.
const UNSTATED_RATE_HZ: f64 = 20.0;

/// Reads the calibration of a robot's sensors.
///
/// # Arguments
/// * `path`: a folder in the EuRoC layout, of which the `sensor.yaml` files are read and nothing else; a folder with Kalibr's
///   files in it; or Kalibr's camera chain.
/// * `imu`: Kalibr's `imu.yaml`, where it is not beside the camera chain.
/// * `known`: projections of the robot's cameras, used where a camera chain leaves them out; empty where none is known.
/// * `topics`: of the robot's cameras, in order, where they are topics of ROS; a camera chain may name them (`rostopic`).
///
/// # Errors
/// [`SequenceError`] with the file.
pub fn read_rig_calibration(
    path: &Path,
    imu: Option<&Path>,
    known: &[Camera],
    topics: &[String],
) -> Result<FolderCalibration, SequenceError> {
    let (folder, files) = files_of(path, imu)?;
    let Some(chain_path) = &files.cameras else {
        return FolderCalibration::read(path, &files);
    };
    let known: Vec<Option<Camera>> = match (known, topics) {
        ([], []) => vec![None; kalibr::camera_count(chain_path)?],
        ([], topics) => vec![None; topics.len().min(kalibr::camera_count(chain_path)?)],
        (known, _) => known.iter().cloned().map(Some).collect(),
    };
    let names: Vec<&str> = topics.iter().map(String::as_str).take(known.len()).collect();
    let chosen = match names.as_slice() {
        [] => (0..known.len()).collect(),
        names => {
            let has_topic = |of: &str| topics.iter().any(|topic| kalibr::is_same_camera(topic, of));
            kalibr::chosen_cameras(chain_path, names, has_topic)?
        }
    };
    let chain = kalibr::read_camera_chain(chain_path, &known, &chosen)?;
    let advice = "the noise of the IMU is needed: give Kalibr's imu.yaml with --imu-calibration";
    let imu_path: &PathBuf =
        files.imu.as_ref().ok_or_else(|| SequenceError::missing(&folder.join("imu.yaml"), advice))?;
    let imu = Some(kalibr::read_imu(imu_path, None)?);
    let time_offset_ns = chain.time_offset_ns;
    let cameras = chain.sensors(std::iter::repeat(UNSTATED_RATE_HZ));
    let sensors = SensorCalibration { imu, cameras, wheels: None, gnss: None };
    Ok(FolderCalibration { sensors, time_offset_ns, files })
}

/// Whether a calibration that [`read_rig_calibration`] reads states the projections of the cameras.
///
/// # Errors
/// [`SequenceError`] with the file.
pub fn states_intrinsics(path: &Path) -> Result<bool, SequenceError> {
    // The IMU plays no part, so that of several files none has to be chosen.
    match files_of(path, Some(path))?.1.cameras {
        Some(chain) => Ok(kalibr::states_intrinsics(&chain)?),
        None => Ok(true),
    }
}

/// The folder of a calibration, and its files.
fn files_of(path: &Path, imu: Option<&Path>) -> Result<(PathBuf, CalibrationFiles), SequenceError> {
    let mut files = CalibrationFiles { imu: imu.map(Path::to_path_buf), ..CalibrationFiles::default() };
    let folder = if path.is_file() {
        files.cameras = Some(path.to_path_buf());
        path.parent().unwrap_or(Path::new("")).to_path_buf()
    } else {
        path.to_path_buf()
    };
    let files = files.completed(&folder)?;
    Ok((folder, files))
}
