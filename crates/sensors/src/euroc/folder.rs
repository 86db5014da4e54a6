//! The folder of a recording: where its files are, and how they are opened.

use super::camera_folder::FrameRows;
use super::stamps::{FrameStamps, TableStamps};
use super::tables::{PositionRow, TimedRows, WheelRow};
use crate::CalibrationFiles;
use crate::gnss_intake::GnssIntake;
use crate::imu_intake::ImuIntake;
use crate::rows::Rows;
use crate::stored::Stored;
use crate::wheel_intake::WheelIntake;
use crate::{
    Frame, GnssReading, GnssSensor, ImuSample, PairCounts, ReferencePose, SensorCalibration, SequenceError,
    Table, TruthRow, WheelReading,
};
use calibration::kalibr;
use calibration::{relative_time_shifts, sensor_yaml, wheel_yaml};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Cameras are named by a byte in tracks.
const MAX_CAMERAS: usize = 256;
/// Images from which the rate of a camera is measured, where its calibration does not state it.
const RATE_IMAGES: usize = 100;

/// A recording on disk. Every call opens the file again.
#[derive(Clone, Debug)]
pub(crate) struct Folder {
    root: PathBuf,
    frames: Arc<FrameStamps>,
    readings: Option<TableStamps>,
    wheels: Option<(TableStamps, WheelIntake)>,
    gnss: Option<(TableStamps, GnssSensor)>,
    truth: Option<TableStamps>,
    reference_poses: Option<TableStamps>,
    imu_intake: ImuIntake,
    time_offset_ns: i64,
}

/// The calibration of a recording in a folder, and where it comes from.
#[derive(Clone, Debug, PartialEq)]
pub struct FolderCalibration {
    /// The sensors.
    pub sensors: SensorCalibration,
    /// What was added to the time stamps of the images to obtain the IMU's, nanoseconds: the `timeshift_cam_imu` of camera 0.
    pub time_offset_ns: i64,
    /// Kalibr's files, where they were used in place of `sensor.yaml`.
    pub files: CalibrationFiles,
}

impl FolderCalibration {
    /// Reads the calibration of a recording, and nothing else.
    ///
    /// # Arguments
    /// * `files`: Kalibr's, or a folder with a calibration; what is not given is read from the `sensor.yaml` files, or found in
    ///   the folder.
    ///
    /// # Errors
    /// [`SequenceError`] with the file.
    pub fn read(root: &Path, files: &CalibrationFiles) -> Result<Self, SequenceError> {
        if let Some(folder) = files.cameras.as_ref().filter(|path| path.is_dir()) {
            let others = CalibrationFiles { cameras: None, ..files.clone() };
            let found = others.completed(folder)?;
            // Kalibr's files in that folder, else its sensor.yaml files.
            let (root, files) =
                if found.cameras.is_some() { (root, found) } else { (folder.as_path(), others) };
            return Self::read(root, &files);
        }
        let mav = root.join("mav0");
        if !mav.is_dir() {
            let advice = "a recording is a folder in the EuRoC layout, with mav0/cam0 in it; check the path";
            return Err(SequenceError::missing(&mav, advice));
        }
        let files = files.completed(root)?;
        let imu = match (&files.imu, mav.join("imu0")) {
            (_, folder) if !folder.is_dir() => None,
            (Some(path), _) => Some(kalibr::read_imu(path, None)?),
            (None, folder) => Some(sensor_yaml::read_imu(&folder.join("sensor.yaml"))?),
        };
        let wheels_path = mav.join("wheels0/sensor.yaml");
        let wheels = wheels_path.exists().then(|| wheel_yaml::read_wheels(&wheels_path)).transpose()?;
        let gnss_path = mav.join("gnss0/sensor.yaml");
        let gnss = gnss_path.exists().then(|| sensor_yaml::read_gnss(&gnss_path)).transpose()?;
        let count = (1..MAX_CAMERAS).take_while(|index| mav.join(format!("cam{index}")).is_dir()).count() + 1;
        let folders = (0..count).map(|index| mav.join(format!("cam{index}")));
        let Some(path) = &files.cameras else {
            let read = |folder: PathBuf| sensor_yaml::read_camera(&folder.join("sensor.yaml"));
            let mut cameras = folders.map(read).collect::<Result<Vec<_>, _>>()?;
            let time_offset_ns = relative_time_shifts(&mut cameras);
            let sensors = SensorCalibration { imu, cameras, wheels, gnss };
            return Ok(Self { sensors, time_offset_ns, files });
        };
        let chain = kalibr::read_camera_chain(path, &vec![None; count], &(0..count).collect::<Vec<_>>())?;
        let rates_hz = folders.map(|folder| rate_of(&folder.join("data.csv")));
        let rates_hz = rates_hz.collect::<Result<Vec<f64>, SequenceError>>()?;
        let time_offset_ns = chain.time_offset_ns;
        let sensors = SensorCalibration { imu, cameras: chain.sensors(rates_hz), wheels, gnss };
        Ok(Self { sensors, time_offset_ns, files })
    }
}

/// Images a second by the median interval of the first images of a list; 1 for a single image.
fn rate_of(path: &Path) -> Result<f64, SequenceError> {
    let mut table = Table::open(path, "it lists the time stamps of this camera's images")?;
    let mut stamps = Vec::new();
    while stamps.len() < RATE_IMAGES {
        let Some(row) = table.next_row()? else { break };
        stamps.push(row.stamp()?);
    }
    stamps.sort_unstable();
    let mut intervals: Vec<i64> = stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
    intervals.sort_unstable();
    let median = intervals.get(intervals.len() / 2).copied();
    Ok(median.filter(|&interval| interval > 0).map_or(1.0, |interval| 1e9 / interval as f64))
}

impl Folder {
    /// Reads the calibration of a recording, and the stamps of its sensors.
    pub(crate) fn open(
        root: &Path,
        files: &CalibrationFiles,
    ) -> Result<(Self, SensorCalibration), SequenceError> {
        let FolderCalibration { sensors, time_offset_ns, .. } = FolderCalibration::read(root, files)?;
        let mav = root.join("mav0");
        let if_there = |path: PathBuf| path.exists().then(|| TableStamps::read(&path));
        let folder = Self {
            root: root.to_path_buf(),
            frames: Arc::new(FrameStamps::read(&mav, &sensors.cameras, files.pair_tolerance_ns())),
            readings: sensors.imu.as_ref().map(|_| TableStamps::read(&mav.join("imu0/data.csv"))),
            wheels: if_there(wheels_path(root))
                .map(|stamps| (stamps, WheelIntake::new(sensors.wheels.as_ref(), files))),
            gnss: if_there(gnss_path(root)).map(|stamps| (stamps, sensors.gnss.unwrap_or_default())),
            truth: if_there(truth_path(root)),
            reference_poses: if_there(reference_path(root)),
            imu_intake: ImuIntake::new(files.imu_units, sensors.imu.as_ref()),
            time_offset_ns,
        };
        Ok((folder, sensors))
    }
}

fn wheels_path(root: &Path) -> PathBuf {
    root.join("mav0/wheels0/data.csv")
}

fn gnss_path(root: &Path) -> PathBuf {
    root.join("mav0/gnss0/data.csv")
}

/// The ground truth: TUM-VI has the same table under another name, without velocities and biases.
fn truth_path(root: &Path) -> PathBuf {
    let motion_capture = root.join("mav0/mocap0/data.csv");
    let usual = root.join("mav0/state_groundtruth_estimate0/data.csv");
    if !usual.exists() && motion_capture.exists() { motion_capture } else { usual }
}

fn reference_path(root: &Path) -> PathBuf {
    root.join("reference_poses.csv")
}

impl Stored for Folder {
    fn frames(&self) -> Result<Rows<'static, Frame>, SequenceError> {
        let offset_ns = self.time_offset_ns;
        let rows = FrameRows::open(&self.root.join("mav0"), &self.frames)?;
        let shifted = move |frame: Frame| Frame { stamp_ns: frame.stamp_ns + offset_ns, ..frame };
        Ok(Box::new(rows.map(move |frame| frame.map(shifted))))
    }

    fn imu_samples(&self) -> Result<Rows<'static, ImuSample>, SequenceError> {
        let Some(TableStamps { order, .. }) = &self.readings else {
            return Ok(Box::new(std::iter::empty()));
        };
        let intake = self.imu_intake;
        let rows = TimedRows::open_in_order(&self.readings_path(), order)?;
        Ok(Box::new(rows.map(move |reading| reading.map(|reading| intake.take(reading)))))
    }

    fn wheel_readings(&self) -> Result<Rows<'static, WheelReading>, SequenceError> {
        let Some((TableStamps { order, .. }, intake)) = &self.wheels else {
            return Ok(Box::new(std::iter::empty()));
        };
        let path = wheels_path(&self.root);
        let rows = TimedRows::<WheelRow>::open_in_order(&path, order)?;
        let mut intake = intake.clone();
        Ok(Box::new(rows.filter_map(move |row| match row {
            Ok(row) => row.wheel_reading(&path, &mut intake).transpose(),
            Err(error) => Some(Err(error)),
        })))
    }

    fn gnss_readings(&self) -> Result<Rows<'static, GnssReading>, SequenceError> {
        let Some((TableStamps { order, .. }, sensor)) = &self.gnss else {
            return Ok(Box::new(std::iter::empty()));
        };
        let path = gnss_path(&self.root);
        let rows = TimedRows::<PositionRow>::open_in_order(&path, order)?;
        let intake = GnssIntake::new(sensor);
        Ok(Box::new(rows.map(move |row| row?.gnss_reading(&path, &intake))))
    }

    fn stereo_pairs(&self) -> Option<PairCounts> {
        self.frames.pairs
    }

    fn time_offset_ns(&self) -> i64 {
        self.time_offset_ns
    }

    fn readings_path(&self) -> PathBuf {
        self.root.join("mav0/imu0/data.csv")
    }

    fn has_truth(&self) -> bool {
        self.truth.is_some()
    }

    fn truth(&self) -> Result<Rows<'static, TruthRow>, SequenceError> {
        let Some(TableStamps { order, .. }) = &self.truth else { return Ok(Box::new(std::iter::empty())) };
        Ok(Box::new(TimedRows::open_in_order(&truth_path(&self.root), order)?))
    }

    fn reference_poses(&self) -> Result<Option<Vec<ReferencePose>>, SequenceError> {
        let Some(TableStamps { order, .. }) = &self.reference_poses else { return Ok(None) };
        TimedRows::open_in_order(&reference_path(&self.root), order)?.collect::<Result<_, _>>().map(Some)
    }
}
