//! Plays a recording through the estimator.

use super::estimator_supervisor::EstimatorSupervisor;
use super::extraction::ExtractionThread;
use super::front_end::FrontEnd;
use super::imu_window::ImuWindow;
use super::publisher::{Publisher, QueryCounts};
use super::recorder::Recorder;
use super::stop::StopSignal;
use super::summary::Timings;
use client::map_change_subscriber::MapChangeSubscriber;
use client::query_client::QueryClient;
use estimator::{EstimatorError, InitMethod, TrackObservation};
use nalgebra::Vector3;
use sensors::{Frame, Recording, SequenceError};
use std::time::{Duration, Instant};

/// Played as fast as possible, an answer takes this long, nanoseconds: it comes before the next image where that is
/// later, and with it where it is not.
const ANSWER_NS: i64 = 200_000_000;

/// Why a run ended early. What was recorded up to there is kept.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The recording cannot be read any more.
    #[error(transparent)]
    Recording(#[from] SequenceError),
    /// It was stopped from outside.
    #[error("interrupted {seconds:.1} s into the recording")]
    Interrupted {
        /// Time since the first frame.
        seconds: f64,
    },
    /// The filter cannot be built.
    #[error("at {seconds:.1} s of the recording: {source}")]
    Estimator {
        /// Time since the first frame.
        seconds: f64,
        /// What is wrong.
        source: EstimatorError,
    },
    /// No start was found.
    #[error("no start was found in {seconds:.1} s of recording: {waiting}")]
    NoStart {
        /// Time from the first frame to the last.
        seconds: f64,
        /// What was waited for at the end.
        waiting: String,
    },
}

/// Everything that a run needs beside the recording.
pub struct RobotRun<'a> {
    /// The recording.
    pub recording: &'a Recording<'a>,
    /// Its IMU readings.
    pub imu: ImuWindow<'a>,
    /// Ends the run before the recording does.
    pub stop: StopSignal,
    /// How many of its cameras to use.
    pub cameras: usize,
    /// The filter, or the search for its start.
    pub filter: EstimatorSupervisor,
    /// Name of the robot.
    pub robot: String,
    /// Most keyframes of one answer.
    pub max_keyframes: u16,
    /// Play at the speed of the recording.
    pub realtime: bool,
    /// Makes tracks of images; none for a recording that has tracks.
    pub front_end: Option<FrontEnd>,
    /// Makes features of images; none for a recording that has features.
    pub extraction: Option<ExtractionThread>,
    /// Least time between two images that features are extracted from, nanoseconds.
    pub query_interval_ns: i64,
    /// Time of the last of them.
    pub last_extraction_ns: Option<i64>,
    /// Asks the map; none with odometry only.
    pub queries: Option<QueryClient>,
    /// Hears when the map changes; none with odometry only.
    pub news: Option<MapChangeSubscriber>,
    /// Publishes; none without a network.
    pub publisher: Option<Publisher>,
    /// Why the last query was not answered, until one is.
    pub last_failure: Option<String>,
}

/// Runs to the end of the recording.
///
/// As fast as possible (not `realtime`) the recording stands still while an answer is outstanding, and
/// the answer to one image is delivered with the next image, or before it where that is more than 0.2 s later: results
/// then do not depend on how fast this machine is. In real time answers are delivered when they come.
///
/// # Errors
/// [`RunError`]; `recorder` holds what was done up to there.
pub fn run(
    mut robot: RobotRun<'_>,
    recorder: &mut Recorder,
    progress: impl FnMut(usize),
) -> Result<(), RunError> {
    let begin = Instant::now();
    let done = robot.play(begin, recorder, progress);
    robot.close(recorder);
    recorder.wall_seconds = begin.elapsed().as_secs_f64();
    done
}

impl RobotRun<'_> {
    fn play(
        &mut self,
        begin: Instant,
        recorder: &mut Recorder,
        mut progress: impl FnMut(usize),
    ) -> Result<(), RunError> {
        let mut frames = self.recording.frames()?.peekable();
        let stamp_of = |frame: Option<&Result<Frame, _>>| frame?.as_ref().ok().map(|frame| frame.stamp_ns);
        let first_ns = stamp_of(frames.peek()).unwrap_or_default();
        let seconds = |stamp_ns: i64| (stamp_ns - first_ns) as f64 * 1e-9;
        recorder.first_ns = first_ns;
        if self.filter.estimator().is_some() {
            recorder.note_start(first_ns, None);
        }
        let (mut index, mut last_ns) = (0, first_ns);
        while let Some(frame) = frames.next().transpose()? {
            progress(index);
            index += 1;
            if self.filter.begins_after(frame.stamp_ns) {
                continue;
            }
            if self.realtime {
                let due = Duration::from_nanos((frame.stamp_ns - first_ns).max(0) as u64);
                self.stop.sleep_until(begin + due);
            }
            if self.stop.is_stopped() {
                self.publish_status(last_ns, recorder);
                return Err(RunError::Interrupted { seconds: seconds(last_ns) });
            }
            last_ns = frame.stamp_ns;
            self.imu.read_to(last_ns.max(self.imu_stamp_ns(last_ns)))?;
            let done = self.frame(&frame, recorder);
            self.survive(done, last_ns, recorder)?;
            if !self.realtime && stamp_of(frames.peek()).is_some_and(|next_ns| next_ns - last_ns > ANSWER_NS)
            {
                let done = self.answers_before_the_next_image(recorder);
                self.survive(done, last_ns, recorder)?;
            }
            self.forget_readings(last_ns);
        }
        let done = self.take_the_rest(recorder);
        self.survive(done, last_ns, recorder)?;
        if recorder.starts.is_empty() {
            let waiting = self.filter.status().reason;
            return Err(RunError::NoStart { seconds: seconds(last_ns), waiting });
        }
        Ok(())
    }

    /// An image's time on the clock of the IMU, nanoseconds.
    fn imu_stamp_ns(&self, stamp_ns: i64) -> i64 {
        self.filter.estimator().map_or(stamp_ns, |estimator| estimator.imu_stamp_ns(stamp_ns))
    }

    /// Forgets readings that neither the front end nor a new start will ask for.
    fn forget_readings(&mut self, stamp_ns: i64) {
        let tracked_ns = self.front_end.as_ref().and_then(FrontEnd::last_stamp_ns);
        let needed = [tracked_ns, self.filter.believed_ns()].into_iter().flatten().min();
        self.imu.forget_before(needed.map_or(stamp_ns, |needed_ns| needed_ns.min(stamp_ns)));
    }

    /// Goes on after a step: a filter that diverged is given up, and a new start is looked for.
    fn survive(
        &mut self,
        done: Result<(), EstimatorError>,
        stamp_ns: i64,
        recorder: &mut Recorder,
    ) -> Result<(), RunError> {
        match done {
            Ok(()) => Ok(()),
            Err(error @ EstimatorError::Diverged(_)) => {
                tracing::error!(%error, "no pose until there is a new start");
                recorder.note_divergence(stamp_ns, &error);
                self.filter.give_up(stamp_ns, &error, self.imu.handed_out());
                self.publish_status(stamp_ns, recorder);
                Ok(())
            }
            Err(source) => {
                Err(RunError::Estimator { seconds: (stamp_ns - recorder.first_ns) as f64 * 1e-9, source })
            }
        }
    }

    fn publish_status(&self, stamp_ns: i64, recorder: &Recorder) {
        if let Some(publisher) = &self.publisher {
            let status = self.filter.status().with_failure(self.last_failure.as_deref());
            publisher.publish_status(stamp_ns, status, recorder.query_counts());
        }
    }

    /// Looks for a start, where there is none yet.
    ///
    /// # Returns
    /// The tracks that the filter still has to learn from; `None` where there is no filter.
    fn start(
        &mut self,
        stamp_ns: i64,
        tracks: Vec<TrackObservation>,
        recorder: &mut Recorder,
    ) -> Result<Option<Vec<TrackObservation>>, EstimatorError> {
        if self.filter.estimator().is_some() {
            return Ok(Some(tracks));
        }
        let Some(method) = self.filter.try_start(stamp_ns, &tracks)? else {
            self.publish_status(stamp_ns, recorder);
            return Ok(None);
        };
        tracing::info!(?method, "started");
        recorder.note_start(stamp_ns, Some(&method));
        // A start in motion has learned from the tracks of its last image already.
        Ok(Some(if method == InitMethod::Static { tracks } else { Vec::new() }))
    }

    fn frame(&mut self, frame: &Frame, recorder: &mut Recorder) -> Result<(), EstimatorError> {
        let mut timings = Timings::default();
        let begin = Instant::now();
        let Some(tracks) = self.look(frame, recorder) else { return Ok(()) };
        timings.front_end = begin.elapsed();

        let begin = Instant::now();
        let reading = self.feed_imu(frame.stamp_ns, recorder);
        let tracks = self.start(frame.stamp_ns, tracks, recorder)?;
        let (Some(tracks), Some(estimator)) = (tracks, self.filter.estimator_mut()) else {
            // Answers to the filter before are of no use, but must not pile up.
            return self.deliver(recorder).map(|_| ());
        };
        let clone = match estimator.time_update(frame.stamp_ns) {
            Ok(clone) => clone,
            Err(error @ (EstimatorError::NoImu { .. } | EstimatorError::OldFrame { .. })) => {
                tracing::warn!(%error, "frame skipped");
                recorder.skipped_frames += 1;
                return Ok(());
            }
            Err(error) => return Err(error),
        };
        timings.propagation = begin.elapsed();

        let begin = Instant::now();
        let report = estimator.track_update(&tracks)?;
        timings.tracks = begin.elapsed();
        recorder.note_tracks(&report);

        // Answers to earlier images come before this one is asked about.
        let begin = Instant::now();
        let waited = self.deliver(recorder)?;
        timings.map = begin.elapsed().saturating_sub(waited);

        self.filter.remember();
        let Some(estimator) = self.filter.estimator() else { return Ok(()) };
        recorder.note_state(estimator);
        recorder.timings.add(&timings);
        if let Some(publisher) = &self.publisher {
            let rate = reading - estimator.biases().0;
            publisher.publish(estimator, rate, recorder.query_counts(), self.last_failure.as_deref());
        }
        self.ask_about(clone, frame, recorder);
        Ok(())
    }

    /// Takes in what is on its way, and states what is known then.
    fn answers_before_the_next_image(&mut self, recorder: &mut Recorder) -> Result<(), EstimatorError> {
        let (extracting, asked) = (self.extraction.as_ref(), self.queries.as_ref());
        let nothing = extracting.is_none_or(ExtractionThread::is_idle)
            && asked.is_none_or(|queries| queries.pending() == 0);
        if nothing {
            return Ok(());
        }
        self.deliver(recorder)?;
        if let Some(estimator) = self.filter.estimator() {
            recorder.note_state_again(estimator);
        }
        Ok(())
    }

    /// The tracks of a frame, from the recording or from its images. `None` for an image that is of no use.
    fn look(&mut self, frame: &Frame, recorder: &mut Recorder) -> Option<Vec<TrackObservation>> {
        let Some(front_end) = &mut self.front_end else {
            let used = |track: &&TrackObservation| usize::from(track.camera) < self.cameras;
            return Some(frame.tracks.iter().filter(used).copied().collect());
        };
        if frame.images[0].is_none() {
            return Some(Vec::new());
        }
        front_end
            .look(frame, self.imu.readings())
            .inspect_err(|error| {
                tracing::warn!(%error, "frame skipped");
                recorder.skipped_frames += 1;
            })
            .ok()
    }

    /// Hands over the IMU readings up to the first one after the frame, and returns the angular velocity of that.
    fn feed_imu(&mut self, stamp_ns: i64, recorder: &mut Recorder) -> Vector3<f64> {
        let stamp_ns = self.imu_stamp_ns(stamp_ns);
        while let Some(reading) = self.imu.hand_out(stamp_ns) {
            if let Err(error) = self.filter.imu(reading) {
                tracing::warn!(%error);
                recorder.dropped_imu += 1;
            }
        }
        self.imu.handed_out().last().map_or_else(Vector3::zeros, |reading| reading.gyroscope)
    }

    fn close(&mut self, recorder: &mut Recorder) {
        recorder.imu_gaps = self.imu.gaps();
        recorder.final_status = Some(self.filter.status().with_failure(self.last_failure.as_deref()));
        if let Some(publisher) = self.publisher.take() {
            publisher.close();
        }
    }
}

impl Recorder {
    fn query_counts(&self) -> QueryCounts {
        QueryCounts { sent: self.queries.sent, answered: self.queries.answered }
    }
}
