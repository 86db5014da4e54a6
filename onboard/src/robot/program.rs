//! The robot as a program: opens the recording, runs, scores, writes.

use super::arguments::{Mode, RobotArguments};
use super::extraction::ExtractionThread;
use super::front_end::FrontEnd;
use super::lifecycle::Lifecycle;
use super::publisher::Publisher;
use super::query_client::QueryClient;
use super::recorder::Recorder;
use super::run::{RobotRun, run};
use super::start::{excerpt, initial_state};
use super::summary::Summary;
use crate::estimator::{Estimator, RigCamera};
use crate::evaluation::{RunScore, ScoreOptions, score_run};
use crate::sequence::Sequence;
use anyhow::{Context as _, Result, bail};
use std::time::Duration;
use tokio::runtime::Handle;
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
    /// States and events.
    pub recorder: Recorder,
}

/// Runs a robot through a recording and writes the output folder.
///
/// A run that ends early (a diverged filter) is written up to there; the summary says why.
///
/// # Errors
/// A sentence: switches that contradict the recording, no start, an output folder that cannot be written.
pub fn run_robot(
    sequence: &Sequence,
    arguments: &RobotArguments,
    link: Option<MapLink>,
    progress: impl FnMut(usize),
) -> Result<Outcome> {
    let part = excerpt_of(sequence, arguments)?;
    let sequence = part.as_ref().unwrap_or(sequence);
    let config = arguments.estimator_config(sequence)?;
    // Before anything takes long: a run whose results cannot be kept is not worth its time.
    std::fs::create_dir_all(&arguments.out)
        .with_context(|| format!("--out: cannot make the folder {}", arguments.out.display()))?;
    let cameras = arguments.camera_count(sequence)?;
    if !(arguments.query_interval.is_finite() && arguments.query_interval >= 0.0) {
        bail!(
            "--query-interval is {}; it must be zero or a positive number of seconds",
            arguments.query_interval
        );
    }
    if !(arguments.deadline.is_finite() && arguments.deadline > 0.0) {
        bail!("--deadline is {}; it must be a positive number of seconds", arguments.deadline);
    }
    let initial = initial_state(sequence, arguments.init, &config)?;
    let rig: Vec<RigCamera> = sequence.cameras[..cameras]
        .iter()
        .map(|sensor| RigCamera { camera: sensor.camera.clone(), imu_from_camera: sensor.imu_from_camera })
        .collect();
    let filter = match &initial {
        Some(initial) => Lifecycle::running(Estimator::new(config.clone(), rig.clone(), initial)?, rig),
        None => Lifecycle::searching(config.clone(), rig),
    };
    let link = link.filter(|_| arguments.mode != Mode::Odometry);
    let map = link.as_ref().map(|link| link.map.clone());
    let (queries, publisher) = match link {
        Some(link) => {
            let deadline = Duration::from_secs_f64(arguments.deadline);
            let queries = QueryClient::new(link.session.clone(), link.runtime.clone(), &link.map, deadline)
                .context("--map")?;
            let publisher = Publisher::new(link.session, &link.runtime, &arguments.robot, &link.map)
                .map_err(anyhow::Error::msg)?;
            (Some(queries), Some(publisher))
        }
        None => (None, None),
    };
    let front_end = front_end(sequence, arguments, cameras)?;
    let extraction = if queries.is_some() { extraction(sequence, arguments)? } else { None };
    let robot = RobotRun {
        sequence,
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
        publisher,
        last_failure: None,
    };
    let mut recorder = Recorder::default();
    let ended_early = run(robot, &mut recorder, progress).err().map(|error| error.to_string());
    if let Some(reason) = &ended_early {
        tracing::error!(reason, "the run ended early");
    }
    let seconds = recorder.seconds();
    let (score, no_score) = match score(sequence, &recorder) {
        Ok(score) => (Some(score), None),
        Err(reason) => (None, Some(reason)),
    };
    let summary = Summary {
        sequence: sequence.root.display().to_string(),
        map,
        cameras,
        frames: recorder.states.len(),
        skipped_frames: recorder.skipped_frames,
        dropped_imu: recorder.dropped_imu,
        seconds,
        wall_seconds: recorder.wall_seconds,
        realtime_factor: seconds / recorder.wall_seconds.max(1e-9),
        milliseconds_per_frame: recorder.timings.mean(),
        score,
        no_score,
        queries: recorder.query_summary(),
        keyframes_pulled: recorder.keyframes_pulled,
        wire_bytes: recorder.traffic,
        tracks: recorder.tracks,
        reinitializations: recorder.reinitializations(),
        starts: recorder.starts.clone(),
        divergences: recorder.divergences.clone(),
        final_status: recorder.final_status.clone(),
        ended_early,
        settings: config,
    };
    recorder.write(&arguments.out, &summary)?;
    Ok(Outcome { summary, recorder })
}

/// The part of the recording that is asked for, where it is not all of it.
fn excerpt_of(sequence: &Sequence, arguments: &RobotArguments) -> Result<Option<Sequence>> {
    if arguments.start_at == 0.0 && arguments.duration.is_none() {
        return Ok(None);
    }
    excerpt(sequence, arguments.start_at, arguments.duration).map(Some)
}

/// What makes tracks of the recording's images, where it has images and no tracks.
fn front_end(sequence: &Sequence, arguments: &RobotArguments, cameras: usize) -> Result<Option<FrontEnd>> {
    let with_tracks = sequence.frames.iter().any(|frame| !frame.tracks.is_empty());
    if !sequence.has_images() || with_tracks {
        return Ok(None);
    }
    let mut options = TrackerOptions::default().points(arguments.points);
    if let Some(mask) = arguments.features.read_mask()? {
        options = options.mask(0, mask);
    }
    Ok(Some(FrontEnd::new(&sequence.cameras[..cameras], options)?))
}

/// What makes features of the recording's images, where it has images and no features.
fn extraction(sequence: &Sequence, arguments: &RobotArguments) -> Result<Option<ExtractionThread>> {
    if !sequence.has_images() || sequence.has_features() {
        return Ok(None);
    }
    let settings = &arguments.features;
    let thread = ExtractionThread::start(settings.open()?, settings.max_features, settings.read_mask()?)?;
    Ok(Some(thread))
}

/// Errors against the recording's truth, or why there are none.
fn score(sequence: &Sequence, recorder: &Recorder) -> Result<RunScore, String> {
    let truth = sequence.groundtruth.as_deref().ok_or("the recording has no ground truth")?;
    let gravity = sequence
        .truth_gravity()
        .ok_or("the direction of gravity in the truth's frame cannot be told from truth and IMU")?;
    score_run(&recorder.states, truth, gravity, &ScoreOptions::default()).map_err(|error| error.to_string())
}
