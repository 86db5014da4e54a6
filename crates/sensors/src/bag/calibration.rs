//! The calibration of a bag's sensors: files in the ways of EuRoC and Kalibr, else what the bag itself carries.

use super::gnss_topic::GnssTopic;
use super::recorded_calibration::{self as recorded, NotRecorded};
use super::topics::BagSensors;
use super::wheel_topic::WheelTopic;
use crate::ros_sensors::CameraTiming;
use crate::{
    CalibrationFiles, CameraSensor, GnssSensor, ImuSensor, SensorCalibration, SequenceError, WheelSensor,
};
use bags::Bag;
use calibration::kalibr::{self, CameraChain};
use calibration::relative_time_shifts;
use calibration::sensor_yaml;
use geometry::camera::Camera;
use geometry::pose::Pose;
use std::path::{Path, PathBuf};

/// The calibration of the sensors of a bag, without the rates that it does not state.
pub(super) struct BagCalibration {
    cameras: Cameras,
    /// Driftless recorded the images on the clock of the IMU.
    is_on_imu_clock: bool,
    imu: Option<Imu>,
    wheels: Option<WheelSensor>,
    gnss: Option<GnssSensor>,
    /// Added to the stamps of the images, nanoseconds.
    pub(super) time_offset_ns: i64,
}

enum Cameras {
    WithoutRates(Vec<(Camera, Pose)>),
    Chain(CameraChain),
    Complete(Vec<CameraSensor>),
}

enum Imu {
    /// `is_corrected`: its scale and misalignment are no more in the readings.
    Kalibr {
        file: PathBuf,
        is_corrected: bool,
    },
    Complete(Box<ImuSensor>),
}

impl BagCalibration {
    /// The calibration with rates as they were measured, where the files do not state them.
    pub(super) fn with_rates(
        self,
        imu_hz: Option<f64>,
        cameras_hz: &[f64],
    ) -> Result<SensorCalibration, SequenceError> {
        let imu = match self.imu {
            Some(Imu::Kalibr { file, is_corrected }) => {
                let mut imu = kalibr::read_imu(&file, imu_hz)?;
                if is_corrected && imu.intrinsics.take().is_some() {
                    tracing::warn!(
                        "{}: scale and misalignment are not applied: Driftless recorded readings without them",
                        file.display()
                    );
                }
                Some(imu)
            }
            Some(Imu::Complete(imu)) => Some(*imu),
            None => None,
        };
        let sensor =
            |((camera, imu_from_camera), &rate_hz)| CameraSensor::new(camera, imu_from_camera, rate_hz);
        let mut cameras: Vec<CameraSensor> = match self.cameras {
            Cameras::WithoutRates(cameras) => cameras.into_iter().zip(cameras_hz).map(sensor).collect(),
            Cameras::Chain(chain) => chain.sensors(cameras_hz.iter().copied()),
            Cameras::Complete(cameras) => cameras,
        };
        for camera in cameras.iter_mut().filter(|camera| self.is_on_imu_clock && camera.stamp_shift_ns() != 0)
        {
            camera.time_shift_s = 0.0;
        }
        Ok(SensorCalibration { imu, cameras, wheels: self.wheels, gnss: self.gnss })
    }
}

/// Reads the calibration of the sensors of a bag.
///
/// It is looked for in the folder that `files` names, else in the bag's own; a file that is named comes first, then one
/// with the bag's name. Without files it is that which the bag carries.
pub(super) fn read(
    bag: &Bag,
    sensors: &BagSensors,
    wheels: Option<&WheelTopic>,
    gnss: Option<&GnssTopic>,
    files: &CalibrationFiles,
) -> Result<BagCalibration, SequenceError> {
    let path = bag.path();
    let is_named = files.cameras.is_some();
    let (root, files) = files_of(path, files)?;
    let (cameras, time_offset_ns) = match &files.cameras {
        Some(file) => {
            let infos = camera_infos(bag, sensors)?;
            let topics = bag.topics();
            let names: Vec<&str> =
                sensors.cameras.iter().map(|camera| topics[camera.images].name.as_str()).collect();
            let has_topic = |of: &str| topics.iter().any(|topic| kalibr::is_same_camera(&topic.name, of));
            let chosen = kalibr::chosen_cameras(file, &names, has_topic)?;
            let chain = kalibr::read_camera_chain(file, &infos, &chosen)?;
            let time_offset_ns = time_offset_of(bag, file, chain.time_offset_ns);
            (Cameras::Chain(chain), time_offset_ns)
        }
        None if is_named || euroc_path(&root, "cam0").is_file() => {
            let mut cameras = euroc_cameras(path, &root, sensors.cameras.len())?;
            let time_offset_ns = relative_time_shifts(&mut cameras);
            (Cameras::Complete(cameras), time_offset_of(bag, &root, time_offset_ns))
        }
        None => (recorded_cameras(bag, &root, sensors)?, 0),
    };
    let is_own = recorded::is_own(bag);
    let imu = match (sensors.imu, files.imu) {
        (None, _) => None,
        (Some(_), Some(file)) => Some(Imu::Kalibr { file, is_corrected: is_own }),
        (Some(_), None) => Some(Imu::Complete(Box::new(imu_without_kalibr(bag, &root)?))),
    };
    let wheels = wheels.and_then(|wheels| wheels.calibration(bag, sensors.imu));
    let gnss = gnss.and_then(|gnss| gnss.calibration(bag, sensors.imu));
    Ok(BagCalibration { cameras, is_on_imu_clock: is_own, imu, wheels, gnss, time_offset_ns })
}

/// The offset of a camera chain, which images that Driftless recorded have in their stamps already.
fn time_offset_of(bag: &Bag, chain: &Path, stated_ns: i64) -> i64 {
    if stated_ns == 0 || !recorded::is_own(bag) {
        return stated_ns;
    }
    tracing::warn!(
        "{}: timeshift_cam_imu is not added to the images of {}: Driftless recorded them on the clock of the IMU",
        chain.display(),
        bag.path().display()
    );
    0
}

/// The cameras by `CameraInfo` and `/tf_static`.
fn recorded_cameras(bag: &Bag, root: &Path, sensors: &BagSensors) -> Result<Cameras, SequenceError> {
    match recorded::cameras(bag, sensors) {
        Ok(cameras) => {
            let path = bag.path().display();
            tracing::info!("{path}: the cameras are calibrated by the recorded CameraInfo and /tf_static");
            let sensor = |((camera, imu_from_camera), timing): (_, CameraTiming)| CameraSensor {
                readout_s: timing.readout_s,
                time_shift_s: timing.delay_s,
                ..CameraSensor::new(camera, imu_from_camera, timing.rate_hz)
            };
            Ok(match recorded::timing(bag, sensors) {
                Some(timing) => Cameras::Complete(cameras.into_iter().zip(timing).map(sensor).collect()),
                None => Cameras::WithoutRates(cameras),
            })
        }
        Err(NotRecorded::Sequence(error)) => Err(error),
        Err(missing) => Err(unknown(bag.path(), root, "cam0", &format!("; {missing}"))),
    }
}

/// The IMU by its `sensor.yaml`, else by the recording itself.
fn imu_without_kalibr(bag: &Bag, root: &Path) -> Result<ImuSensor, SequenceError> {
    let file = euroc_path(root, "imu0");
    if file.is_file() {
        return Ok(sensor_yaml::read_imu(&file)?);
    }
    recorded::imu(bag)?.ok_or_else(|| unknown(bag.path(), root, "imu0", ""))
}

/// GNSS by its `sensor.yaml`, where its topic is named and the folder of the calibration has that file.
pub(super) fn stated_gnss(
    path: &Path,
    files: &CalibrationFiles,
) -> Result<Option<GnssSensor>, SequenceError> {
    if files.gnss_topic.is_none() {
        return Ok(None);
    }
    let (root, _) = files_of(path, files)?;
    let file = euroc_path(&root, "gnss0");
    Ok(file.is_file().then(|| sensor_yaml::read_gnss(&file)).transpose()?)
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
        && kalibr::is_imu(&files::read_to_string(file).unwrap_or_default())
    {
        files.imu = Some(file.clone());
    }
    let completed = files.completed(&root)?;
    // A rosbag2 is a folder itself: its calibration may lie in it, or beside it as that of a file.
    if let (true, None, None, Some(parent)) =
        (path.is_dir() && root == path, &files.cameras, &completed.cameras, path.parent())
        && !euroc_path(&root, "cam0").is_file()
    {
        let beside = files.completed(parent)?;
        if beside.cameras.is_some() {
            return Ok((parent.to_path_buf(), beside));
        }
    }
    Ok((root, completed))
}

/// The topic of each camera of the calibration, where there is one that states it.
pub(super) fn camera_topics(bag: &Bag, files: &CalibrationFiles) -> Vec<Option<String>> {
    let found = files_of(bag.path(), files).ok().and_then(|(_, files)| files.cameras);
    // Faults of the files are reported when they are read.
    found.and_then(|file| kalibr::camera_topics(&file).ok()).unwrap_or_default()
}

/// The projection of each camera by its `CameraInfo`.
fn camera_infos(bag: &Bag, sensors: &BagSensors) -> Result<Vec<Option<Camera>>, SequenceError> {
    let read = |camera| Ok(recorded::projection(bag, camera)?.map(|(projection, _)| projection));
    sensors.cameras.iter().map(read).collect()
}

fn euroc_cameras(bag: &Path, root: &Path, count: usize) -> Result<Vec<CameraSensor>, SequenceError> {
    let read = |index| {
        let sensor = format!("cam{index}");
        let file = euroc_path(root, &sensor);
        if file.is_file() {
            Ok(sensor_yaml::read_camera(&file)?)
        } else {
            Err(unknown(bag, root, &sensor, ""))
        }
    };
    (0..count).map(read).collect()
}

/// The `sensor.yaml` of a sensor in a folder of the EuRoC layout.
fn euroc_path(root: &Path, sensor: &str) -> PathBuf {
    root.join(format!("mav0/{sensor}/sensor.yaml"))
}

/// A sensor without calibration.
///
/// # Arguments
/// * `missing`: what the bag itself lacks, after a semicolon; empty where it could not have it.
fn unknown(bag: &Path, root: &Path, sensor: &str, missing: &str) -> SequenceError {
    let (what, switch) = if sensor == "imu0" {
        ("noise of the IMU", "--imu-calibration YAML (Kalibr's imu.yaml)")
    } else {
        ("pose of the camera on the IMU", "--calibration YAML (Kalibr's camchain-imucam.yaml)")
    };
    SequenceError::calibration(
        bag,
        format!(
            "the {what} ({sensor}) is not known, and {} has no calibration{missing}: give {switch}, or --calibration DIR with a \
                 folder in the EuRoC layout",
            root.display()
        ),
    )
}
