//! Reads a sensor source ahead, and hands out its readings and frames, each for itself.

use super::imu_window::{Checked, ImuWindow};
use sensors::live::LiveReport;
use sensors::{
    Frame, GnssReading, PairCounts, SensorError, SensorEvent, SensorSource, WheelReading, push_newest,
};
use std::collections::VecDeque;

/// A frame waits for the reading after it for so long at most, nanoseconds of sensor time. An IMU that is silent for
/// longer is taken to have stopped; without a bound, all frames up to its next reading would be held in memory.
const MAX_IMU_WAIT_NS: i64 = 60_000_000_000;

/// The same of a live source, which gives a frame as soon as the reading after it has come: only one that is refused is waited for.
/// Readings of a new level are taken again after 0.1 s. Frames that are older than this are of no use to a robot that drives.
const MAX_LIVE_IMU_WAIT_NS: i64 = 500_000_000;

/// Readings of the wheels that are read ahead at most; where no frame comes for longer, the oldest ones are dropped.
const MAX_WHEEL_READINGS: usize = 1 << 16;

/// The same of positions of GNSS.
const MAX_GNSS_READINGS: usize = 1 << 12;

/// What comes next.
#[derive(Debug, PartialEq)]
pub(crate) enum NextFrame {
    Frame(Frame),
    /// A live source has no frame at the moment.
    Tick,
    End,
}

/// What was read.
#[derive(PartialEq)]
enum Read {
    Event,
    Tick,
    End,
}

/// Events of a source that were read and not handed out yet.
pub(crate) struct SensorQueue<'a> {
    source: &'a mut dyn SensorSource,
    /// Readings up to the newest that was read.
    pub(crate) imu: ImuWindow,
    frames: VecDeque<Frame>,
    wheels: VecDeque<WheelReading>,
    gnss: VecDeque<GnssReading>,
    /// Measurements arrive now.
    is_live: bool,
    /// Frames without readings that were dropped for newer ones.
    dropped_frames: Vec<Frame>,
    /// The source has ended or failed.
    ended: bool,
    error: Option<SensorError>,
}

impl<'a> SensorQueue<'a> {
    /// Nothing is read yet.
    pub(crate) fn new(source: &'a mut dyn SensorSource) -> Self {
        let rate_hz = source.calibration().imu.as_ref().map_or(1.0, |imu| imu.rate_hz);
        let imu = ImuWindow::new(rate_hz);
        let (frames, wheels, gnss) = (VecDeque::new(), VecDeque::new(), VecDeque::new());
        let is_live = source.live().is_some();
        Self {
            source,
            imu,
            frames,
            wheels,
            gnss,
            is_live,
            dropped_frames: Vec::new(),
            ended: false,
            error: None,
        }
    }

    /// What the source says of itself, if it is live.
    pub(crate) fn live(&self) -> Option<LiveReport> {
        self.source.live()
    }

    /// Stereo pairs and images without a partner; `None` without a stereo pair.
    pub(crate) fn stereo_pairs(&self) -> Option<PairCounts> {
        self.source.stereo_pairs()
    }

    /// The next frame, or that there is none now.
    ///
    /// # Errors
    /// That of the source, after the frames before it.
    pub(crate) fn next_frame(&mut self) -> Result<NextFrame, SensorError> {
        while self.frames.is_empty() {
            match self.read() {
                Read::Event => {}
                Read::Tick => return Ok(NextFrame::Tick),
                Read::End => break,
            }
        }
        match self.frames.pop_front() {
            Some(frame) => Ok(NextFrame::Frame(frame)),
            None => self.error.take().map_or(Ok(NextFrame::End), Err),
        }
    }

    /// Time of the next frame of a recording, nanoseconds; `None` after the last, or where the source fails before it.
    pub(crate) fn next_frame_ns(&mut self) -> Option<i64> {
        while self.frames.is_empty() && self.read() == Read::Event {}
        self.frames.front().map(|frame| frame.stamp_ns)
    }

    /// Takes the next reading into the window, or leaves it out, for which it states why; `None` after the last, where a live source
    /// has none at the moment, or where none came up to a frame that is much newer: [`MAX_IMU_WAIT_NS`], [`MAX_LIVE_IMU_WAIT_NS`]. Of a live
    /// source, the frames before that one are dropped then, for which there are no readings either.
    ///
    /// # Arguments
    /// * `until_ns`: up to when readings are needed, nanoseconds.
    ///
    /// # Errors
    /// That of the source, after the readings before it.
    pub(crate) fn next_reading(&mut self, until_ns: i64) -> Result<Option<Checked>, SensorError> {
        let wait_ns = if self.is_live { MAX_LIVE_IMU_WAIT_NS } else { MAX_IMU_WAIT_NS };
        let horizon_ns = until_ns.saturating_add(wait_ns);
        while self.imu.ahead().is_empty() {
            if self.frames.back().is_some_and(|newest| newest.stamp_ns > horizon_ns) {
                if self.is_live {
                    let late = self.frames.len() - 1;
                    self.dropped_frames.extend(self.frames.drain(..late));
                }
                break;
            }
            if self.read() != Read::Event {
                break;
            }
        }
        match self.imu.accept() {
            Some(accepted) => Ok(Some(accepted)),
            None => self.error.take().map_or(Ok(None), Err),
        }
    }

    /// Time of the newest frame that was read and not handed out, nanoseconds.
    pub(crate) fn newest_frame_ns(&self) -> Option<i64> {
        self.frames.back().map(|frame| frame.stamp_ns)
    }

    /// Takes the frames that were dropped since the last call, as there were no readings for them.
    pub(crate) fn take_dropped_frames(&mut self) -> Vec<Frame> {
        std::mem::take(&mut self.dropped_frames)
    }

    /// The readings of the wheels that were read since the last call, in order of time.
    pub(crate) fn take_wheels(&mut self) -> impl Iterator<Item = WheelReading> + '_ {
        self.wheels.drain(..)
    }

    /// The positions of GNSS that were read since the last call, in order of time.
    pub(crate) fn take_gnss(&mut self) -> impl Iterator<Item = GnssReading> + '_ {
        self.gnss.drain(..)
    }

    /// Reads one event.
    fn read(&mut self) -> Read {
        if self.ended {
            return Read::End;
        }
        match self.source.next() {
            Ok(Some(SensorEvent::Imu(reading))) => self.imu.read_ahead(reading),
            Ok(Some(SensorEvent::Frame(frame))) => self.frames.push_back(frame),
            Ok(Some(SensorEvent::Wheels(reading))) => {
                push_newest(&mut self.wheels, reading, MAX_WHEEL_READINGS);
            }
            Ok(Some(SensorEvent::Gnss(reading))) => {
                push_newest(&mut self.gnss, reading, MAX_GNSS_READINGS);
            }
            Ok(Some(SensorEvent::Tick)) => return Read::Tick,
            // Other sensors are of no use to the estimator.
            Ok(Some(_)) => {}
            Ok(None) => self.ended = true,
            Err(error) => {
                self.ended = true;
                self.error = Some(error);
            }
        }
        if self.ended { Read::End } else { Read::Event }
    }
}

#[cfg(test)]
mod tests {
    use super::super::imu_window::MAX_AHEAD;
    use super::*;
    use estimator::ImuSample;
    use nalgebra::Vector3;
    use sensors::{Contents, SensorCalibration};

    /// Plays given events, and then fails.
    struct Script {
        calibration: SensorCalibration,
        events: VecDeque<SensorEvent>,
    }

    impl SensorSource for Script {
        fn name(&self) -> &'static str {
            "script"
        }

        fn calibration(&self) -> &SensorCalibration {
            &self.calibration
        }

        fn contents(&self) -> Contents {
            Contents::default()
        }

        fn next(&mut self) -> Result<Option<SensorEvent>, SensorError> {
            let failure = || SensorError::Source { name: "script".to_owned(), source: "torn page".into() };
            self.events.pop_front().map(Some).ok_or_else(failure)
        }
    }

    const SECOND_NS: i64 = 1_000_000_000;

    fn reading(seconds: i64) -> SensorEvent {
        let (gyroscope, accelerometer) = (Vector3::zeros(), Vector3::zeros());
        SensorEvent::Imu(ImuSample { stamp_ns: seconds * SECOND_NS, gyroscope, accelerometer })
    }

    fn frame(seconds: i64) -> SensorEvent {
        SensorEvent::Frame(Frame { stamp_ns: seconds * SECOND_NS, ..Frame::default() })
    }

    /// The next frame; `None` at the end.
    fn next(queue: &mut SensorQueue<'_>) -> Option<Frame> {
        match queue.next_frame().unwrap() {
            NextFrame::Frame(frame) => Some(frame),
            NextFrame::End => None,
            NextFrame::Tick => panic!("the script is no live source"),
        }
    }

    fn script(events: impl IntoIterator<Item = SensorEvent>) -> Script {
        Script { calibration: SensorCalibration::default(), events: events.into_iter().collect() }
    }

    #[test]
    fn memory_is_bounded_where_the_imu_outlasts_the_images() {
        let last = MAX_AHEAD as i64 + 1000;
        let mut source = script([frame(0)].into_iter().chain((1..=last).map(reading)));
        let mut queue = SensorQueue::new(&mut source);
        assert!(next(&mut queue).is_some());
        assert_eq!(queue.next_frame_ns(), None);
        assert_eq!(queue.imu.ahead().len(), MAX_AHEAD);
        assert_eq!(queue.imu.ahead().last().unwrap().stamp_ns, last * SECOND_NS);
    }

    #[test]
    fn an_error_comes_after_all_that_was_read_before_it() {
        let mut source = script([reading(1), frame(1), frame(2), reading(3)]);
        let mut queue = SensorQueue::new(&mut source);
        assert_eq!(next(&mut queue).unwrap().stamp_ns, SECOND_NS);
        assert_eq!(queue.next_frame_ns(), Some(2 * SECOND_NS));
        for seconds in [1, 3] {
            assert_eq!(queue.next_reading(SECOND_NS).unwrap().unwrap().0.stamp_ns, seconds * SECOND_NS);
        }
        assert_eq!(next(&mut queue).unwrap().stamp_ns, 2 * SECOND_NS);
        assert!(queue.next_frame().unwrap_err().to_string().contains("torn page"));
        assert_eq!(next(&mut queue), None);
    }

    #[test]
    fn a_reading_is_waited_for_over_a_minute_of_frames_and_no_longer() {
        let mut source = script([reading(0)].into_iter().chain((0..1000).map(frame)));
        let mut queue = SensorQueue::new(&mut source);
        next(&mut queue).unwrap();
        assert!(queue.next_reading(0).unwrap().is_some());
        assert_eq!(queue.next_reading(0).unwrap(), None);
        let held = queue.frames.len();
        assert!((60..70).contains(&held), "{held} frames are held");
    }
}
