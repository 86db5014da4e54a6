//! The calibration of a bag's sensors: files in the ways of EuRoC and Kalibr, and the recorded `CameraInfo`.

use super::messages;
use super::topics::BagSensors;
use crate::camera_info::camera_of_info;
use crate::euroc::sensor_yaml;
use crate::kalibr::{self, CameraChain};
use crate::{CalibrationFiles, CameraSensor, ImuSensor, SensorCalibration, SequenceError};
use bags::Bag;
use geometry::camera::Camera;
use geometry::pose::Pose;
use ros_messages::sensor_msgs::CameraInfo;
use std::path::{Path, PathBuf};

/// The calibration of the sensors of a bag; of Kalibr's files, without the rates that they do not state.
pub(super) struct BagCalibration {
    cameras: Cameras,
    imu: Option<Imu>,
    /// Added to the stamps of the images, nanoseconds.
    pub(super) time_offset_ns: i64,
}

enum Cameras {
    Kalibr(Vec<(Camera, Pose)>),
    Euroc(Vec<CameraSensor>),
}

enum Imu {
    Kalibr(PathBuf),
    Euroc(ImuSensor),
}

impl BagCalibration {
    /// The calibration with rates as they were measured, where the files do not state them.
    pub(super) fn with_rates(
        self,
        imu_hz: Option<f64>,
        cameras_hz: &[f64],
    ) -> Result<SensorCalibration, SequenceError> {
        let imu = match self.imu {
            Some(Imu::Kalibr(file)) => Some(kalibr::read_imu(&file, imu_hz)?),
            Some(Imu::Euroc(imu)) => Some(imu),
            None => None,
        };
        let sensor =
            |((camera, imu_from_camera), &rate_hz)| CameraSensor { camera, imu_from_camera, rate_hz };
        let cameras = match self.cameras {
            Cameras::Kalibr(cameras) => cameras.into_iter().zip(cameras_hz).map(sensor).collect(),
            Cameras::Euroc(cameras) => cameras,
        };
        Ok(SensorCalibration { imu, cameras })
    }
}

/// Reads the calibration of the sensors of a bag.
///
/// It is looked for in the folder that `files` names, else in the bag's own; a file that is named comes first, then one
/// with the bag's name.
pub(super) fn read(
    bag: &Bag,
    sensors: &BagSensors,
    files: &CalibrationFiles,
) -> Result<BagCalibration, SequenceError> {
    let path = bag.path();
    let (root, files) = files_of(path, files)?;
    let (cameras, time_offset_ns) = match &files.cameras {
        Some(file) => {
            let infos = camera_infos(bag, sensors)?;
            let topics = bag.topics();
            let names: Vec<&str> =
                sensors.cameras.iter().map(|camera| topics[camera.images].name.as_str()).collect();
            let has_topic = |of: &str| topics.iter().any(|topic| kalibr::is_same_camera(&topic.name, of));
            let chosen = kalibr::chosen_cameras(file, &names, has_topic)?;
            let CameraChain { cameras, time_offset_ns } = kalibr::read_camera_chain(file, &infos, &chosen)?;
            (Cameras::Kalibr(cameras), time_offset_ns)
        }
        None => (Cameras::Euroc(euroc_cameras(path, &root, sensors.cameras.len())?), 0),
    };
    let imu = match (sensors.imu, files.imu) {
        (None, _) => None,
        (Some(_), Some(file)) => Some(Imu::Kalibr(file)),
        (Some(_), None) => Some(Imu::Euroc(sensor_yaml::read_imu(&euroc_file(path, &root, "imu0")?)?)),
    };
    Ok(BagCalibration { cameras, imu, time_offset_ns })
}

/// The folder of the calibration of a bag, and its files.
fn files_of(path: &Path, files: &CalibrationFiles) -> Result<(PathBuf, CalibrationFiles), SequenceError> {
    let beside = || if path.is_dir() { path } else { path.parent().unwrap_or(path) };
    let (root, mut files) = match &files.cameras {
        Some(folder) if folder.is_dir() => {
            (folder.clone(), CalibrationFiles { cameras: None, ..files.clone() })
        }
        Some(file) => (file.parent().unwrap_or(file).to_path_buf(), files.clone()),
        None => (beside().to_path_buf(), files.clone()),
    };
    let own = path.with_extension("yaml");
    if files.cameras.is_none() && root == beside() && own.is_file() {
        files.cameras = Some(own);
    }
    if let (Some(file), None) = (&files.cameras, &files.imu)
        && kalibr::is_imu(&std::fs::read_to_string(file).unwrap_or_default())
    {
        files.imu = Some(file.clone());
    }
    let files = files.completed(&root)?;
    Ok((root, files))
}

/// The topic of each camera of the calibration, where there is one that states it.
pub(super) fn camera_topics(bag: &Bag, files: &CalibrationFiles) -> Vec<Option<String>> {
    let found = files_of(bag.path(), files).ok().and_then(|(_, files)| files.cameras);
    // What is wrong with the files is said when they are read.
    found.and_then(|file| kalibr::camera_topics(&file).ok()).unwrap_or_default()
}

/// The projection of each camera by its `CameraInfo`.
fn camera_infos(bag: &Bag, sensors: &BagSensors) -> Result<Vec<Option<Camera>>, SequenceError> {
    let read = |camera: &super::BagCamera| match camera.info {
        Some(info) => camera_info(bag, camera.images, info),
        None => Ok(None),
    };
    sensors.cameras.iter().map(read).collect()
}

/// The projection by the first sound message of a topic.
fn camera_info(bag: &Bag, images: usize, info: usize) -> Result<Option<Camera>, SequenceError> {
    let topic = &bag.topics()[info];
    let mut messages = topic.messages.iter();
    let found = messages.find_map(|message| messages::read::<CameraInfo>(bag, info, message.place).ok());
    let Some(found) = found else { return Ok(None) };
    let name: PathBuf = format!("{}, {}", bag.path().display(), topic.name).into();
    camera_of_info(&found, &bag.topics()[images].name, &name)
}

fn euroc_cameras(bag: &Path, root: &Path, count: usize) -> Result<Vec<CameraSensor>, SequenceError> {
    (0..count)
        .map(|index| sensor_yaml::read_camera(&euroc_file(bag, root, &format!("cam{index}"))?))
        .collect()
}

/// The `sensor.yaml` of a sensor in a folder of the EuRoC layout.
fn euroc_file(bag: &Path, root: &Path, sensor: &str) -> Result<PathBuf, SequenceError> {
    let file = root.join(format!("mav0/{sensor}/sensor.yaml"));
    if file.is_file() {
        return Ok(file);
    }
    let (what, switch) = if sensor == "imu0" {
        ("noise of the IMU", "--imu-calibration YAML (Kalibr's imu.yaml)")
    } else {
        ("pose of the camera on the IMU", "--calibration YAML (Kalibr's camchain-imucam.yaml)")
    };
    Err(SequenceError::calibration(
        bag,
        format!(
            "the {what} ({sensor}) is not known, and {} has no calibration: give {switch}, or --calibration DIR with a \
                 folder in the EuRoC layout",
            root.display()
        ),
    ))
}
