//! Rows of IMU, wheels, GNSS and frames, merged into one stream in order of time.

use super::{
    Contents, Frame, GnssReading, ImuSample, PairCounts, Rows, SensorCalibration, SensorError, SensorEvent,
    SensorSource, SequenceError, WheelReading,
};
use std::iter::Peekable;

/// A recording while it is played. See [`Recording::source`](crate::Recording::source).
pub struct RecordingSource<'a> {
    name: String,
    calibration: &'a SensorCalibration,
    contents: Contents,
    stereo_pairs: Option<PairCounts>,
    readings: Peekable<Rows<'a, ImuSample>>,
    wheels: Peekable<Rows<'a, WheelReading>>,
    gnss: Peekable<Rows<'a, GnssReading>>,
    frames: Peekable<Rows<'a, Frame>>,
    failed: bool,
}

impl<'a> RecordingSource<'a> {
    /// Merges rows that are in order of time, each for itself.
    pub(crate) fn new(
        name: String,
        calibration: &'a SensorCalibration,
        (contents, stereo_pairs): (Contents, Option<PairCounts>),
        (readings, wheels, gnss): (Rows<'a, ImuSample>, Rows<'a, WheelReading>, Rows<'a, GnssReading>),
        frames: Rows<'a, Frame>,
    ) -> Self {
        let (readings, frames) = (readings.peekable(), frames.peekable());
        let (wheels, gnss) = (wheels.peekable(), gnss.peekable());
        Self { name, calibration, contents, stereo_pairs, readings, wheels, gnss, frames, failed: false }
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

    /// Whether the next event is a reading of the wheels: one at the time of another event comes before it. Wheels go on for no
    /// longer than the rest.
    fn wheels_are_next(&mut self) -> bool {
        let stamp_ns = match self.wheels.peek() {
            Some(Ok(reading)) => reading.stamp_ns,
            other => return other.is_some(),
        };
        let is_before = |position: &Result<GnssReading, SequenceError>| {
            position.as_ref().map_or(true, |position| stamp_ns <= position.stamp_ns)
        };
        self.gnss.peek().is_none_or(is_before) && self.is_before_the_rest(stamp_ns)
    }

    /// The same of a position of GNSS.
    fn gnss_is_next(&mut self) -> bool {
        let stamp_ns = match self.gnss.peek() {
            Some(Ok(reading)) => reading.stamp_ns,
            other => return other.is_some(),
        };
        self.is_before_the_rest(stamp_ns)
    }

    fn is_before_the_rest(&mut self, stamp_ns: i64) -> bool {
        let (reading, frame) = (self.readings.peek(), self.frames.peek());
        let has_rest = reading.is_some() || frame.is_some();
        has_rest
            && reading.is_none_or(|row| row.as_ref().is_ok_and(|row| stamp_ns <= row.stamp_ns))
            && frame.is_none_or(|row| row.as_ref().is_ok_and(|row| stamp_ns <= row.stamp_ns))
    }

    fn read_next(&mut self) -> Result<Option<SensorEvent>, SequenceError> {
        Ok(if self.wheels_are_next() {
            self.wheels.next().transpose()?.map(SensorEvent::Wheels)
        } else if self.gnss_is_next() {
            self.gnss.next().transpose()?.map(SensorEvent::Gnss)
        } else if self.reading_is_next() {
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
