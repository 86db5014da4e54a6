//! Plays a sensor source through the estimator.

use super::alarms::Alarms;
use super::extraction::ExtractionThread;
use super::initial_pose::InitialPoseSearch;
use super::input::{BadReadings, ImuWindow, NextFrame, SensorQueue};
use super::link::OpeningLink;
use super::outputs::{
    Estimate, MessageRecording, PairSummary, Publisher, Recorder, RobotMetrics, RosOutput, StatusLine,
    Timings,
};
use super::prediction::{Basis, Prediction, Publish};
use super::run_status::AlarmKind;
use super::stop::StopSignal;
use client::{MapChangeSubscriber, QueryTasks};
use estimator::{CloneId, EstimatorError, InitMethod, TrackObservation};
use geometry::Camera;
use odometry::{EstimatorSupervisor, FrontEnd, RepeatedWarning};
use protocol::Format;
use sensors::live::LiveFault;
use sensors::{Frame, ImuCheck, ImuUnitError, SensorError, SensorSource};
use std::time::{Duration, Instant};

/// As fast as possible, an answer is taken to need this time, nanoseconds: it is applied before the next image where
/// that is later, else with it.
const ANSWER_NS: i64 = 200_000_000;
/// Default of [`RobotRun::query_interval_ns`], nanoseconds.
const QUERY_INTERVAL_NS: i64 = 500_000_000;
/// Default of [`RobotRun::query_deadline`].
const QUERY_DEADLINE: Duration = Duration::from_secs(2);
/// Default of [`RobotRun::max_keyframes`].
const MAX_KEYFRAMES: u16 = 4;

/// Why a run ended early. What was recorded up to there is kept.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RunError {
    /// The source cannot be read any further.
    #[error(transparent)]
    Source(#[from] SensorError),
    /// The run was stopped from outside.
    #[error("interrupted {seconds:.1} s into the recording")]
    Interrupted {
        /// Time since the first frame.
        seconds: f64,
    },
    /// The estimator cannot be built or continued.
    #[error("at {seconds:.1} s of the recording: {source}")]
    Estimator {
        /// Time since the first frame.
        seconds: f64,
        /// The error of the estimator.
        source: EstimatorError,
    },
    /// The estimator was never initialized.
    #[error("the estimator was not initialized in {seconds:.1} s of recording: {status}")]
    NotInitialized {
        /// Time from the first frame to the last.
        seconds: f64,
        /// What the initialization lacked at the end.
        status: String,
    },
}

/// A robot: a sensor source, an estimator, and what serves them.
///
/// [`RobotRun::new`] makes one that does odometry on the tracks of the source; the fields add a front end, the map and
/// the network.
pub struct RobotRun<'a> {
    /// Stops the run before the source ends.
    pub stop: StopSignal,
    /// Name of the robot, for queries.
    pub robot: String,
    /// Format of what the robot publishes.
    pub topics: Format,
    /// Number of cameras whose tracks are used.
    pub cameras: usize,
    /// Play at the speed of the recording instead of as fast as possible. A live source is played as it comes.
    pub realtime: bool,
    /// Measurements arrive now.
    is_live: bool,
    /// Makes tracks of images; `None` for a source that has tracks.
    pub front_end: Option<FrontEnd>,
    /// Makes features of images for queries; `None` for a source that has features.
    pub extraction: Option<ExtractionThread>,
    /// Least time between two images that features are extracted from, nanoseconds.
    pub query_interval_ns: i64,
    /// How long a query may take.
    pub query_deadline: Duration,
    /// Maximum number of keyframes in one answer.
    pub max_keyframes: u16,
    /// Sends queries to the map server; `None` for odometry only.
    pub queries: Option<QueryTasks<CloneId>>,
    /// Receives changes of the map; `None` for odometry only.
    pub map_changes: Option<MapChangeSubscriber>,
    /// Publishes pose, odometry and status; `None` without a network.
    pub publisher: Option<Publisher>,
    /// Publishes for ROS 2.
    pub ros: Option<RosOutput>,
    /// Records what is published, and the sensors.
    pub(super) recording: Option<MessageRecording>,
    /// Publishes odometry at the rate of the IMU; `None` for a recording.
    pub(super) prediction: Option<Prediction>,
    /// What the run counts.
    pub metrics: RobotMetrics,
    /// Poses that an operator sets.
    pub(super) initial_pose: InitialPoseSearch,
    pub(super) supervisor: EstimatorSupervisor,
    /// Camera 0, which the queries are about.
    pub(super) query_camera: Option<Camera>,
    /// Time of the last image that features were extracted from.
    pub(super) last_extraction_ns: Option<i64>,
    /// Why the last query was not answered; `None` once one is.
    pub(super) last_failure: Option<String>,
    /// A session that is not open yet.
    pub(super) opening: Option<OpeningLink>,
    /// The session that was opened for this run, and the runtime that it lives on.
    pub(super) own_session: Option<(zenoh::Session, tokio::runtime::Handle)>,
    pub(super) status_line: StatusLine,
    pub(super) alarms: Alarms<AlarmKind>,
    imu_check: ImuCheck,
    /// What is wrong with the readings.
    pub(super) imu_fault: Option<ImuUnitError>,
    pub(super) bad_readings: BadReadings,
    /// What is wrong with a live source.
    pub(super) live_faults: Vec<LiveFault>,
    skipped: RepeatedWarning,
    refused: RepeatedWarning,
    pub(super) events: SensorQueue<'a>,
    imu: ImuWindow,
}

impl<'a> RobotRun<'a> {
    /// A robot that does odometry on the tracks of a source, as fast as possible.
    pub fn new(source: &'a mut dyn SensorSource, supervisor: EstimatorSupervisor) -> Self {
        let calibration = source.calibration();
        let imu = ImuWindow::new(calibration.imu.as_ref().map_or(1.0, |imu| imu.rate_hz));
        let is_live = source.live().is_some();
        Self {
            stop: StopSignal::default(),
            robot: "robot".to_owned(),
            topics: Format::Json,
            cameras: supervisor.camera_count(),
            realtime: is_live,
            is_live,
            front_end: None,
            extraction: None,
            query_interval_ns: QUERY_INTERVAL_NS,
            query_deadline: QUERY_DEADLINE,
            max_keyframes: MAX_KEYFRAMES,
            queries: None,
            map_changes: None,
            publisher: None,
            ros: None,
            recording: None,
            prediction: None,
            metrics: RobotMetrics::default(),
            initial_pose: InitialPoseSearch::default(),
            supervisor,
            query_camera: calibration.cameras.first().map(|first| first.camera.clone()),
            last_extraction_ns: None,
            last_failure: None,
            opening: None,
            own_session: None,
            status_line: StatusLine::default(),
            alarms: Alarms::default(),
            imu_check: ImuCheck::new(calibration.imu.as_ref().and_then(|imu| imu.gravity_magnitude)),
            imu_fault: None,
            bad_readings: BadReadings::default(),
            live_faults: Vec::new(),
            skipped: RepeatedWarning::default(),
            refused: RepeatedWarning::default(),
            events: SensorQueue::new(source),
            imu,
        }
    }
}

/// Runs to the end of the source.
///
/// As fast as possible (not `realtime`) the source stands still while an answer is outstanding, and the answer to one
/// image is applied with the next image, or before it where that is more than 0.2 s later: results then do not depend
/// on the speed of the machine. In real time answers are applied when they come.
///
/// # Arguments
/// * `progress`: called with the index of every frame before it is processed.
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
        let mut first_ns = None;
        let (mut index, mut last_ns, mut last_frame) = (0, 0, begin);
        loop {
            let next = self.events.next_frame()?;
            self.update_live(recorder);
            if self.is_live && self.stop.is_stopped() {
                break;
            }
            let frame = match next {
                NextFrame::Frame(frame) => frame,
                NextFrame::End => break,
                NextFrame::Tick => {
                    self.connect_when_open();
                    let now_ns = last_ns + last_frame.elapsed().as_nanos() as i64;
                    if first_ns.is_some() {
                        self.publish_status(now_ns, recorder);
                    } else {
                        self.publish_first_status(recorder);
                    }
                    self.update_alarms((now_ns - first_ns.unwrap_or(0)) as f64 * 1e-9);
                    continue;
                }
            };
            let first_ns = *first_ns.get_or_insert_with(|| self.begin(&frame, recorder));
            let seconds = |stamp_ns: i64| (stamp_ns - first_ns) as f64 * 1e-9;
            last_frame = Instant::now();
            if index == 0 {
                last_ns = first_ns;
            }
            progress(index);
            index += 1;
            if self.supervisor.starts_after(frame.stamp_ns) {
                continue;
            }
            if self.realtime && !self.is_live {
                let due = Duration::from_nanos((frame.stamp_ns - first_ns).max(0) as u64);
                self.stop.sleep_until(begin + due);
            }
            if self.stop.is_stopped() && !self.is_live {
                self.publish_status(last_ns, recorder);
                return Err(RunError::Interrupted { seconds: seconds(last_ns) });
            }
            self.connect_when_open();
            last_ns = frame.stamp_ns;
            self.read_imu(last_ns)?;
            let done = self.process_frame(&frame, recorder);
            self.handle_divergence(done, last_ns, recorder)?;
            if !self.realtime
                && self.events.next_frame_ns().is_some_and(|next_ns| next_ns - last_ns > ANSWER_NS)
            {
                let done = self.apply_answers_before_next_frame(recorder);
                self.handle_divergence(done, last_ns, recorder)?;
            }
            self.update_alarms(seconds(last_ns));
            self.drop_old_readings(last_ns);
        }
        let seconds = (last_ns - first_ns.unwrap_or(last_ns)) as f64 * 1e-9;
        let done = self.finish_queries(recorder);
        self.handle_divergence(done, last_ns, recorder)?;
        self.update_alarms(seconds);
        if recorder.starts.is_empty() {
            let status = self.status().reason;
            return Err(RunError::NotInitialized { seconds, status });
        }
        Ok(())
    }

    /// Begins with the first frame.
    ///
    /// # Returns
    /// Its time, nanoseconds.
    fn begin(&mut self, frame: &Frame, recorder: &mut Recorder) -> i64 {
        recorder.first_ns = frame.stamp_ns;
        if let Some(recording) = &mut self.recording {
            recording.begin(frame.stamp_ns);
        }
        if self.supervisor.estimator().is_some() {
            recorder.note_start(frame.stamp_ns, None);
        }
        frame.stamp_ns
    }

    /// Reads the IMU up to the first reading that is not before a frame, on the clocks of both sensors.
    fn read_imu(&mut self, frame_ns: i64) -> Result<(), SensorError> {
        let until_ns = frame_ns.max(self.imu_stamp_ns(frame_ns));
        while self.imu.ends_before(until_ns) {
            let Some(reading) = self.events.next_reading(frame_ns)? else { break };
            if self.imu_fault.is_none() {
                self.imu_fault = self.imu_check.add(&reading).err();
            }
            if let Some(recording) = &mut self.recording {
                recording.reading(&reading);
            }
            let checked = self.imu.push(reading);
            self.bad_readings.note(reading.stamp_ns, checked);
        }
        Ok(())
    }

    /// The time of a frame on the clock of the IMU, nanoseconds.
    fn imu_stamp_ns(&self, frame_ns: i64) -> i64 {
        self.supervisor.estimator().map_or(frame_ns, |estimator| estimator.imu_stamp_ns(frame_ns))
    }

    /// Drops readings that neither the front end nor a new initialization needs.
    fn drop_old_readings(&mut self, frame_ns: i64) {
        let tracked_ns = self.front_end.as_ref().and_then(FrontEnd::last_stamp_ns);
        let needed = [tracked_ns, self.supervisor.last_trusted_ns()].into_iter().flatten().min();
        self.imu.drop_before(needed.map_or(frame_ns, |needed_ns| needed_ns.min(frame_ns)));
    }

    /// Continues after a step: a diverged estimator is dropped, and initialized again.
    fn handle_divergence(
        &mut self,
        done: Result<(), EstimatorError>,
        stamp_ns: i64,
        recorder: &mut Recorder,
    ) -> Result<(), RunError> {
        match done {
            Ok(()) => Ok(()),
            Err(error @ EstimatorError::Diverged(_)) => {
                tracing::error!(%error, "the estimator diverged; no pose until it is initialized again");
                recorder.note_divergence(stamp_ns, &error);
                self.supervisor.reinitialize(stamp_ns, &error, self.imu.handed_out());
                self.initial_pose.diverged();
                if let Some(ros) = &mut self.ros {
                    ros.restart();
                }
                if let Some(recording) = &mut self.recording {
                    recording.restart();
                }
                if let Some(prediction) = &self.prediction {
                    prediction.lost();
                }
                self.publish_status(stamp_ns, recorder);
                Ok(())
            }
            Err(source) => {
                Err(RunError::Estimator { seconds: (stamp_ns - recorder.first_ns) as f64 * 1e-9, source })
            }
        }
    }

    /// Tries to initialize the estimator, where it does not run yet.
    ///
    /// # Returns
    /// The tracks for its update; `None` where it is not initialized.
    fn initialize(
        &mut self,
        stamp_ns: i64,
        tracks: Vec<TrackObservation>,
        recorder: &mut Recorder,
    ) -> Result<Option<Vec<TrackObservation>>, EstimatorError> {
        if self.supervisor.estimator().is_some() {
            return Ok(Some(tracks));
        }
        let Some(method) = self.supervisor.try_initialize(stamp_ns, &tracks)? else {
            self.update_initial_pose();
            self.publish_status(stamp_ns, recorder);
            return Ok(None);
        };
        tracing::info!(?method, "the estimator is initialized");
        recorder.note_start(stamp_ns, Some(&method));
        // An initialization in motion has used the tracks of its last image already.
        Ok(Some(if method == InitMethod::Static { tracks } else { Vec::new() }))
    }

    fn process_frame(&mut self, frame: &Frame, recorder: &mut Recorder) -> Result<(), EstimatorError> {
        if let Some(recording) = &mut self.recording {
            recording.frame(frame);
        }
        let mut timings = Timings::default();
        let begin = Instant::now();
        let Some(tracks) = self.tracks_of(frame, recorder) else { return Ok(()) };
        timings.front_end = begin.elapsed();

        let begin = Instant::now();
        self.feed_imu(frame.stamp_ns);
        let tracks = self.initialize(frame.stamp_ns, tracks, recorder)?;
        let (Some(tracks), Some(estimator)) = (tracks, self.supervisor.estimator_mut()) else {
            // Answers to queries of the last filter are of no use, but must not pile up.
            return self.apply_answers(recorder).map(|_| ());
        };
        let clone = match estimator.time_update(frame.stamp_ns) {
            Ok(clone) => clone,
            Err(error @ (EstimatorError::NoImu { .. } | EstimatorError::OldFrame { .. })) => {
                if let Some(unlogged) = self.skipped.note() {
                    tracing::warn!(%error, unlogged, "frame skipped");
                }
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

        // Answers to earlier images are applied before this one is queried.
        let begin = Instant::now();
        let waited = self.apply_answers(recorder)?;
        timings.map = begin.elapsed().saturating_sub(waited);

        self.supervisor.update_last_trusted();
        self.update_initial_pose();
        let status = self.note_status(recorder);
        let Some(estimator) = self.supervisor.estimator() else { return Ok(()) };
        recorder.note_state(estimator);
        recorder.timings.add(&timings);
        self.metrics.note_frame(timings.total());
        if let Some(recording) = &mut self.recording {
            recording.estimate(&Estimate::of(estimator, &status));
            recording.status(estimator.stamp_ns(), &status, recorder.query_counts());
        }
        if let Some(ros) = &mut self.ros {
            ros.publish(&Estimate::of(estimator, &status));
            ros.publish_status(estimator.stamp_ns(), &status, recorder.query_counts());
        }
        if let Some(publisher) = &self.publisher {
            publisher.publish(estimator, status, recorder.query_counts());
        }
        if let Some(prediction) = &self.prediction {
            let native = self.publisher.as_ref().map(|publisher| Box::new(publisher.predicted()) as Publish);
            let ros = self.ros.as_ref().and_then(RosOutput::predicted);
            let publish = native.into_iter().chain(ros.map(|ros| Box::new(ros) as Publish)).collect();
            prediction.update(Basis { predictor: estimator.predictor(), publish });
        }
        self.query_frame(clone, frame, recorder);
        Ok(())
    }

    /// The tracks of a frame, from the source or from its images; `None` where its image cannot be used.
    fn tracks_of(&mut self, frame: &Frame, recorder: &mut Recorder) -> Option<Vec<TrackObservation>> {
        let Some(front_end) = &mut self.front_end else {
            let used = |track: &&TrackObservation| usize::from(track.camera) < self.cameras;
            return Some(frame.tracks.iter().filter(used).copied().collect());
        };
        if frame.images[0].is_none() {
            return Some(Vec::new());
        }
        front_end
            .track_frame(frame, self.imu.readings())
            .inspect_err(|error| {
                if let Some(unlogged) = self.skipped.note() {
                    tracing::warn!(%error, unlogged, "frame skipped");
                }
                recorder.skipped_frames += 1;
            })
            .ok()
    }

    /// Hands the IMU readings up to the first one after the frame to the estimator.
    fn feed_imu(&mut self, frame_ns: i64) {
        let until_ns = self.imu_stamp_ns(frame_ns);
        while let Some(reading) = self.imu.hand_out(until_ns) {
            if let Err(error) = self.supervisor.imu(reading)
                && let Some(unlogged) = self.refused.note()
            {
                tracing::warn!(%error, unlogged, "IMU reading refused");
            }
        }
    }

    fn close(&mut self, recorder: &mut Recorder) {
        recorder.imu_gaps = self.imu.gaps();
        recorder.dropped_imu = self.bad_readings.count();
        recorder.stereo_pairs = self.events.stereo_pairs().map(PairSummary::from);
        recorder.alarms = self.alarms.kept().to_vec();
        recorder.learned_noise = self.supervisor.learned_noise();
        recorder.final_status = Some(self.note_status(recorder));
        (self.prediction, self.recording) = (None, None);
        if let Some(publisher) = self.publisher.take() {
            publisher.close();
        }
        self.disconnect();
    }
}
