//! A recording that is read while it is played, so that memory does not grow with its length.

use super::clock_check::ClockCheck;
use super::image_check::ImageCheck;
use super::rows::{Rows, Stamped};
use super::stored::{self, Stored};
use super::{
    CalibrationFiles, Contents, Frame, GnssReading, ImuSample, PairCounts, RecordingSource,
    SensorCalibration, Sequence, SequenceError, TruthRow, WheelReading, gravity,
};
use geometry::Pose;
use nalgebra::Vector3;
use std::cell::OnceCell;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Readings of IMU and wheels are part of an excerpt from so long before it to so long after it, nanoseconds.
const IMU_LEAD_NS: i64 = 100_000_000;
/// The same for the ground truth, which is interpolated at the ends.
const TRUTH_LEAD_NS: i64 = 300_000_000;

/// A recorded run on disk or in memory, or an excerpt of one.
///
/// It can be read any number of times: [`Recording::source`] plays it from the beginning; ground truth and single
/// sensors are read by their own methods.
///
/// ```no_run
/// use sensors::{Recording, SensorEvent, SensorSource};
///
/// let recording = Recording::open("MH_01_easy".as_ref())?;
/// let mut source = recording.source()?;
/// while let Some(event) = source.next()? {
///     match event {
///         SensorEvent::Imu(reading) => println!("{} ns: {} rad/s", reading.stamp_ns, reading.gyroscope.norm()),
///         SensorEvent::Frame(frame) => println!("{} ns: {} tracks", frame.stamp_ns, frame.tracks.len()),
///         _ => {}
///     }
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Recording<'a> {
    root: PathBuf,
    calibration: SensorCalibration,
    storage: Storage<'a>,
    contents: Contents,
    /// First and last instant of the excerpt, nanoseconds.
    span_ns: (i64, i64),
    gravity: OnceCell<Option<Vector3<f64>>>,
}

/// Where the rows are.
#[derive(Clone, Debug)]
enum Storage<'a> {
    Disk(Arc<dyn Stored>),
    Memory(&'a Sequence),
}

impl Recording<'static> {
    /// Opens a recording: a folder in the EuRoC layout, or a bag (MCAP, rosbag2, rosbag1).
    ///
    /// Every row that a run needs is read once and checked, and nothing of it kept: a damaged row is found now, and
    /// not in the middle of the run.
    ///
    /// # Errors
    /// As [`Sequence::open`].
    pub fn open(root: &Path) -> Result<Self, SequenceError> {
        Self::open_with(root, &CalibrationFiles::default())
    }

    /// [`Recording::open`] with calibration files in place of the recording's own, and the names of a bag's topics.
    ///
    /// # Errors
    /// As [`Sequence::open`].
    pub fn open_with(root: &Path, files: &CalibrationFiles) -> Result<Self, SequenceError> {
        let (stored, calibration) = stored::open(root, files)?;
        let mut contents = Contents::default();
        let mut images = ImageCheck::default();
        let mut clocks = ClockCheck::default();
        for frame in stored.frames()? {
            let frame = frame?;
            images.add(&frame, &calibration.cameras)?;
            contents.add(&frame);
            clocks.add_image(frame.stamp_ns);
        }
        let imu = calibration.imu.as_ref();
        stored::check_readings(&*stored, imu, |reading| clocks.add_reading(reading.stamp_ns))?;
        clocks.finish(root)?;
        for reading in stored.wheel_readings()? {
            reading?;
            contents.wheels = Some(stored.wheels_are());
        }
        for reading in stored.gnss_readings()? {
            reading?;
            contents.gnss = true;
        }
        stored.truth()?.try_for_each(|row| row.map(drop))?;
        Ok(Self {
            root: root.to_path_buf(),
            calibration,
            storage: Storage::Disk(stored),
            contents,
            span_ns: (i64::MIN, i64::MAX),
            gravity: OnceCell::new(),
        })
    }
}

impl<'a> From<&'a Sequence> for Recording<'a> {
    fn from(sequence: &'a Sequence) -> Self {
        Self {
            root: sequence.root.clone(),
            calibration: sequence.calibration(),
            storage: Storage::Memory(sequence),
            contents: sequence.contents(),
            span_ns: (i64::MIN, i64::MAX),
            gravity: OnceCell::new(),
        }
    }
}

impl Recording<'_> {
    /// The folder or the bag of the recording; empty where it was never on disk.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Calibration of the sensors.
    pub fn calibration(&self) -> &SensorCalibration {
        &self.calibration
    }

    /// What was added to the recorded stamps of the frames to obtain those of the IMU's clock: Kalibr's
    /// `timeshift_cam_imu` of camera 0 (ns).
    pub fn time_offset_ns(&self) -> i64 {
        match &self.storage {
            Storage::Disk(stored) => stored.time_offset_ns(),
            Storage::Memory(_) => 0,
        }
    }

    /// What the frames carry: of the whole recording, also where this is an excerpt of it.
    pub fn contents(&self) -> Contents {
        self.contents
    }

    /// Stereo pairs and images without a partner, of the whole recording; `None` without a stereo pair.
    pub fn stereo_pairs(&self) -> Option<PairCounts> {
        match &self.storage {
            Storage::Disk(stored) => stored.stereo_pairs(),
            Storage::Memory(sequence) => sequence.stereo_pairs(),
        }
    }

    /// Plays the recording from its beginning: IMU readings and frames in one stream.
    ///
    /// # Errors
    /// [`SequenceError`] with the file that cannot be opened.
    pub fn source(&self) -> Result<RecordingSource<'_>, SequenceError> {
        let readings = (self.imu_samples()?, self.wheel_readings()?, self.gnss_readings()?);
        let frames = self.frames()?;
        let name = self.root.display().to_string();
        let about = (self.contents, self.stereo_pairs());
        Ok(RecordingSource::new(name, &self.calibration, about, readings, frames))
    }

    /// The frames, strictly increasing in time.
    ///
    /// # Errors
    /// [`SequenceError`] with the file.
    pub fn frames(&self) -> Result<Rows<'_, Frame>, SequenceError> {
        let rows: Rows<'_, Frame> = match &self.storage {
            Storage::Disk(stored) => stored.frames()?,
            Storage::Memory(sequence) => Box::new(sequence.frames.iter().cloned().map(Ok)),
        };
        Ok(self.within(rows, 0))
    }

    /// The IMU's readings, strictly increasing in time and finite; none without an IMU.
    ///
    /// # Errors
    /// [`SequenceError`] with the file.
    pub fn imu_samples(&self) -> Result<Rows<'_, ImuSample>, SequenceError> {
        let rows: Rows<'_, ImuSample> = match &self.storage {
            Storage::Disk(stored) => stored.imu_samples()?,
            Storage::Memory(sequence) => Box::new(sequence.imu_samples.iter().copied().map(Ok)),
        };
        Ok(self.within(rows, IMU_LEAD_NS))
    }

    /// The readings of the wheels, strictly increasing in time and finite; none without wheels.
    ///
    /// # Errors
    /// [`SequenceError`] with the file.
    pub fn wheel_readings(&self) -> Result<Rows<'_, WheelReading>, SequenceError> {
        let rows: Rows<'_, WheelReading> = match &self.storage {
            Storage::Disk(stored) => stored.wheel_readings()?,
            Storage::Memory(sequence) => Box::new(sequence.wheel_readings.iter().copied().map(Ok)),
        };
        Ok(self.within(rows, IMU_LEAD_NS))
    }

    /// The positions of GNSS in the frame of the map, strictly increasing in time; none without it.
    ///
    /// # Errors
    /// [`SequenceError`] with the file.
    pub fn gnss_readings(&self) -> Result<Rows<'_, GnssReading>, SequenceError> {
        let rows: Rows<'_, GnssReading> = match &self.storage {
            Storage::Disk(stored) => stored.gnss_readings()?,
            Storage::Memory(sequence) => Box::new(sequence.gnss_readings.iter().copied().map(Ok)),
        };
        Ok(self.within(rows, IMU_LEAD_NS))
    }

    /// Where a frame of the robot is on the IMU, by the `/tf_static` of a bag; `None` where that is not recorded.
    ///
    /// # Arguments
    /// * `base`: name of the frame, `base_link` by REP-105.
    pub fn imu_from_base(&self, base: &str) -> Option<Pose> {
        match &self.storage {
            Storage::Disk(stored) => stored.imu_from_base(base),
            Storage::Memory(_) => None,
        }
    }

    /// Whether there is ground truth.
    pub fn has_truth(&self) -> bool {
        match &self.storage {
            Storage::Disk(stored) => stored.has_truth(),
            Storage::Memory(sequence) => sequence.groundtruth.is_some(),
        }
    }

    /// The ground truth; none where it is not known.
    ///
    /// # Errors
    /// [`SequenceError`] with the file.
    pub fn truth(&self) -> Result<Rows<'_, TruthRow>, SequenceError> {
        let rows: Rows<'_, TruthRow> = match &self.storage {
            Storage::Disk(stored) => stored.truth()?,
            Storage::Memory(sequence) => Box::new(sequence.groundtruth.iter().flatten().copied().map(Ok)),
        };
        Ok(self.within(rows, TRUTH_LEAD_NS))
    }

    /// Unit direction of gravity in the frame of the ground truth.
    ///
    /// Estimated from ground truth and IMU over the whole run; a direction within 3 degrees of a coordinate axis is
    /// taken to be that axis. `None` where ground truth or IMU is missing, or where they contradict each other.
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

    /// The excerpt from `from_ns` to `to_ns`, as if nothing else had been recorded.
    pub fn between(self, from_ns: i64, to_ns: i64) -> Self {
        Self { span_ns: (from_ns, to_ns), gravity: OnceCell::new(), ..self }
    }

    /// The rows within the excerpt and within `lead_ns` of it.
    fn within<'a, T: Stamped + 'a>(&self, rows: Rows<'a, T>, lead_ns: i64) -> Rows<'a, T> {
        let from_ns = self.span_ns.0.saturating_sub(lead_ns);
        let to_ns = self.span_ns.1.saturating_add(lead_ns);
        // Errors are passed on wherever they are.
        let early = move |row: &Result<T, _>| row.as_ref().is_ok_and(|row: &T| row.stamp_ns() < from_ns);
        let due = move |row: &Result<T, _>| row.as_ref().map_or(true, |row: &T| row.stamp_ns() <= to_ns);
        Box::new(rows.skip_while(early).take_while(due))
    }
}
