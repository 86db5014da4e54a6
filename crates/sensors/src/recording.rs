//! A recorded run that is read while it is played, so that its length does not matter.
//!
//! On disk every table is read row by row; [`Recording::open`] reads all of them once and keeps none of it, so that a
//! damaged row is known before the run and not in the middle of it. A [`Sequence`] in memory is played alike.

use super::frames::FrameRows;
use super::rows::{Stamped, TimedRow, TimedRows};
use super::{CameraSensor, Frame, ImuSample, ImuSensor, Sequence, SequenceError, TruthRow, gravity, sensor};
use nalgebra::Vector3;
use std::cell::OnceCell;
use std::path::{Path, PathBuf};

/// Rows of a recording in order of time, one after the other. They end with the first error.
pub type Rows<'a, T> = Box<dyn Iterator<Item = Result<T, SequenceError>> + 'a>;

/// The IMU is kept from so long before an excerpt to so long after, nanoseconds.
const IMU_LEAD_NS: i64 = 100_000_000;
/// Truth alike: it is interpolated at the ends.
const TRUTH_LEAD_NS: i64 = 300_000_000;

/// A recorded run whose rows are read when they are needed.
#[derive(Clone, Debug)]
pub struct Recording<'a> {
    /// Where it lies.
    pub root: PathBuf,
    /// The IMU, if there is one.
    pub imu: Option<ImuSensor>,
    /// One camera, or two of a stereo pair.
    pub cameras: Vec<CameraSensor>,
    source: Source<'a>,
    contents: Contents,
    /// First and last instant that is played, nanoseconds.
    span_ns: (i64, i64),
    gravity: OnceCell<Option<Vector3<f64>>>,
}

#[derive(Clone, Copy, Debug)]
enum Source<'a> {
    Folder,
    Memory(&'a Sequence),
}

/// What there is in a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Contents {
    /// Instants at which a camera looked.
    pub frames: usize,
    /// Whether camera 0 has an image of any of them.
    pub images: bool,
    /// Whether anything is tracked in any of them.
    pub tracks: bool,
    /// Whether any of them has features for place recognition.
    pub features: bool,
}

impl Contents {
    fn add(&mut self, frame: &Frame) {
        self.frames += 1;
        self.images |= frame.images[0].is_some();
        self.tracks |= !frame.tracks.is_empty();
        self.features |= frame.features.is_some();
    }
}

impl Recording<'static> {
    /// Opens a recording on disk, and checks every row that a run needs.
    ///
    /// # Errors
    /// As [`Sequence::open`].
    pub fn open(root: &Path) -> Result<Self, SequenceError> {
        let mut recording = Self::open_unchecked(root)?;
        let mut contents = Contents::default();
        for frame in recording.frames()? {
            contents.add(&frame?);
        }
        recording.contents = contents;
        recording.imu_samples()?.try_for_each(|sample| sample.map(drop))?;
        recording.truth()?.try_for_each(|row| row.map(drop))?;
        Ok(recording)
    }

    /// Opens a recording and reads nothing but the calibrations; its contents are not known.
    pub(super) fn open_unchecked(root: &Path) -> Result<Self, SequenceError> {
        let mav = root.join("mav0");
        if !mav.is_dir() {
            let advice = "a recording is a folder with mav0/cam0 in it, as EuRoC lays it out; check the path";
            return Err(SequenceError::missing(&mav, advice));
        }
        let imu_folder = mav.join("imu0");
        let imu =
            if imu_folder.is_dir() { Some(sensor::read_imu(&imu_folder.join("sensor.yaml"))?) } else { None };
        let mut cameras = vec![sensor::read_camera(&mav.join("cam0/sensor.yaml"))?];
        if mav.join("cam1").is_dir() {
            cameras.push(sensor::read_camera(&mav.join("cam1/sensor.yaml"))?);
        }
        Ok(Self {
            root: root.to_path_buf(),
            imu,
            cameras,
            source: Source::Folder,
            contents: Contents::default(),
            span_ns: (i64::MIN, i64::MAX),
            gravity: OnceCell::new(),
        })
    }
}

impl<'a> From<&'a Sequence> for Recording<'a> {
    fn from(sequence: &'a Sequence) -> Self {
        let mut contents = Contents::default();
        for frame in &sequence.frames {
            contents.add(frame);
        }
        Self {
            root: sequence.root.clone(),
            imu: sequence.imu.clone(),
            cameras: sequence.cameras.clone(),
            source: Source::Memory(sequence),
            contents,
            span_ns: (i64::MIN, i64::MAX),
            gravity: OnceCell::new(),
        }
    }
}

impl Recording<'_> {
    /// What there is in the whole recording, also where a part of it is played.
    pub fn contents(&self) -> &Contents {
        &self.contents
    }

    /// All instants at which a camera looked, strictly increasing in time.
    ///
    /// # Errors
    /// [`SequenceError`] with the file.
    pub fn frames(&self) -> Result<Rows<'_, Frame>, SequenceError> {
        let rows: Rows<'_, Frame> = match self.source {
            Source::Folder => Box::new(FrameRows::open(&self.root.join("mav0"), self.cameras.len())?),
            Source::Memory(sequence) => Box::new(sequence.frames.iter().cloned().map(Ok)),
        };
        Ok(self.within(rows, 0))
    }

    /// The IMU's samples, strictly increasing in time and finite; none without an IMU.
    ///
    /// # Errors
    /// [`SequenceError`] with the file.
    pub fn imu_samples(&self) -> Result<Rows<'_, ImuSample>, SequenceError> {
        let rows: Rows<'_, ImuSample> = match self.source {
            Source::Folder if self.imu.is_none() => Box::new(std::iter::empty()),
            Source::Folder => table(&self.root.join("mav0/imu0/data.csv"))?,
            Source::Memory(sequence) => Box::new(sequence.imu_samples.iter().copied().map(Ok)),
        };
        Ok(self.within(rows, IMU_LEAD_NS))
    }

    /// Whether there is ground truth.
    pub fn has_truth(&self) -> bool {
        match self.source {
            Source::Folder => self.truth_path().exists(),
            Source::Memory(sequence) => sequence.groundtruth.is_some(),
        }
    }

    /// The ground truth; none where it is not known.
    ///
    /// # Errors
    /// [`SequenceError`] with the file.
    pub fn truth(&self) -> Result<Rows<'_, TruthRow>, SequenceError> {
        let rows: Rows<'_, TruthRow> = match self.source {
            Source::Folder if !self.has_truth() => Box::new(std::iter::empty()),
            Source::Folder => table(&self.truth_path())?,
            Source::Memory(sequence) => Box::new(sequence.groundtruth.iter().flatten().copied().map(Ok)),
        };
        Ok(self.within(rows, TRUTH_LEAD_NS))
    }

    fn truth_path(&self) -> PathBuf {
        self.root.join("mav0/state_groundtruth_estimate0/data.csv")
    }

    /// Unit direction in which gravity pulls, in the frame of the ground truth.
    ///
    /// Estimated from truth and IMU over the run, and taken for a coordinate axis within 3 degrees of one. `None`
    /// where truth or IMU is missing, or where they contradict each other.
    ///
    /// # Errors
    /// [`SequenceError`] with the file and the line.
    pub fn truth_gravity(&self) -> Result<Option<Vector3<f64>>, SequenceError> {
        if let Some(known) = self.gravity.get() {
            return Ok(*known);
        }
        let found = gravity::direction(self.truth()?, self.imu_samples()?)?;
        Ok(*self.gravity.get_or_init(|| found))
    }

    /// The part from `from_ns` to `to_ns`, as if nothing else had been recorded.
    pub fn between(self, from_ns: i64, to_ns: i64) -> Self {
        Self { span_ns: (from_ns, to_ns), gravity: OnceCell::new(), ..self }
    }

    /// The rows within the part that is played, and within `lead_ns` of it.
    fn within<'a, T: Stamped + 'a>(&self, rows: Rows<'a, T>, lead_ns: i64) -> Rows<'a, T> {
        let from_ns = self.span_ns.0.saturating_sub(lead_ns);
        let to_ns = self.span_ns.1.saturating_add(lead_ns);
        // Errors are handed on wherever they are.
        let early = move |row: &Result<T, _>| row.as_ref().is_ok_and(|row: &T| row.stamp_ns() < from_ns);
        let due = move |row: &Result<T, _>| row.as_ref().map_or(true, |row: &T| row.stamp_ns() <= to_ns);
        Box::new(rows.skip_while(early).take_while(due))
    }
}

fn table<'a, T: TimedRow + 'a>(path: &Path) -> Result<Rows<'a, T>, SequenceError> {
    Ok(Box::new(TimedRows::open(path)?))
}
