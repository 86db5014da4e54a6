//! Recordings on disk, whatever their format.

use super::clock_check::ClockCheck;
use super::euroc::Folder;
use super::four_seasons;
use super::image_check::ImageCheck;
use super::imu_check::ImuCheck;
use super::rows::Rows;
use super::session_file::SessionRecording;
use super::{
    CalibrationFiles, Frame, GnssReading, ImuSample, ImuSensor, PairCounts, ReferencePose, SensorCalibration,
    Sequence, SequenceError, TruthRow, WheelReading, WheelReadings,
};
use geometry::Pose;
use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The rows of a recording on disk. Every call reads them from the beginning.
pub(crate) trait Stored: Debug + Send + Sync {
    /// The frames, strictly increasing in time, with the calibrated time offset of the cameras added to their stamps.
    fn frames(&self) -> Result<Rows<'static, Frame>, SequenceError>;

    /// The IMU's readings, strictly increasing in time and finite; none without an IMU.
    fn imu_samples(&self) -> Result<Rows<'static, ImuSample>, SequenceError>;

    /// The readings of the wheels, strictly increasing in time and finite; none without wheels.
    fn wheel_readings(&self) -> Result<Rows<'static, WheelReading>, SequenceError> {
        Ok(Box::new(std::iter::empty()))
    }

    /// What the readings of the wheels are.
    fn wheels_are(&self) -> WheelReadings {
        WheelReadings::Speeds
    }

    /// The positions of GNSS, strictly increasing in time and finite; none without it.
    fn gnss_readings(&self) -> Result<Rows<'static, GnssReading>, SequenceError> {
        Ok(Box::new(std::iter::empty()))
    }

    /// What was added to the recorded stamps of the frames (ns).
    fn time_offset_ns(&self) -> i64;

    /// Stereo pairs and images without a partner; `None` without a stereo pair.
    fn stereo_pairs(&self) -> Option<PairCounts>;

    /// What the readings are read from, for errors.
    fn readings_path(&self) -> PathBuf;

    /// Where a frame of the robot is on the IMU, where the recording itself states that.
    fn imu_from_base(&self, _base: &str) -> Option<Pose> {
        None
    }

    /// Whether there is ground truth.
    fn has_truth(&self) -> bool {
        false
    }

    /// The ground truth; none where it is not known.
    fn truth(&self) -> Result<Rows<'static, TruthRow>, SequenceError> {
        Ok(Box::new(std::iter::empty()))
    }

    /// Poses to build a map from, if there are any.
    fn reference_poses(&self) -> Result<Option<Vec<ReferencePose>>, SequenceError> {
        Ok(None)
    }
}

/// Whether a path is a recording rather than an image: a folder, a bag, or a session file.
pub fn is_recording(path: &Path) -> bool {
    #[cfg(feature = "bags")]
    if bags::Bag::is_bag(path) {
        return true;
    }
    path.is_dir() || hand_in::Session::is_session(path)
}

/// Opens a recording with its calibration: a folder in the layout of EuRoC or of 4Seasons, a bag, or a session file.
pub(crate) fn open(
    root: &Path,
    files: &CalibrationFiles,
) -> Result<(Arc<dyn Stored>, SensorCalibration), SequenceError> {
    let (stored, calibration) = open_any(root, files)?;
    if let Some(pairs) = stored.stereo_pairs() {
        pairs.tell(&root.display().to_string(), files.pair_tolerance_ns());
    }
    Ok((stored, calibration))
}

fn open_any(
    root: &Path,
    files: &CalibrationFiles,
) -> Result<(Arc<dyn Stored>, SensorCalibration), SequenceError> {
    #[cfg(feature = "bags")]
    if bags::Bag::is_bag(root) {
        let (bag, calibration) = super::bag::BagRecording::open(root, files)?;
        return Ok((Arc::new(bag), calibration));
    }
    for topic in files.topics() {
        tracing::warn!(topic, "{} is no bag and has no topics: this one is not used", root.display());
    }
    if hand_in::Session::is_session(root) {
        let (session, calibration) = SessionRecording::open(root)?;
        return Ok((Arc::new(session), calibration));
    }
    #[cfg(feature = "bags")]
    if root.is_file() {
        return Err(bags::BagError::UnknownFormat { path: root.to_owned() }.into());
    }
    if four_seasons::is_recording(root) {
        let (recording, calibration) = four_seasons::Recording::open(root, files)?;
        return Ok((Arc::new(recording), calibration));
    }
    let (folder, calibration) = Folder::open(root, files)?;
    Ok((Arc::new(folder), calibration))
}

/// Reads all readings of the IMU, checks their units, and hands each to `keep`.
pub(crate) fn check_readings(
    stored: &dyn Stored,
    imu: Option<&ImuSensor>,
    mut keep: impl FnMut(&ImuSample),
) -> Result<(), SequenceError> {
    let in_file = |source| SequenceError::ImuUnits { path: stored.readings_path(), source };
    let mut check = ImuCheck::new(imu.and_then(|imu| imu.gravity_magnitude));
    for sample in stored.imu_samples()? {
        let sample = sample?;
        check.add(&sample).map_err(in_file)?;
        keep(&sample);
    }
    check.finish().map_err(in_file)
}

impl Sequence {
    /// Reads a folder in the layout of EuRoC or of 4Seasons, or a bag, into memory, and checks all of it. Images stay on disk.
    ///
    /// # Errors
    /// [`SequenceError`] with the file, the line, and what to do: a missing calibration or table, a row that is cut
    /// off or not finite, time stamps out of order, readings in other units, images of another size than calibrated,
    /// tracks or features of an image that is not listed, a camera model or a descriptor that is not supported, a bag
    /// whose topics cannot be told apart.
    pub fn open(root: &Path) -> Result<Self, SequenceError> {
        Self::open_with(root, &CalibrationFiles::default())
    }

    /// [`Sequence::open`] with calibration files in place of the recording's own.
    ///
    /// # Errors
    /// As [`Sequence::open`].
    pub fn open_with(root: &Path, files: &CalibrationFiles) -> Result<Self, SequenceError> {
        Self::open_with_offset(root, files).map(|(sequence, _)| sequence)
    }

    /// [`Sequence::open_with`], and what was added to the recorded stamps of the frames, nanoseconds, as
    /// [`Recording::time_offset_ns`](crate::Recording::time_offset_ns).
    ///
    /// # Errors
    /// As [`Sequence::open`].
    pub fn open_with_offset(root: &Path, files: &CalibrationFiles) -> Result<(Self, i64), SequenceError> {
        let mut imu_samples = Vec::new();
        let (sequence, time_offset_ns) = Self::read(root, files, |sample| imu_samples.push(*sample))?;
        Ok((Self { imu_samples, ..sequence }, time_offset_ns))
    }

    /// [`Sequence::open_with`] without the readings of the IMU, which are checked and not kept: `imu_samples` is empty.
    ///
    /// For what needs frames and poses only, as building a map does: an hour of readings takes 40 MB.
    ///
    /// # Errors
    /// As [`Sequence::open`].
    pub fn open_without_readings(root: &Path, files: &CalibrationFiles) -> Result<Self, SequenceError> {
        Self::read(root, files, |_| {}).map(|(sequence, _)| sequence)
    }

    /// Reads and checks everything; the readings of the IMU go to `keep`. Beside it what was added to the stamps of the frames.
    fn read(
        root: &Path,
        files: &CalibrationFiles,
        mut keep: impl FnMut(&ImuSample),
    ) -> Result<(Self, i64), SequenceError> {
        let (stored, SensorCalibration { imu, cameras, wheels, gnss }) = open(root, files)?;
        let mut clocks = ClockCheck::default();
        check_readings(&*stored, imu.as_ref(), |reading| {
            clocks.add_reading(reading.stamp_ns);
            keep(reading);
        })?;
        let mut images = ImageCheck::default();
        let mut frames = Vec::new();
        for frame in stored.frames()? {
            let frame = frame?;
            images.add(&frame, &cameras)?;
            clocks.add_image(frame.stamp_ns);
            frames.push(frame);
        }
        clocks.finish(root)?;
        let groundtruth: Vec<TruthRow> = stored.truth()?.collect::<Result<_, _>>()?;
        let sequence = Self {
            root: root.to_path_buf(),
            imu,
            imu_samples: Vec::new(),
            wheels,
            wheel_readings: stored.wheel_readings()?.collect::<Result<_, _>>()?,
            gnss,
            gnss_readings: stored.gnss_readings()?.collect::<Result<_, _>>()?,
            cameras,
            frames,
            groundtruth: (!groundtruth.is_empty()).then_some(groundtruth),
            reference_poses: stored.reference_poses()?,
        };
        Ok((sequence, stored.time_offset_ns()))
    }
}
