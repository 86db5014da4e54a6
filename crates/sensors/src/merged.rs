//! Rows of the IMU and frames, merged into one stream in order of time.

use super::{
    Contents, Frame, ImuSample, PairCounts, Rows, SensorCalibration, SensorError, SensorEvent, SensorSource,
    SequenceError,
};
use std::iter::Peekable;

/// A recording while it is played. See [`Recording::source`](crate::Recording::source).
pub struct RecordingSource<'a> {
    name: String,
    calibration: &'a SensorCalibration,
    contents: Contents,
    stereo_pairs: Option<PairCounts>,
    readings: Peekable<Rows<'a, ImuSample>>,
    frames: Peekable<Rows<'a, Frame>>,
    failed: bool,
}

impl<'a> RecordingSource<'a> {
    /// Merges rows that are in order of time, each for itself.
    pub(crate) fn new(
        name: String,
        calibration: &'a SensorCalibration,
        (contents, stereo_pairs): (Contents, Option<PairCounts>),
        readings: Rows<'a, ImuSample>,
        frames: Rows<'a, Frame>,
    ) -> Self {
        let (readings, frames) = (readings.peekable(), frames.peekable());
        Self { name, calibration, contents, stereo_pairs, readings, frames, failed: false }
    }

    /// Whether the next event is a reading: one at the time of a frame comes before it, and an error of either comes
    /// at once.
    fn reading_is_next(&mut self) -> bool {
        match (self.readings.peek(), self.frames.peek()) {
            (Some(Ok(reading)), Some(Ok(frame))) => reading.stamp_ns <= frame.stamp_ns,
            (Some(Err(_)), _) | (Some(_), None) => true,
            (None, _) | (_, Some(Err(_))) => false,
        }
    }

    fn read_next(&mut self) -> Result<Option<SensorEvent>, SequenceError> {
        Ok(if self.reading_is_next() {
            self.readings.next().transpose()?.map(SensorEvent::Imu)
        } else {
            self.frames.next().transpose()?.map(SensorEvent::Frame)
        })
    }
}

impl SensorSource for RecordingSource<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn calibration(&self) -> &SensorCalibration {
        self.calibration
    }

    fn contents(&self) -> Contents {
        self.contents
    }

    fn stereo_pairs(&self) -> Option<PairCounts> {
        self.stereo_pairs
    }

    fn next(&mut self) -> Result<Option<SensorEvent>, SensorError> {
        if self.failed {
            return Ok(None);
        }
        let next = self.read_next();
        self.failed = next.is_err();
        Ok(next?)
    }
}
