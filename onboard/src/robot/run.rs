//! Plays a recording through the estimator.

use super::extraction::ExtractionThread;
use super::front_end::FrontEnd;
use super::lifecycle::Lifecycle;
use super::publisher::{Publisher, QueryCounts};
use super::query_client::QueryClient;
use super::recorder::Recorder;
use super::summary::Timings;
use crate::estimator::{EstimatorError, StartMethod, TrackObservation};
use crate::sequence::{Frame, Sequence};
use nalgebra::Vector3;
use std::time::{Duration, Instant};

/// Played as fast as possible, an answer takes this long, nanoseconds: it comes before the next image where that is
/// later, and with it where it is not.
const ANSWER_NS: i64 = 200_000_000;

/// Why a run ended early. What was recorded up to there is kept.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RunError {
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
#[derive(Debug)]
pub struct RobotRun<'a> {
    /// The recording.
    pub sequence: &'a Sequence,
    /// How many of its cameras to use.
    pub cameras: usize,
    /// The filter, or the search for its start.
    pub filter: Lifecycle,
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
    mut progress: impl FnMut(usize),
) -> Result<(), RunError> {
    let first_ns = robot.sequence.frames.first().map_or(0, |frame| frame.stamp_ns);
    let seconds = |stamp_ns: i64| (stamp_ns - first_ns) as f64 * 1e-9;
    recorder.first_ns = first_ns;
    if robot.filter.estimator().is_some() {
        recorder.note_start(first_ns, None);
    }
    let begin = Instant::now();
    let mut next_imu = 0;
    for (index, frame) in robot.sequence.frames.iter().enumerate() {
        progress(index);
        if robot.filter.begins_after(frame.stamp_ns) {
            continue;
        }
        if robot.realtime {
            let due = Duration::from_nanos((frame.stamp_ns - first_ns).max(0) as u64);
            std::thread::sleep(due.saturating_sub(begin.elapsed()));
        }
        let done = robot.frame(frame, &mut next_imu, recorder);
        robot.survive(done, frame.stamp_ns, next_imu, recorder)?;
        let next = robot.sequence.frames.get(index + 1);
        if !robot.realtime && next.is_some_and(|next| next.stamp_ns - frame.stamp_ns > ANSWER_NS) {
            let done = robot.answers_before_the_next_image(recorder);
            robot.survive(done, frame.stamp_ns, next_imu, recorder)?;
        }
    }
    let last_ns = robot.sequence.frames.last().map_or(0, |frame| frame.stamp_ns);
    let done = robot.take_the_rest(recorder);
    robot.survive(done, last_ns, next_imu, recorder)?;
    robot.close(recorder);
    recorder.wall_seconds = begin.elapsed().as_secs_f64();
    if recorder.starts.is_empty() {
        let waiting = robot.filter.status().reason;
        return Err(RunError::NoStart { seconds: seconds(last_ns), waiting });
    }
    Ok(())
}

impl RobotRun<'_> {
    /// Goes on after a step: a filter that diverged is given up, and a new start is looked for.
    fn survive(
        &mut self,
        done: Result<(), EstimatorError>,
        stamp_ns: i64,
        next_imu: usize,
        recorder: &mut Recorder,
    ) -> Result<(), RunError> {
        match done {
            Ok(()) => Ok(()),
            Err(error @ EstimatorError::Diverged(_)) => {
                tracing::error!(%error, "no pose until there is a new start");
                recorder.note_divergence(stamp_ns, &error);
                self.filter.give_up(stamp_ns, &error, &self.sequence.imu_samples[..next_imu]);
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
        Ok(Some(if method == StartMethod::Rest { tracks } else { Vec::new() }))
    }

    fn frame(
        &mut self,
        frame: &Frame,
        next_imu: &mut usize,
        recorder: &mut Recorder,
    ) -> Result<(), EstimatorError> {
        let mut timings = Timings::default();
        let begin = Instant::now();
        let Some(tracks) = self.look(frame, recorder) else { return Ok(()) };
        timings.front_end = begin.elapsed();

        let begin = Instant::now();
        let reading = self.feed_imu(frame.stamp_ns, next_imu, recorder);
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
            .look(frame, &self.sequence.imu_samples)
            .inspect_err(|error| {
                tracing::warn!(%error, "frame skipped");
                recorder.skipped_frames += 1;
            })
            .ok()
    }

    /// Hands over the IMU readings up to the first one after the frame, and returns the angular velocity of that.
    fn feed_imu(&mut self, stamp_ns: i64, next: &mut usize, recorder: &mut Recorder) -> Vector3<f64> {
        let samples = &self.sequence.imu_samples;
        let stamp_ns = self.filter.estimator().map_or(stamp_ns, |estimator| estimator.imu_stamp_ns(stamp_ns));
        while *next < samples.len() && (*next == 0 || samples[*next - 1].stamp_ns < stamp_ns) {
            if let Err(error) = self.filter.imu(samples[*next]) {
                tracing::warn!(%error);
                recorder.dropped_imu += 1;
            }
            *next += 1;
        }
        samples.get(next.saturating_sub(1)).map_or_else(Vector3::zeros, |sample| sample.gyroscope)
    }

    fn close(&mut self, recorder: &mut Recorder) {
        recorder.final_status = Some(self.filter.status().with_failure(self.last_failure.as_deref()));
        if let Some(publisher) = self.publisher.take() {
            publisher.close();
        }
    }
}

impl Recorder {
    fn query_counts(&self) -> QueryCounts {
        QueryCounts { sent: self.queries_sent, answered: self.queries_answered }
    }
}
