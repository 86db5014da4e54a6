//! The robot as a program: builds a run from the switches, plays a source, scores it, and writes the output folder.

use super::arguments::{HandInArguments, Init, RobotArguments};
use super::outputs::{
    EVENTS, HandInOutput, HandInSettings, MessageRecording, Recorder, RecordingSettings, STATES, StatusLine,
    Summary, ZenohOutput,
};
use super::start::{excerpt, initial_state};
use anyhow::{Context as _, Result, bail};
use estimator::{EstimatorConfig, InitialState, MapMode};
use evaluation::trajectory::StateRow;
use evaluation::trajectory::states::StateReader;
use evaluation::{RunScore, ScoreError, ScoreOptions, score_rows};
use hand_in::Header;
use robot::stop::StopSignal;
use robot::{
    Event, LinkError, MapLink, Robot, RobotLink, RobotSettings, RunError, RunReport, gnss_sensor,
    wheel_sensor,
};
use sensors::{Contents, Recording, Rows, SensorCalibration, SensorSource, SequenceError, check_stereo};
use signing::SecretKey;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use vision::GrayImage;
use vision::tracking::TrackerOptions;

/// The result of a run.
#[derive(Debug)]
pub struct Outcome {
    /// The summary, also in `summary.json`.
    pub summary: Summary,
    /// The output folder.
    pub out: PathBuf,
}

impl Outcome {
    /// Reads the states that the run wrote; none where it was never initialized.
    ///
    /// # Errors
    /// A file that cannot be read any more.
    pub fn states(&self) -> Result<Vec<StateRow>> {
        Ok(StateReader::open(&self.out.join(STATES))?.collect::<Result<_, _>>()?)
    }

    /// Reads the events that the run wrote.
    ///
    /// # Errors
    /// A file that cannot be read any more.
    pub fn events(&self) -> Result<Vec<Event>> {
        let mut rows = csv::Reader::from_path(self.out.join(EVENTS))?;
        Ok(rows.deserialize().collect::<Result<_, _>>()?)
    }
}

/// Plays a recording through a robot, compares the result with ground truth where there is any, and writes the output
/// folder.
///
/// A run that ends early (a damaged file) is written up to there; the summary states the reason.
///
/// # Arguments
/// * `progress`: called with the index of every frame before it is processed.
///
/// # Errors
/// Switches that contradict the recording, a session that is closed, an output folder that cannot be written.
pub fn run_robot<'a>(
    recording: impl Into<Recording<'a>>,
    arguments: &RobotArguments,
    link: Option<MapLink>,
    progress: impl FnMut(usize),
) -> Result<Outcome> {
    run_robot_until(&StopSignal::default(), recording, arguments, link.map(RobotLink::Open), progress)
}

/// [`run_robot`] until `stop` is raised, or the recording ends.
///
/// # Errors
/// As [`run_robot`].
pub fn run_robot_until<'a>(
    stop: &StopSignal,
    recording: impl Into<Recording<'a>>,
    arguments: &RobotArguments,
    link: Option<RobotLink>,
    progress: impl FnMut(usize),
) -> Result<Outcome> {
    let mut recording = recording.into();
    if arguments.start_at != 0.0 || arguments.duration.is_some() {
        recording = excerpt(recording, arguments.start_at, arguments.duration)?;
    }
    let config = arguments.estimator_config(recording.calibration(), recording.contents())?;
    check(arguments)?;
    if recording.contents().images {
        let cameras = arguments.camera_count(recording.calibration())?;
        check_stereo(&recording.calibration().cameras[..cameras], || recording.frames())?;
    }
    let initial = initial_state(&recording, arguments.init, &config)?;
    let mut source = recording.source()?;
    let run = play(stop, &mut source, (config, initial), arguments, link, progress)?;
    let score = if run.recorder.is_cut() { Err(NoScore::Cut) } else { score(&recording, arguments) };
    run.finish(score)
}

/// Plays any sensor source through a robot until `stop` is raised or the source ends, and writes the output folder.
///
/// As [`run_robot_until`], but for sources that are no recordings: the estimator initializes itself (`--init auto`),
/// everything is played, and nothing is compared with ground truth.
///
/// # Errors
/// As [`run_robot`]; `--init`, `--start-at` and `--duration`, which need a recording.
pub fn run_source_until(
    stop: &StopSignal,
    source: &mut dyn SensorSource,
    arguments: &RobotArguments,
    link: Option<RobotLink>,
    progress: impl FnMut(usize),
) -> Result<Outcome> {
    if arguments.init != Init::Auto || arguments.start_at != 0.0 || arguments.duration.is_some() {
        bail!(
            "{} is not a recording: --init static, --init truth, --start-at and --duration cannot be used with it",
            source.name()
        );
    }
    let config = arguments.estimator_config(source.calibration(), source.contents())?;
    check(arguments)?;
    let run = play(stop, source, (config, None), arguments, link, progress)?;
    run.finish(Err(NoScore::NoTruth))
}

/// Checks the switches that are plain numbers.
fn check(arguments: &RobotArguments) -> Result<()> {
    if !(arguments.query_interval.is_finite() && arguments.query_interval >= 0.0) {
        bail!(
            "--query-interval is {}; it must be zero or a positive number of seconds",
            arguments.query_interval
        );
    }
    if !(arguments.deadline.is_finite() && arguments.deadline > 0.0) {
        bail!("--deadline is {}; it must be a positive number of seconds", arguments.deadline);
    }
    Ok(())
}

/// A run whose states are written, and whose summary is not.
struct FinishedRun {
    name: String,
    map: Option<String>,
    cameras: usize,
    config: EstimatorConfig,
    recorder: Recorder,
    report: RunReport,
    out: PathBuf,
}

/// Builds the robot and plays the source.
fn play(
    stop: &StopSignal,
    source: &mut dyn SensorSource,
    (config, initial): (EstimatorConfig, Option<InitialState>),
    arguments: &RobotArguments,
    link: Option<RobotLink>,
    progress: impl FnMut(usize),
) -> Result<FinishedRun> {
    let (name, contents) = (source.name().to_owned(), source.contents());
    let cameras = arguments.camera_count(source.calibration())?;
    let link = link.filter(|link| link.map().is_none() || config.mode != MapMode::Odometry);
    let map = link.as_ref().and_then(RobotLink::map).map(str::to_owned);
    let masks = if contents.images { arguments.features.read_masks()? } else { Vec::new() };
    let source_calibration = source.calibration().clone();
    let mut calibration = source_calibration.clone();
    // As they are used, by switches and settings.
    calibration.wheels = config.wheels.as_ref().map(wheel_sensor);
    calibration.gnss = config.gnss.as_ref().map(gnss_sensor);
    let is_live = source.live().is_some();
    let realtime = arguments.realtime || is_live;
    let mut settings = settings(arguments, config.clone(), masks.clone());
    (settings.cameras, settings.initial, settings.stop) = (cameras, initial, stop.clone());
    // Lent to the robot, which it therefore outlives.
    let mut recorder;
    let mut robot = Robot::new(source, settings)?;
    robot.add_output(arguments.metrics.clone());
    robot.add_output(StatusLine::default());
    let ros = arguments.ros.clone().map(|mut ros| {
        ros.publish_mounting(&calibration.cameras);
        ros
    });
    if let Some(recording) = recording(arguments, calibration, realtime, map.is_some())? {
        robot.add_output(recording);
    }
    if let Some(output) = hand_in(arguments, source_calibration, realtime, map.is_some())? {
        robot.add_output(output);
    }
    if let Some(ros) = ros {
        robot.add_output(ros);
    }
    robot.add_output(ZenohOutput::new(arguments.topics.into()));
    if let Some(link) = link {
        connect(&mut robot, link)?;
        if map.is_some() {
            extract_features(&mut robot, contents, arguments, masks)?;
        }
    }
    // Created before the run: a run whose results cannot be kept is not begun.
    recorder = Recorder::create(&arguments.out, arguments.out_limit(is_live)).context("--out")?;
    robot.add_output(&mut recorder);
    let report = robot.run(progress);
    if let Some(reason) = &report.ended_early {
        tracing::error!(%reason, "the run ended early");
    }
    recorder.finish_states()?;
    Ok(FinishedRun { name, map, cameras, config, recorder, report, out: arguments.out.clone() })
}

/// The settings that the switches state.
fn settings(
    arguments: &RobotArguments,
    config: EstimatorConfig,
    masks: Vec<Option<GrayImage>>,
) -> RobotSettings {
    let mut settings = RobotSettings::new(config);
    settings.name.clone_from(&arguments.robot);
    settings.tracker = TrackerOptions::default().points(arguments.points);
    settings.tracker.masks = masks;
    settings.realtime = arguments.realtime;
    settings.query_interval_ns = (arguments.query_interval * 1e9) as i64;
    settings.query_cameras = usize::from(arguments.query_cameras);
    settings.query_deadline = Duration::try_from_secs_f64(arguments.deadline).unwrap_or(Duration::MAX);
    settings.max_keyframes = arguments.max_keyframes;
    settings.initial_poses = arguments.initial_poses.clone();
    settings
}

/// The recording that `--record` asks for.
fn recording(
    arguments: &RobotArguments,
    calibration: SensorCalibration,
    realtime: bool,
    map_expected: bool,
) -> Result<Option<MessageRecording>> {
    let Some(path) = &arguments.record else { return Ok(None) };
    let settings = RecordingSettings {
        body: arguments.body.clone(),
        calibration,
        robot: arguments.robot.clone(),
        map_expected,
        sensors: arguments.record_sensors,
        realtime,
    };
    MessageRecording::start(path, settings).map(Some).context("--record")
}

/// The sessions that `--hand-in` asks for.
fn hand_in(
    arguments: &RobotArguments,
    calibration: SensorCalibration,
    realtime: bool,
    has_map: bool,
) -> Result<Option<HandInOutput>> {
    let HandInArguments { hand_in, hand_in_key, hand_in_rate, hand_in_minutes, hand_in_limit } =
        &arguments.hand_in;
    let Some(folder) = hand_in else { return Ok(None) };
    if !has_map {
        bail!(
            "--hand-in records what a map can be extended by, and there is no map: give --map, or leave it out"
        );
    }
    let session_length = Duration::try_from_secs_f64(hand_in_minutes * 60.0)
        .ok()
        .filter(|length| *length >= Duration::from_secs(10))
        .with_context(|| format!("--hand-in-minutes is {hand_in_minutes}; give ten seconds or more"))?;
    let imu = calibration.imu.context("--hand-in needs an IMU")?;
    let password = || std::env::var("DRIFTLESS_KEY_PASSWORD").ok();
    let key = hand_in_key.as_ref().map(|file| SecretKey::read(file, password())).transpose();
    let key = key.context("--hand-in-key")?.map(Arc::new);
    let header = Header {
        robot: arguments.robot.clone(),
        name: String::new(),
        program: concat!("onboard ", env!("CARGO_PKG_VERSION")).to_owned(),
        started_unix_s: 0,
        imu,
        cameras: calibration.cameras,
    };
    let settings = HandInSettings {
        folder: folder.clone(),
        header,
        key,
        bytes_per_minute: f64::from(*hand_in_rate) * 1000.0,
        session_length,
        most_bytes: u64::from(*hand_in_limit) * 1_000_000,
        realtime,
    };
    HandInOutput::start(settings).map(Some).with_context(|| format!("--hand-in {}", folder.display()))
}

/// Connects the robot; what is wrong with the name of the map names its switch.
fn connect(robot: &mut Robot<'_>, link: RobotLink) -> Result<()> {
    robot.connect(link).map_err(|error| match error {
        LinkError::MapName(_) => anyhow::Error::new(error).context("--map"),
        other => other.into(),
    })
}

/// Makes features of the images of a source that has images and no features.
fn extract_features(
    robot: &mut Robot<'_>,
    contents: Contents,
    arguments: &RobotArguments,
    masks: Vec<Option<GrayImage>>,
) -> Result<()> {
    if !contents.images || contents.features {
        return Ok(());
    }
    let settings = &arguments.features;
    let extractor = settings.open_for_queries()?;
    let started = robot.extract_features(extractor, settings.max_features, masks);
    started.context("the thread of the feature extractor cannot be started")
}

impl FinishedRun {
    /// Writes the summary.
    fn finish(self, score: Result<RunScore, NoScore>) -> Result<Outcome> {
        let Self { name, map, cameras, config, recorder, report, out } = self;
        let (seconds, reinitializations) = (report.seconds(), report.reinitializations());
        let (score, no_score) = match score {
            Ok(score) => (Some(score), None),
            Err(reason) => (None, Some(reason.to_string())),
        };
        let summary = Summary {
            sequence: name,
            map,
            map_identity: report.map_identity.map(|identity| identity.to_string()),
            cameras,
            frames: report.frames,
            skipped_frames: report.skipped_frames,
            stereo_pairs: report.stereo_pairs,
            dropped_frames: report.dropped_frames,
            dropped_imu: report.dropped_imu,
            imu_gaps: report.imu_gaps,
            seconds,
            wall_seconds: report.wall_seconds,
            realtime_factor: seconds / report.wall_seconds.max(1e-9),
            milliseconds_per_frame: report.timings.mean(),
            score,
            no_score,
            queries: report.queries,
            map_changes: report.map_changes,
            keyframes_pulled: report.keyframes_pulled,
            keyframes_held: report.keyframes_held,
            wire_bytes: report.traffic,
            tracks: report.tracks,
            reinitializations,
            starts: report.starts,
            divergences: report.divergences,
            clock_shifts: report.clock_shifts,
            learned_noise: report.learned_noise,
            readout_times_s: report.readout_times_s,
            wheels: report.wheels,
            gnss: report.gnss,
            alarms: report.alarms,
            final_status: report.final_status,
            interrupted: matches!(report.ended_early, Some(RunError::Interrupted { .. })),
            ended_early: report.ended_early.map(|reason| reason.to_string()),
            settings: config,
        };
        recorder.write_summary(&summary)?;
        Ok(Outcome { summary, out })
    }
}

/// Why a run was not compared with ground truth.
#[derive(Debug, thiserror::Error)]
enum NoScore {
    #[error("the recording has no ground truth")]
    NoTruth,
    #[error("states.csv has the last part of the run only: give a larger --out-limit-mb")]
    Cut,
    #[error("the direction of gravity in the truth's frame cannot be found from truth and IMU")]
    NoGravity,
    #[error(transparent)]
    Recording(#[from] SequenceError),
    #[error(transparent)]
    Score(#[from] ScoreError),
}

/// Compares the states that were written with the recording's ground truth.
fn score(recording: &Recording<'_>, arguments: &RobotArguments) -> Result<RunScore, NoScore> {
    if !recording.has_truth() {
        return Err(NoScore::NoTruth);
    }
    let gravity = recording.truth_gravity()?.ok_or(NoScore::NoGravity)?;
    let path = arguments.out.join(STATES);
    let states = || -> Result<Rows<'_, StateRow>, _> { Ok(Box::new(StateReader::open(&path)?)) };
    let options =
        ScoreOptions { gravity_in_own_frame: arguments.gravity_in_own_frame, ..ScoreOptions::default() };
    Ok(score_rows(states, || recording.truth(), gravity, &options)?)
}
