//! Recordings in the layout of the 4Seasons dataset: two cameras, an IMU, and poses by GNSS.
//!
//! ```text
//! DIR/times.txt                     frame id, time of exposure [s], exposure [ms]
//! DIR/distorted_images/cam0, cam1   images that are named by their frame id
//! DIR/imu.txt                       time [ns], angular velocity [rad/s], acceleration [m/s^2]
//! DIR/Transformations.txt           TS_cam_imu, transform_S_AS, transform_w_gpsw: translation, quaternion (x, y, z, w)
//! DIR/GNSSPoses.txt                 frame id, world_from_camera: translation, quaternion (x, y, z, w); scale
//! DIR/../calibration/camchain.yaml  Kalibr's camera chain, or the same in DIR/calibration
//! ```
//! Numbers are separated by commas or spaces, and lines that do not begin with a number are comments. Frame ids are times in
//! nanoseconds. The truth is in the local frame of GNSS (east, north, up; metres): `gpsw_from_imu = transform_w_gpsw⁻¹ · transform_S_AS ·
//! scale · world_from_camera · TS_cam_imu`, of the keyframes that GNSSPoses.txt lists.
//!
//! Described by the [documentation of the dataset](https://www.4seasons-dataset.com/documentation), Wenzel et al., GCPR 2020.

use super::imu_intake::ImuIntake;
use super::rows::{Rows, rows_of};
use super::stored::Stored;
use super::{
    CalibrationFiles, Frame, ImageData, ImuNoise, ImuSample, ImuSensor, PairCounts, SensorCalibration,
    SequenceError, TruthRow,
};
use calibration::kalibr;
use geometry::Pose;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Where the images are. Those of `undistorted_images` would need another calibration.
const IMAGES: &str = "distorted_images";
/// Number of cameras.
const CAMERAS: usize = 2;
/// How far the frame id of an image may be from its time, seconds: the time is written in microseconds.
const STAMP_TOLERANCE_S: f64 = 1e-3;
/// A quaternion that is printed with six digits has unit length within this.
const QUATERNION_TOLERANCE: f64 = 1e-3;
/// Whether a folder has the layout of 4Seasons.
pub fn is_recording(root: &Path) -> bool {
    root.join("times.txt").is_file() && root.join("imu.txt").is_file() && root.join(IMAGES).is_dir()
}

/// A recording in memory; its images stay on disk.
#[derive(Debug)]
pub(crate) struct Recording {
    root: PathBuf,
    readings: Arc<[ImuSample]>,
    frames: Arc<[Frame]>,
    pairs: PairCounts,
    truth: Arc<[TruthRow]>,
    time_offset_ns: i64,
}

impl Recording {
    /// Reads the tables of a recording, and its calibration.
    ///
    /// # Arguments
    /// * `files`: a camera chain and an `imu.yaml` in place of those of the dataset.
    ///
    /// # Errors
    /// [`SequenceError`] with the file and the line.
    pub(crate) fn open(
        root: &Path,
        files: &CalibrationFiles,
    ) -> Result<(Self, SensorCalibration), SequenceError> {
        let transforms = Transforms::read(&root.join("Transformations.txt"))?;
        let chain_path = files.cameras.clone().map_or_else(|| camera_chain(root), Ok)?;
        let chain = kalibr::read_camera_chain_at(
            &chain_path,
            &vec![None; CAMERAS],
            &[0, 1],
            Some(transforms.camera_from_imu),
        )?;
        let imu_path = root.join("imu.txt");
        let mut readings = read_imu(&imu_path)?;
        let stamps: Vec<i64> = readings.iter().map(|reading| reading.stamp_ns).collect();
        let imu = match &files.imu {
            Some(path) => kalibr::read_imu(path, Some(rate_hz(&stamps)))?,
            None => ImuSensor {
                // The dataset states none; its IMU is of the family whose noise is the default.
                noise: ImuNoise::default(),
                rate_hz: rate_hz(&stamps),
                gravity_magnitude: None,
                intrinsics: None,
            },
        };
        let intake = ImuIntake::new(files.imu_units, Some(&imu));
        for reading in &mut readings {
            *reading = intake.take(*reading);
        }
        let time_offset_ns = chain.time_offset_ns;
        let (frames, pairs) = read_frames(root, time_offset_ns)?;
        let stamps: Vec<i64> = frames.iter().map(|frame| frame.stamp_ns).collect();
        let cameras = chain.sensors([rate_hz(&stamps); CAMERAS]);
        let truth = read_truth(&root.join("GNSSPoses.txt"), &transforms, time_offset_ns)?;
        let recording = Self {
            root: root.to_path_buf(),
            readings: readings.into(),
            frames: frames.into(),
            pairs,
            truth: truth.into(),
            time_offset_ns,
        };
        let calibration = SensorCalibration { imu: Some(imu), cameras, ..SensorCalibration::default() };
        Ok((recording, calibration))
    }
}

impl Stored for Recording {
    fn frames(&self) -> Result<Rows<'static, Frame>, SequenceError> {
        Ok(rows_of(&self.frames))
    }

    fn imu_samples(&self) -> Result<Rows<'static, ImuSample>, SequenceError> {
        Ok(rows_of(&self.readings))
    }

    fn time_offset_ns(&self) -> i64 {
        self.time_offset_ns
    }

    fn stereo_pairs(&self) -> Option<PairCounts> {
        Some(self.pairs)
    }

    fn readings_path(&self) -> PathBuf {
        self.root.join("imu.txt")
    }

    fn has_truth(&self) -> bool {
        !self.truth.is_empty()
    }

    fn truth(&self) -> Result<Rows<'static, TruthRow>, SequenceError> {
        Ok(rows_of(&self.truth))
    }
}

/// The camera chain of the dataset, which it has in an archive of its own.
fn camera_chain(root: &Path) -> Result<PathBuf, SequenceError> {
    let in_folder = |folder: &Path| folder.join("calibration/camchain.yaml");
    let beside = in_folder(&root.join(".."));
    [in_folder(root), beside.clone()].into_iter().find(|path| path.is_file()).ok_or_else(|| {
        let advice = "unpack the calibration of the dataset beside the recordings, or give its camchain.yaml with --calibration";
        SequenceError::missing(&beside, advice)
    })
}

/// The median rate of some instants; 1 for fewer than two.
fn rate_hz(stamps: &[i64]) -> f64 {
    let mut intervals: Vec<i64> = stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
    intervals.sort_unstable();
    intervals.get(intervals.len() / 2).map_or(1.0, |&interval| 1e9 / interval as f64)
}

/// The lines of numbers of a file.
struct Numbers {
    path: PathBuf,
    text: String,
}

/// One of them.
struct Line<'a> {
    path: &'a Path,
    /// Counted from 1.
    number: u64,
    cells: Vec<&'a str>,
}

impl Numbers {
    fn read(path: &Path, advice: &str) -> Result<Self, SequenceError> {
        let text = files::read_to_string(path).map_err(|source| match source.kind() {
            std::io::ErrorKind::NotFound => SequenceError::missing(path, advice),
            _ => SequenceError::io(path, source),
        })?;
        Ok(Self { path: path.to_path_buf(), text })
    }

    /// The lines that begin with a number.
    fn lines(&self) -> impl Iterator<Item = Line<'_>> {
        let begins_with_number =
            |text: &str| text.starts_with(|first: char| first.is_ascii_digit() || "+-.".contains(first));
        let lines = self.text.lines().enumerate().map(|(at, text)| (at, text.trim()));
        lines.filter(move |(_, text)| begins_with_number(text)).map(|(at, text)| Line {
            path: &self.path,
            number: at as u64 + 1,
            cells: text.split([',', ' ', '\t']).filter(|cell| !cell.is_empty()).collect(),
        })
    }
}

impl Line<'_> {
    fn wrong(&self, problem: impl Into<String>) -> SequenceError {
        SequenceError::Row { path: self.path.to_path_buf(), line: self.number, problem: problem.into() }
    }

    fn cell(&self, index: usize) -> Result<&str, SequenceError> {
        let cut_off = || self.wrong(format!("it has {} numbers: the row is cut off", self.cells.len()));
        self.cells.get(index).copied().ok_or_else(cut_off)
    }

    fn stamp_ns(&self) -> Result<i64, SequenceError> {
        let text = self.cell(0)?;
        text.parse().map_err(|_| self.wrong(format!("\"{text}\" is no time in whole nanoseconds")))
    }

    fn number(&self, index: usize) -> Result<f64, SequenceError> {
        let text = self.cell(index)?;
        let number = text.parse().ok().filter(|number: &f64| number.is_finite());
        number.ok_or_else(|| self.wrong(format!("\"{text}\" is no finite number")))
    }

    fn vector(&self, first: usize) -> Result<Vector3<f64>, SequenceError> {
        Ok(Vector3::new(self.number(first)?, self.number(first + 1)?, self.number(first + 2)?))
    }

    /// A translation and a quaternion (x, y, z, w).
    fn pose(&self, first: usize) -> Result<Pose, SequenceError> {
        let translation = self.vector(first)?;
        let [x, y, z, w] = [3, 4, 5, 6].map(|offset| self.number(first + offset));
        let quaternion = Quaternion::new(w?, x?, y?, z?);
        if (quaternion.norm() - 1.0).abs() > QUATERNION_TOLERANCE {
            return Err(self.wrong(format!("the quaternion has the length {:.3}, not 1", quaternion.norm())));
        }
        Ok(Pose::new(UnitQuaternion::from_quaternion(quaternion), translation))
    }
}

/// Checks that an instant comes after the one before.
fn check_order(line: &Line<'_>, last_ns: Option<i64>, stamp_ns: i64) -> Result<(), SequenceError> {
    match last_ns.filter(|last_ns| *last_ns >= stamp_ns) {
        Some(last_ns) => {
            Err(line.wrong(format!("{stamp_ns} ns is not after {last_ns} ns of the row before")))
        }
        None => Ok(()),
    }
}

fn read_imu(path: &Path) -> Result<Vec<ImuSample>, SequenceError> {
    let numbers = Numbers::read(path, "it has the readings of the IMU")?;
    let mut readings: Vec<ImuSample> = Vec::new();
    for line in numbers.lines() {
        let stamp_ns = line.stamp_ns()?;
        check_order(&line, readings.last().map(|last| last.stamp_ns), stamp_ns)?;
        readings.push(ImuSample { stamp_ns, gyroscope: line.vector(1)?, accelerometer: line.vector(4)? });
    }
    Ok(readings)
}

/// The images of a camera by their frame id.
fn images(root: &Path, camera: usize) -> Result<BTreeMap<String, PathBuf>, SequenceError> {
    let folder = root.join(IMAGES).join(format!("cam{camera}"));
    let io = |source| SequenceError::io(&folder, source);
    let mut images = BTreeMap::new();
    for entry in std::fs::read_dir(&folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if let Some(id) = path.file_stem().and_then(|stem| stem.to_str()) {
            images.insert(id.to_owned(), path);
        }
    }
    Ok(images)
}

/// The frames that have an image of camera 0.
fn read_frames(root: &Path, time_offset_ns: i64) -> Result<(Vec<Frame>, PairCounts), SequenceError> {
    let times = Numbers::read(&root.join("times.txt"), "it has the times of the images")?;
    let mut of_cameras = [images(root, 0)?, images(root, 1)?];
    let mut frames: Vec<Frame> = Vec::new();
    let mut pairs = PairCounts::default();
    for line in times.lines() {
        let (stamp_ns, time_s) = (line.stamp_ns()?, line.number(1)?);
        if (stamp_ns as f64 * 1e-9 - time_s).abs() > STAMP_TOLERANCE_S {
            return Err(
                line.wrong(format!("the frame id is a time in nanoseconds, but is not that of {time_s} s"))
            );
        }
        let stamp_ns = stamp_ns + time_offset_ns;
        check_order(&line, frames.last().map(|last| last.stamp_ns), stamp_ns)?;
        let id = line.cell(0)?;
        let [first, second] = &mut of_cameras;
        match (first.remove(id), second.remove(id)) {
            (Some(first), second) => {
                let images = [Some(first), second].into_iter().enumerate();
                let images: BTreeMap<usize, ImageData> =
                    images.filter_map(|(camera, path)| Some((camera, ImageData::File(path?)))).collect();
                *if images.len() == CAMERAS { &mut pairs.pairs } else { &mut pairs.lone_first } += 1;
                frames.push(Frame { stamp_ns, images, ..Frame::default() });
            }
            (None, Some(_)) => pairs.lone_second += 1,
            (None, None) => {}
        }
    }
    if frames.is_empty() {
        let advice =
            "no image in distorted_images/cam0 has one of its frame ids: unpack the images of this recording";
        return Err(SequenceError::empty(&times.path, advice));
    }
    Ok((frames, pairs))
}

/// What takes the poses of the dataset to those of its IMU in the local frame of GNSS.
struct Transforms {
    /// `TS_cam_imu`.
    camera_from_imu: Pose,
    /// `transform_w_gpsw⁻¹ transform_S_AS`, where both are known.
    gpsw_from_world: Option<Pose>,
}

impl Transforms {
    fn read(path: &Path) -> Result<Self, SequenceError> {
        let numbers = Numbers::read(path, "it has the pose of the camera on the IMU, TS_cam_imu")?;
        let lines: Vec<Line<'_>> = numbers.lines().collect();
        // The numbers stand below the comment that names them.
        let named = |name: &str| {
            let at = numbers.text.lines().position(|text| text.starts_with('#') && text.contains(name))?;
            lines.iter().find(|line| line.number > at as u64 + 1).map(|line| line.pose(0))
        };
        let problem = "it has no TS_cam_imu, the pose of the camera on the IMU";
        let camera_from_imu =
            named("TS_cam_imu").ok_or_else(|| SequenceError::calibration(path, problem))??;
        let to_gps = named("transform_w_gpsw").transpose()?.zip(named("transform_S_AS").transpose()?);
        let gpsw_from_world =
            to_gps.map(|(world_from_gpsw, metric_from_world)| world_from_gpsw.inverse() * metric_from_world);
        Ok(Self { camera_from_imu, gpsw_from_world })
    }
}

/// The poses by GNSS; none where they are not there.
fn read_truth(
    path: &Path,
    transforms: &Transforms,
    time_offset_ns: i64,
) -> Result<Vec<TruthRow>, SequenceError> {
    let Some(gpsw_from_world) = transforms.gpsw_from_world.filter(|_| path.is_file()) else {
        return Ok(Vec::new());
    };
    let numbers = Numbers::read(path, "it has the poses by GNSS")?;
    let mut truth: Vec<TruthRow> = Vec::new();
    for line in numbers.lines() {
        let stamp_ns = line.stamp_ns()? + time_offset_ns;
        check_order(&line, truth.last().map(|last| last.stamp_ns), stamp_ns)?;
        let (world_from_camera, scale) = (line.pose(1)?, line.number(8)?);
        let scaled = Pose::new(world_from_camera.rotation, world_from_camera.translation * scale);
        truth.push(TruthRow::of_pose(stamp_ns, gpsw_from_world * scaled * transforms.camera_from_imu));
    }
    Ok(truth)
}
