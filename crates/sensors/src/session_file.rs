//! Session files that robots hand in, as recordings: tracks, and features of keyframe candidates.

use super::rows::{Rows, rows_of};
use super::stored::Stored;
use super::{Frame, ImuSample, PairCounts, SensorCalibration, SequenceError};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A session in memory.
#[derive(Debug)]
pub(crate) struct SessionRecording {
    path: PathBuf,
    readings: Arc<[ImuSample]>,
    frames: Arc<[Frame]>,
}

impl SessionRecording {
    /// Reads a session, with the calibration that it states itself.
    ///
    /// # Errors
    /// [`SequenceError::Session`].
    pub(crate) fn open(path: &Path) -> Result<(Self, SensorCalibration), SequenceError> {
        let session = hand_in::Session::open(path)?;
        let header = session.header;
        let calibration = SensorCalibration {
            imu: Some(header.imu),
            cameras: header.cameras,
            ..SensorCalibration::default()
        };
        let frames = session.frames.into_iter().map(|frame| {
            let candidates = frame.candidates.into_iter();
            let features = candidates.map(|candidate| (candidate.camera, candidate.features)).collect();
            Frame { stamp_ns: frame.stamp_ns, tracks: frame.tracks, features, ..Frame::default() }
        });
        let (path, readings) = (path.to_path_buf(), session.readings.into());
        Ok((Self { path, readings, frames: frames.collect() }, calibration))
    }
}

impl Stored for SessionRecording {
    fn frames(&self) -> Result<Rows<'static, Frame>, SequenceError> {
        Ok(rows_of(&self.frames))
    }

    fn imu_samples(&self) -> Result<Rows<'static, ImuSample>, SequenceError> {
        Ok(rows_of(&self.readings))
    }

    /// The stamps of a session are those that the estimator used.
    fn time_offset_ns(&self) -> i64 {
        0
    }

    fn stereo_pairs(&self) -> Option<PairCounts> {
        None
    }

    fn readings_path(&self) -> PathBuf {
        self.path.clone()
    }
}
