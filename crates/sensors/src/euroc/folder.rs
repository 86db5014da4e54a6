//! The folder of a recording: where its files are, and how they are opened.

use super::camera_folder::FrameRows;
use super::sensor_yaml;
use super::tables::{TimedRow, TimedRows, read_reference_poses};
use crate::rows::Rows;
use crate::{Frame, ImuSample, SensorCalibration, Sequence, SequenceError, TruthRow};
use std::path::{Path, PathBuf};

/// A recording on disk. Every call opens the file again.
#[derive(Clone, Debug)]
pub(crate) struct Folder {
    root: PathBuf,
    cameras: usize,
    has_imu: bool,
}

impl Folder {
    /// Reads the calibration of a recording, and nothing else.
    pub(crate) fn open(root: &Path) -> Result<(Self, SensorCalibration), SequenceError> {
        let mav = root.join("mav0");
        if !mav.is_dir() {
            let advice = "a recording is a folder in the EuRoC layout, with mav0/cam0 in it; check the path";
            return Err(SequenceError::missing(&mav, advice));
        }
        let imu_folder = mav.join("imu0");
        let imu = if imu_folder.is_dir() {
            Some(sensor_yaml::read_imu(&imu_folder.join("sensor.yaml"))?)
        } else {
            None
        };
        let mut cameras = vec![sensor_yaml::read_camera(&mav.join("cam0/sensor.yaml"))?];
        if mav.join("cam1").is_dir() {
            cameras.push(sensor_yaml::read_camera(&mav.join("cam1/sensor.yaml"))?);
        }
        let folder = Self { root: root.to_path_buf(), cameras: cameras.len(), has_imu: imu.is_some() };
        Ok((folder, SensorCalibration { imu, cameras }))
    }

    /// The frames.
    pub(crate) fn frames(&self) -> Result<Rows<'static, Frame>, SequenceError> {
        Ok(Box::new(FrameRows::open(&self.root.join("mav0"), self.cameras)?))
    }

    /// The IMU's readings; none without an IMU.
    pub(crate) fn imu_samples(&self) -> Result<Rows<'static, ImuSample>, SequenceError> {
        if self.has_imu {
            table(&self.root.join("mav0/imu0/data.csv"))
        } else {
            Ok(Box::new(std::iter::empty()))
        }
    }

    /// Whether there is ground truth.
    pub(crate) fn has_truth(&self) -> bool {
        self.truth_path().exists()
    }

    /// The ground truth; none where it is not known.
    pub(crate) fn truth(&self) -> Result<Rows<'static, TruthRow>, SequenceError> {
        if self.has_truth() { table(&self.truth_path()) } else { Ok(Box::new(std::iter::empty())) }
    }

    fn truth_path(&self) -> PathBuf {
        self.root.join("mav0/state_groundtruth_estimate0/data.csv")
    }
}

fn table<T: TimedRow + 'static>(path: &Path) -> Result<Rows<'static, T>, SequenceError> {
    Ok(Box::new(TimedRows::open(path)?))
}

impl Sequence {
    /// Reads a recording in the EuRoC layout into memory, and checks all of it.
    ///
    /// # Errors
    /// [`SequenceError`] with the file, the line, and what to do: a missing calibration or table, a row that is cut
    /// off or not finite, time stamps out of order, tracks or features of an image that is not listed, a camera model
    /// or a descriptor that is not supported.
    pub fn open(root: &Path) -> Result<Self, SequenceError> {
        let (folder, SensorCalibration { imu, cameras }) = Folder::open(root)?;
        let imu_samples = folder.imu_samples()?.collect::<Result<_, _>>()?;
        let frames = folder.frames()?.collect::<Result<_, _>>()?;
        let groundtruth: Vec<TruthRow> = folder.truth()?.collect::<Result<_, _>>()?;
        let reference_path = root.join("reference_poses.csv");
        let reference_poses =
            reference_path.exists().then(|| read_reference_poses(&reference_path)).transpose()?;
        Ok(Self {
            root: root.to_path_buf(),
            imu,
            imu_samples,
            cameras,
            frames,
            groundtruth: (!groundtruth.is_empty()).then_some(groundtruth),
            reference_poses,
        })
    }
}
