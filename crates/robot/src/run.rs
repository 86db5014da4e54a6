//! Plays a sensor source through the estimator.

use super::alarms::Alarms;
use super::counts::{PairSummary, Timings};
use super::error::{RobotError, RunError};
use super::estimate::Estimate;
use super::extraction::ExtractionThread;
use super::initial_pose::InitialPoseSearch;
use super::input::{NextFrame, SensorFaults, SensorQueue};
use super::link::MapConnection;
use super::output::{Output, Outputs};
use super::prediction::{Basis, Prediction};
use super::query_cameras::QueryCameras;
use super::report::RunReport;
use super::run_status::AlarmKind;
use super::settings::RobotSettings;
use estimator::{Estimator, EstimatorError, InitMethod, TrackObservation};
use odometry::{EstimatorSupervisor, FrontEnd, RepeatedWarning, calibrated_cameras};
use sensors::{Contents, Frame, SensorError, SensorSource};
use std::time::{Duration, Instant};
use vision::{FeatureExtractor, GrayImage};

/// As fast as possible, an answer is taken to need this time, nanoseconds: it is applied before the next image where
/// that is later, else with it.
const ANSWER_NS: i64 = 200_000_000;

/// A robot: a sensor source, an estimator, its map, and who is told.
///
/// [`Robot::new`] makes one that does odometry. Outputs are added, then it is connected to the map, then it runs.
///
/// # Example
/// Odometry of a recording, which is printed:
/// ```no_run
/// use robot::{Estimate, Output, Robot, RobotSettings, estimator_config};
/// use sensors::SensorSource as _;
///
/// struct Print;
///
/// impl Output for Print {
///     fn estimate(&mut self, estimate: &Estimate) {
///         println!("{} {}", estimate.motion.stamp_ns, estimate.motion.local_from_imu().pose.translation);
///     }
/// }
///
/// let recording = sensors::Recording::open("MH_03".as_ref())?;
/// let mut source = recording.source()?;
/// let estimator = estimator_config(source.calibration()).ok_or("there is no IMU")?;
/// let mut robot = Robot::new(&mut source, RobotSettings::new(estimator))?;
/// robot.add_output(Print);
/// let report = robot.run(|_frame| {});
/// println!("{} frames, {:?}", report.frames, report.final_status);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Robot<'a> {
    pub(crate) settings: RobotSettings,
    /// Measurements arrive now.
    is_live: bool,
    contents: Contents,
    /// Makes tracks of images; `None` for a source that has tracks.
    front_end: Option<FrontEnd>,
    /// Makes features of images for queries; `None` for a source that has features.
    pub(crate) extraction: Option<ExtractionThread>,
    /// Time of the last image that features were extracted from.
    pub(crate) last_extraction_ns: Option<i64>,
    /// The cameras that queries are about.
    pub(crate) query_cameras: QueryCameras,
    pub(crate) map: MapConnection,
    /// Poses that an operator sets.
    pub(crate) initial_pose: InitialPoseSearch,
    pub(crate) supervisor: EstimatorSupervisor,
    pub(crate) outputs: Outputs<'a>,
    /// Odometry at the rate of the IMU; `None` for a recording.
    prediction: Option<Prediction>,
    pub(crate) report: RunReport,
    pub(crate) alarms: Alarms<AlarmKind>,
    pub(crate) faults: SensorFaults,
    skipped: RepeatedWarning,
    refused: RepeatedWarning,
    pub(crate) events: SensorQueue<'a>,
}

impl<'a> Robot<'a> {
    /// A robot without a map and without outputs. A source that has images and no tracks gets a front end.
    ///
    /// # Errors
    /// [`RobotError`]: there is no camera, or a setting is refused.
    pub fn new(source: &'a mut dyn SensorSource, settings: RobotSettings) -> Result<Self, RobotError> {
        let (available, contents) = (&source.calibration().cameras, source.contents());
        let cameras = &available[..settings.cameras.min(available.len())];
        if cameras.is_empty() {
            return Err(RobotError::NoCamera);
        }
        let has_front_end = contents.images && !contents.tracks;
        let front_end = has_front_end.then(|| FrontEnd::new(cameras, &settings.tracker)).transpose()?;
        let rig = calibrated_cameras(cameras);
        let config = settings.estimator.clone();
        let supervisor = match &settings.initial {
            Some(initial) => EstimatorSupervisor::running(Estimator::new(config, rig.clone(), initial)?, rig),
            None => EstimatorSupervisor::initializing(config, rig),
        };
        Ok(Self { front_end, ..Self::with_estimator(source, supervisor, settings)? })
    }

    /// A robot whose estimator runs already, or is to be initialized in another way; it uses the tracks of the source.
    ///
    /// Of the settings, those that [`Robot::new`] makes an estimator and a front end with are not looked at.
    ///
    /// # Errors
    /// [`RobotError::Prediction`].
    pub fn with_estimator(
        source: &'a mut dyn SensorSource,
        supervisor: EstimatorSupervisor,
        mut settings: RobotSettings,
    ) -> Result<Self, RobotError> {
        let prediction =
            source.tap_imu().map(Prediction::start).transpose().map_err(RobotError::Prediction)?;
        let calibration = source.calibration();
        let is_live = source.live().is_some();
        settings.realtime |= is_live;
        Ok(Self {
            is_live,
            contents: source.contents(),
            front_end: None,
            extraction: None,
            last_extraction_ns: None,
            query_cameras: QueryCameras::new(
                &calibration.cameras[..settings.cameras.min(calibration.cameras.len())],
            ),
            map: MapConnection::default(),
            initial_pose: InitialPoseSearch::new(settings.initial_poses.clone()),
            supervisor,
            outputs: Outputs::default(),
            prediction,
            report: RunReport::default(),
            alarms: Alarms::default(),
            faults: SensorFaults::new(calibration.imu.as_ref().and_then(|imu| imu.gravity_magnitude)),
            skipped: RepeatedWarning::default(),
            refused: RepeatedWarning::default(),
            events: SensorQueue::new(source),
            settings,
        })
    }

    /// Adds an output, before [`Robot::connect`]. A `&mut` is one, too.
    pub fn add_output(&mut self, output: impl Output + 'a) {
        self.outputs.add(output);
    }

    /// Makes features of images for queries to the map, on a thread of its own. Does nothing for a source that has features, or
    /// no images.
    ///
    /// # Arguments
    /// * `extractor`: that of the map.
    /// * `max_features`: of an image; a map server takes at most [`protocol::MAX_QUERY_FEATURES`].
    /// * `masks`: of the cameras in their order, black (zero) where a camera sees the robot itself; those that are missing have none.
    ///
    /// # Errors
    /// The operating system refuses a thread.
    pub fn extract_features(
        &mut self,
        extractor: Box<dyn FeatureExtractor>,
        max_features: usize,
        masks: Vec<Option<GrayImage>>,
    ) -> std::io::Result<()> {
        if self.contents.images && !self.contents.features {
            self.extraction = Some(ExtractionThread::start(extractor, max_features, masks)?);
        }
        Ok(())
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
    /// # Returns
    /// What was done, and in [`RunReport::ended_early`] why the run ended before its source did.
    #[must_use = "the report says why the run ended"]
    pub fn run(mut self, progress: impl FnMut(usize)) -> RunReport {
        let begin = Instant::now();
        self.report.ended_early = self.play(begin, progress).err();
        self.close();
        self.report.wall_seconds = begin.elapsed().as_secs_f64();
        self.report
    }

    fn play(&mut self, begin: Instant, mut progress: impl FnMut(usize)) -> Result<(), RunError> {
        let mut first_ns = None;
        let (mut index, mut last_ns, mut last_frame) = (0, 0, begin);
        loop {
            let next = self.events.next_frame()?;
            self.update_live();
            if self.is_live && self.settings.stop.is_stopped() {
                break;
            }
            let frame = match next {
                NextFrame::Frame(frame) => frame,
                NextFrame::End => break,
                NextFrame::Tick => {
                    self.connect_when_open();
                    let now_ns = last_ns + last_frame.elapsed().as_nanos() as i64;
                    self.give_status_without_image(first_ns.map(|_| now_ns));
                    self.update_alarms((now_ns - first_ns.unwrap_or(0)) as f64 * 1e-9);
                    continue;
                }
            };
            let first_ns = *first_ns.get_or_insert_with(|| self.begin(&frame));
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
            if self.settings.realtime && !self.is_live {
                let due = Duration::from_nanos((frame.stamp_ns - first_ns).max(0) as u64);
                self.settings.stop.sleep_until(begin + due);
            }
            if self.settings.stop.is_stopped() && !self.is_live {
                self.give_status(Some(last_ns));
                return Err(RunError::Interrupted { seconds: seconds(last_ns) });
            }
            self.connect_when_open();
            last_ns = frame.stamp_ns;
            self.read_imu(last_ns)?;
            let done = self.process_frame(&frame);
            self.handle_divergence(done, last_ns)?;
            if !self.settings.realtime
                && self.events.next_frame_ns().is_some_and(|next_ns| next_ns - last_ns > ANSWER_NS)
            {
                let done = self.apply_answers_before_next_frame();
                self.handle_divergence(done, last_ns)?;
            }
            self.update_alarms(seconds(last_ns));
            self.drop_old_readings(last_ns);
        }
        let seconds = (last_ns - first_ns.unwrap_or(last_ns)) as f64 * 1e-9;
        let done = self.finish_queries();
        self.handle_divergence(done, last_ns)?;
        self.update_alarms(seconds);
        if self.report.starts.is_empty() {
            let status = self.status().reason;
            return Err(RunError::NotInitialized { seconds, status });
        }
        Ok(())
    }

    /// Begins with the first frame.
    ///
    /// # Returns
    /// Its time, nanoseconds.
    fn begin(&mut self, frame: &Frame) -> i64 {
        self.report.first_ns = frame.stamp_ns;
        self.outputs.each(|output| output.begin(frame.stamp_ns));
        if self.supervisor.estimator().is_some() {
            self.report.note_start(frame.stamp_ns, None);
        }
        frame.stamp_ns
    }

    /// Reads the IMU up to the first reading that is not before a frame, on the clocks of both sensors.
    fn read_imu(&mut self, frame_ns: i64) -> Result<(), SensorError> {
        let until_ns = frame_ns.max(self.last_row_ns(frame_ns));
        while self.events.imu.ends_before(until_ns) {
            let Some((reading, checked)) = self.events.next_reading(until_ns)? else { break };
            self.outputs.each(|output| output.reading(&reading));
            self.faults.note(&reading, checked);
        }
        for frame in self.events.take_dropped_frames() {
            // They are recorded.
            self.outputs.each(|output| output.frame(&frame));
            self.report.skipped_frames += 1;
        }
        Ok(())
    }

    /// The time of the last row of a frame on the clock of the IMU, nanoseconds. The frame came after it was taken.
    fn last_row_ns(&self, frame_ns: i64) -> i64 {
        self.supervisor.last_row_ns(frame_ns)
    }

    /// Drops readings that neither the front end nor a new initialization needs.
    fn drop_old_readings(&mut self, frame_ns: i64) {
        let tracked_ns = self.front_end.as_ref().and_then(FrontEnd::last_stamp_ns);
        let needed = [tracked_ns, self.supervisor.last_trusted_ns()].into_iter().flatten().min();
        self.events.imu.drop_before(needed.map_or(frame_ns, |needed_ns| needed_ns.min(frame_ns)));
    }

    /// Continues after a step: a diverged estimator is dropped, and initialized again.
    fn handle_divergence(&mut self, done: Result<(), EstimatorError>, stamp_ns: i64) -> Result<(), RunError> {
        match done {
            Ok(()) => Ok(()),
            Err(error @ EstimatorError::Diverged(_)) => {
                tracing::error!(%error, "the estimator diverged; no pose until it is initialized again");
                self.report.note_divergence(stamp_ns, &error);
                self.supervisor.reinitialize(stamp_ns, &error, self.events.imu.handed_out());
                self.initial_pose.diverged();
                self.outputs.each(|output| output.restart());
                if let Some(prediction) = &self.prediction {
                    prediction.lost();
                }
                self.give_status(Some(stamp_ns));
                Ok(())
            }
            Err(source) => Err(RunError::Estimator { seconds: self.report.seconds_at(stamp_ns), source }),
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
    ) -> Result<Option<Vec<TrackObservation>>, EstimatorError> {
        if self.supervisor.estimator().is_some() {
            return Ok(Some(tracks));
        }
        let Some(method) = self.supervisor.try_initialize(stamp_ns, &tracks)? else {
            self.update_initial_pose();
            self.give_status(Some(stamp_ns));
            return Ok(None);
        };
        tracing::info!(?method, "the estimator is initialized");
        self.report.note_start(stamp_ns, Some(&method));
        // An initialization in motion has used the tracks of its last image already.
        Ok(Some(if method == InitMethod::Static { tracks } else { Vec::new() }))
    }

    fn process_frame(&mut self, frame: &Frame) -> Result<(), EstimatorError> {
        self.outputs.each(|output| output.frame(frame));
        let mut timings = Timings::default();
        let begin = Instant::now();
        let Some(tracks) = self.tracks_of(frame) else {
            self.give_status_without_image(Some(frame.stamp_ns));
            return Ok(());
        };
        timings.front_end = begin.elapsed();
        self.outputs.each(|output| output.tracks(frame.stamp_ns, &tracks));

        let begin = Instant::now();
        self.feed_imu(frame.stamp_ns);
        for reading in self.events.take_wheels() {
            self.outputs.each(|output| output.wheels(&reading));
            self.supervisor.wheels(reading);
        }
        for reading in self.events.take_gnss() {
            self.outputs.each(|output| output.gnss(&reading));
            self.supervisor.gnss(reading);
        }
        let tracks = self.initialize(frame.stamp_ns, tracks)?;
        let (Some(tracks), Some(estimator)) = (tracks, self.supervisor.estimator_mut()) else {
            // Answers to queries of the last filter are of no use, but must not pile up.
            return self.apply_answers().map(|_| ());
        };
        let clone = match estimator.time_update(frame.stamp_ns) {
            Ok(clone) => clone,
            Err(error @ (EstimatorError::NoImu { .. } | EstimatorError::OldFrame { .. })) => {
                if let Some(unlogged) = self.skipped.note() {
                    tracing::warn!(%error, unlogged, "frame skipped");
                }
                self.report.skipped_frames += 1;
                let known_ns = frame.stamp_ns.max(estimator.stamp_ns());
                // What a recording has beyond is not there yet.
                let newest_ns = self.events.newest_frame_ns().filter(|_| self.is_live);
                self.give_status_without_image(Some(newest_ns.unwrap_or(known_ns).max(known_ns)));
                return Ok(());
            }
            Err(error) => return Err(error),
        };
        if let Some([before, after]) = estimator.gnss_correction() {
            self.outputs.each(|output| output.correct(&before, &after));
        }
        timings.propagation = begin.elapsed();

        let begin = Instant::now();
        let report = estimator.track_update(&tracks)?;
        timings.tracks = begin.elapsed();
        self.report.note_tracks(&report);

        // Answers to earlier images are applied before this one is queried.
        let begin = Instant::now();
        let waited = self.apply_answers()?;
        timings.map = begin.elapsed().saturating_sub(waited);

        self.supervisor.update_last_trusted();
        self.update_initial_pose();
        self.give_estimate(&timings);
        self.query_frame(clone, frame);
        Ok(())
    }

    /// Gives out where the robot is and how it is, and predicts from there.
    fn give_estimate(&mut self, timings: &Timings) {
        let mut status = self.status_report(None);
        let Some(estimator) = self.supervisor.estimator() else { return };
        status.stamp_ns = Some(estimator.stamp_ns());
        self.report.note_state(estimator, timings);
        let estimate = Estimate::of(estimator, &status.status, timings.total());
        self.outputs.each(|output| {
            output.estimate(&estimate);
            output.status(&status);
        });
        if let Some(prediction) = &self.prediction {
            prediction.update(Basis { predictor: estimator.predictor(), publish: self.outputs.predicted() });
        }
    }

    /// The tracks of a frame, from the source or from its images; `None` where its image cannot be used.
    fn tracks_of(&mut self, frame: &Frame) -> Option<Vec<TrackObservation>> {
        let Some(front_end) = &mut self.front_end else {
            let used = |track: &&TrackObservation| usize::from(track.camera) < self.supervisor.camera_count();
            return Some(frame.tracks.iter().filter(used).copied().collect());
        };
        if frame.images.is_empty() {
            return Some(Vec::new());
        }
        front_end.set_time_offset_ns(self.supervisor.camera_time_offset_ns());
        front_end
            .track_frame(frame, self.events.imu.accepted())
            .inspect_err(|error| {
                if let Some(unlogged) = self.skipped.note() {
                    tracing::warn!(%error, unlogged, "frame skipped");
                }
                self.report.skipped_frames += 1;
            })
            .ok()
    }

    /// Hands the IMU readings up to the first one after the frame to the estimator.
    fn feed_imu(&mut self, frame_ns: i64) {
        let until_ns = self.last_row_ns(frame_ns);
        while let Some(reading) = self.events.imu.hand_out(until_ns) {
            if let Err(error) = self.supervisor.imu(reading)
                && let Some(unlogged) = self.refused.note()
            {
                tracing::warn!(%error, unlogged, "IMU reading refused");
            }
        }
    }

    fn close(&mut self) {
        self.report.imu_gaps = self.events.imu.gaps();
        self.report.dropped_imu = self.faults.bad_readings();
        self.report.stereo_pairs = self.events.stereo_pairs().map(PairSummary::from);
        self.report.alarms = self.alarms.kept().to_vec();
        self.report.learned_noise = self.supervisor.learned_noise();
        self.report.readout_times_s = self.supervisor.estimator().and_then(Estimator::readout_times);
        self.report.wheels = self.supervisor.wheel_report();
        self.report.gnss = self.supervisor.gnss_counts();
        self.report.final_status = Some(self.status());
        // It publishes through the outputs.
        self.prediction = None;
        self.outputs.end(&self.report);
        self.map.close();
    }
}
