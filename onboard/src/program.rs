//! The robot as a program: opens the recording, runs, scores, writes.

use super::arguments::RobotArguments;
use super::estimator_supervisor::EstimatorSupervisor;
use super::event::Event;
use super::extraction::ExtractionThread;
use super::front_end::FrontEnd;
use super::imu_window::ImuWindow;
use super::output;
use super::publisher::Publisher;
use super::recorder::Recorder;
use super::run::{RobotRun, RunError, run};
use super::start::{excerpt, initial_state};
use super::stop::StopSignal;
use super::summary::Summary;
use anyhow::{Context as _, Result, bail};
use client::{MapChangeSubscriber, MapClient, QueryTasks};
use estimator::{CalibratedCamera, Estimator, MapMode};
use evaluation::trajectory::StateRow;
use evaluation::trajectory::states::StateReader;
use evaluation::{RunScore, ScoreOptions, score_rows};
use sensors::{Recording, Rows};
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::runtime::Handle;
use vision::GrayImage;
use vision::tracking::TrackerOptions;

/// A robot's way to the map.
#[derive(Clone, Debug)]
pub struct MapLink {
    /// An open session.
    pub session: zenoh::Session,
    /// The runtime that the session lives on.
    pub runtime: Handle,
    /// Name of the map.
    pub map: String,
}

/// What a run left behind.
#[derive(Debug)]
pub struct Outcome {
    /// The summary, also in `summary.json`.
    pub summary: Summary,
    /// The output folder.
    pub out: PathBuf,
}

impl Outcome {
    /// Reads the states that the run wrote; none where it had no start.
    ///
    /// # Errors
    /// A file that cannot be read any more.
    pub fn states(&self) -> Result<Vec<StateRow>> {
        Ok(StateReader::open(&self.out.join(output::STATES))?.collect::<Result<_, _>>()?)
    }

    /// Reads the events that the run wrote.
    ///
    /// # Errors
    /// A file that cannot be read any more.
    pub fn events(&self) -> Result<Vec<Event>> {
        let mut rows = csv::Reader::from_path(self.out.join(output::EVENTS))?;
        Ok(rows.deserialize().collect::<Result<_, _>>()?)
    }
}

/// Runs a robot through a recording and writes the output folder.
///
/// A run that ends early (a damaged file) is written up to there; the summary says why.
///
/// # Errors
/// A sentence: switches that contradict the recording, no start, an output folder that cannot be written.
pub fn run_robot<'a>(
    recording: impl Into<Recording<'a>>,
    arguments: &RobotArguments,
    link: Option<MapLink>,
    progress: impl FnMut(usize),
) -> Result<Outcome> {
    run_robot_until(&StopSignal::default(), recording, arguments, link, progress)
}

/// [`run_robot`] until `stop` comes, or the recording ends.
///
/// # Errors
/// As [`run_robot`].
pub fn run_robot_until<'a>(
    stop: &StopSignal,
    recording: impl Into<Recording<'a>>,
    arguments: &RobotArguments,
    link: Option<MapLink>,
    progress: impl FnMut(usize),
) -> Result<Outcome> {
    let recording = excerpt_of(recording.into(), arguments)?;
    let recording = &recording;
    let config = arguments.estimator_config(recording)?;
    let cameras = arguments.camera_count(recording)?;
    if !(arguments.query_interval.is_finite() && arguments.query_interval >= 0.0) {
        bail!(
            "--query-interval is {}; it must be zero or a positive number of seconds",
            arguments.query_interval
        );
    }
    if !(arguments.deadline.is_finite() && arguments.deadline > 0.0) {
        bail!("--deadline is {}; it must be a positive number of seconds", arguments.deadline);
    }
    let initial = initial_state(recording, arguments.init, &config)?;
    let rig: Vec<CalibratedCamera> = recording.cameras[..cameras]
        .iter()
        .map(|sensor| CalibratedCamera {
            camera: sensor.camera.clone(),
            imu_from_camera: sensor.imu_from_camera,
        })
        .collect();
    let filter = match &initial {
        Some(initial) => {
            EstimatorSupervisor::running(Estimator::new(config.clone(), rig.clone(), initial)?, rig)
        }
        None => EstimatorSupervisor::searching(config.clone(), rig),
    };
    let link = link.filter(|_| config.mode != MapMode::Odometry);
    let map = link.as_ref().map(|link| link.map.clone());
    let (queries, news, publisher) = match link {
        Some(link) => {
            let deadline = Duration::from_secs_f64(arguments.deadline);
            let client = MapClient::new(link.session.clone(), &link.map).context("--map")?;
            let queries = QueryTasks::new(client, link.runtime.clone(), deadline);
            let news = link.runtime.block_on(MapChangeSubscriber::subscribe(&link.session, &link.map))?;
            let publisher = Publisher::new(link.session, &link.runtime, &arguments.robot, &link.map)
                .map_err(anyhow::Error::msg)?;
            (Some(queries), Some(news), Some(publisher))
        }
        None => (None, None, None),
    };
    let mask = if recording.contents().images { arguments.features.read_mask()? } else { None };
    let front_end = front_end(recording, arguments, cameras, mask.as_ref())?;
    let extraction = if queries.is_some() { extraction(recording, arguments, mask)? } else { None };
    let robot = RobotRun {
        recording,
        imu: ImuWindow::new(recording.imu_samples()?, recording.imu.as_ref().map_or(1.0, |imu| imu.rate_hz)),
        stop: stop.clone(),
        cameras,
        front_end,
        extraction,
        query_interval_ns: (arguments.query_interval * 1e9) as i64,
        last_extraction_ns: None,
        filter,
        robot: arguments.robot.clone(),
        max_keyframes: arguments.max_keyframes,
        realtime: arguments.realtime,
        queries,
        news,
        publisher,
        last_failure: None,
    };
    // Before anything takes long: a run whose results cannot be kept is not worth its time.
    let mut recorder = Recorder::create(&arguments.out).context("--out")?;
    let ended_early = run(robot, &mut recorder, progress).err();
    if let Some(reason) = &ended_early {
        tracing::error!(%reason, "the run ended early");
    }
    recorder.finish_states()?;
    let seconds = recorder.seconds();
    let (score, no_score) = match score(recording, &arguments.out) {
        Ok(score) => (Some(score), None),
        Err(reason) => (None, Some(reason)),
    };
    let summary = Summary {
        sequence: recording.root.display().to_string(),
        map,
        cameras,
        frames: recorder.frames,
        skipped_frames: recorder.skipped_frames,
        dropped_imu: recorder.dropped_imu,
        imu_gaps: recorder.imu_gaps,
        seconds,
        wall_seconds: recorder.wall_seconds,
        realtime_factor: seconds / recorder.wall_seconds.max(1e-9),
        milliseconds_per_frame: recorder.timings.mean(),
        score,
        no_score,
        queries: recorder.queries,
        map_changes: recorder.map_changes,
        keyframes_pulled: recorder.keyframes_pulled,
        wire_bytes: recorder.traffic,
        tracks: recorder.tracks,
        reinitializations: recorder.reinitializations(),
        starts: recorder.starts.clone(),
        divergences: recorder.divergences.clone(),
        final_status: recorder.final_status.clone(),
        interrupted: matches!(ended_early, Some(RunError::Interrupted { .. })),
        ended_early: ended_early.map(|reason| reason.to_string()),
        settings: config,
    };
    recorder.write_summary(&summary)?;
    Ok(Outcome { summary, out: arguments.out.clone() })
}

/// The part of the recording that is asked for.
fn excerpt_of<'a>(recording: Recording<'a>, arguments: &RobotArguments) -> Result<Recording<'a>> {
    if arguments.start_at == 0.0 && arguments.duration.is_none() {
        return Ok(recording);
    }
    excerpt(recording, arguments.start_at, arguments.duration)
}

/// What makes tracks of the recording's images, where it has images and no tracks.
fn front_end(
    recording: &Recording<'_>,
    arguments: &RobotArguments,
    cameras: usize,
    mask: Option<&GrayImage>,
) -> Result<Option<FrontEnd>> {
    if !recording.contents().images || recording.contents().tracks {
        return Ok(None);
    }
    let mut options = TrackerOptions::default().points(arguments.points);
    if let Some(mask) = mask {
        options = options.mask(0, mask.clone());
    }
    Ok(Some(FrontEnd::new(&recording.cameras[..cameras], options)?))
}

/// What makes features of the recording's images, where it has images and no features.
fn extraction(
    recording: &Recording<'_>,
    arguments: &RobotArguments,
    mask: Option<GrayImage>,
) -> Result<Option<ExtractionThread>> {
    if !recording.contents().images || recording.contents().features {
        return Ok(None);
    }
    let settings = &arguments.features;
    let thread = ExtractionThread::start(settings.open()?, settings.max_features, mask)?;
    Ok(Some(thread))
}

/// Errors of what was written against the recording's truth, or why there are none.
fn score(recording: &Recording<'_>, out: &Path) -> Result<RunScore, String> {
    if !recording.has_truth() {
        return Err("the recording has no ground truth".into());
    }
    let gravity = recording
        .truth_gravity()
        .map_err(|error| error.to_string())?
        .ok_or("the direction of gravity in the truth's frame cannot be told from truth and IMU")?;
    let path = out.join(output::STATES);
    let states = || -> Result<Rows<'_, StateRow>, _> { Ok(Box::new(StateReader::open(&path)?)) };
    score_rows(states, || recording.truth(), gravity, &ScoreOptions::default())
        .map_err(|error| error.to_string())
}
