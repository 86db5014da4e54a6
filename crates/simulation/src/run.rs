//! One run: everything that is recorded along a trajectory.

use super::exposure::Exposure;
use super::features::{Extractor, dropout_intervals};
use super::random::{Purpose, normal3, stream};
use super::spline::Spline;
use super::tracks::FrontEnd;
use super::world::Landmark;
use super::{GRAVITY, Scenario, SimulationError, SimulationOptions, imu, path};
use geometry::pose::Pose;
use geometry::rotation;
use nalgebra::Vector3;
use sensors::{CameraSensor, Frame, ImuSensor, ReferencePose, Sequence, TruthRow, camera_groups};
use std::path::PathBuf;

/// Start of the map's run, nanoseconds; arbitrary.
const MAP_START_NS: i64 = 1_700_000_000_000_000_000;
/// The live run begins a day later.
const LIVE_START_NS: i64 = MAP_START_NS + 86_400_000_000_000;
/// Time from the first IMU sample to the first image, nanoseconds, as in most recordings.
const FIRST_FRAME_NS: i64 = 100_000_000;
/// Distance of the live run to the left of a given trajectory, metres.
const SIDEWAYS: f64 = 1.0;

/// Purpose of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// To build a map from.
    Map = 0,
    /// To localize in it.
    Live = 1,
}

/// A run: its purpose, and the number by which its noise differs from that of other runs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Run {
    pub(crate) kind: Kind,
    pub(crate) number: u64,
}

impl From<Kind> for Run {
    fn from(kind: Kind) -> Self {
        Run { kind, number: kind as u64 }
    }
}

/// Time by which the map's run goes on after the end of the live run, so that landmarks reach further, seconds.
const AHEAD_S: f64 = 5.0;

/// The trajectories of both runs.
pub(crate) struct Trajectories {
    pub(crate) map: Spline,
    pub(crate) live: Spline,
    /// Both up to the end of their first lap: later laps see the same landmarks.
    pub(crate) first_laps: [Spline; 2],
}

/// The built-in trajectories, or the given ones.
pub(crate) fn trajectories(options: &SimulationOptions) -> Result<Trajectories, SimulationError> {
    let built_in = |start_ns: i64, kind: Kind| {
        path::built_in(
            options.scenario,
            start_ns,
            options.speed,
            &path::Style::of_run(options.seed, kind as u64),
        )
    };
    let mut map = match &options.map_trajectory {
        Some(given) => path::along(given, MAP_START_NS, 0.0)?,
        None => built_in(MAP_START_NS, Kind::Map)?,
    };
    let mut live = match (&options.live_trajectory, &options.map_trajectory) {
        (Some(given), _) => path::along(given, LIVE_START_NS, 0.0)?,
        (None, Some(given)) => path::along(given, LIVE_START_NS, SIDEWAYS)?,
        (None, None) => built_in(LIVE_START_NS, Kind::Live)?,
    };
    if let Some(seconds) = options.duration_s {
        map = map.until(MAP_START_NS + ((seconds + AHEAD_S) * 1e9) as i64);
        live = live.until(LIVE_START_NS + (seconds * 1e9) as i64);
    }
    let is_built_in = options.live_trajectory.is_none() && options.map_trajectory.is_none();
    let lap_s = options.scenario.lap_length() / options.speed + AHEAD_S;
    let first_lap = |trajectory: &Spline| {
        let repeats = is_built_in && options.scenario == Scenario::Loops;
        if repeats {
            trajectory.until(trajectory.start_ns() + (lap_s * 1e9) as i64)
        } else {
            trajectory.clone()
        }
    };
    let first_laps = [first_lap(&map), first_lap(&live)];
    Ok(Trajectories { map, live, first_laps })
}

/// Records a run of tracks and features.
pub(crate) fn record(
    options: &SimulationOptions,
    run: impl Into<Run>,
    trajectory: &Spline,
    cameras: &[CameraSensor],
    landmarks: &[Landmark],
) -> Sequence {
    let run = run.into();
    let frames = frames(options, run, trajectory, cameras, landmarks);
    with_readings(options, run, trajectory, cameras, frames)
}

/// A recording of frames, with IMU and truth of the same motion, and the map's run with reference poses: of the frames with
/// features, and without any features of all.
pub(crate) fn with_readings(
    options: &SimulationOptions,
    run: impl Into<Run>,
    trajectory: &Spline,
    cameras: &[CameraSensor],
    frames: Vec<Frame>,
) -> Sequence {
    let Run { kind, number } = run.into();
    let imu = imu::record(options, trajectory, number);
    let truth_stamps =
        std::iter::once(trajectory.start_ns()).chain(frames.iter().map(|frame| frame.stamp_ns));
    let groundtruth = truth_stamps.map(|stamp_ns| {
        let motion = trajectory.at(stamp_ns);
        let sample = imu.samples.partition_point(|sample| sample.stamp_ns <= stamp_ns).saturating_sub(1);
        TruthRow {
            stamp_ns,
            pose: motion.pose,
            velocity: Some(motion.velocity),
            gyroscope_bias: Some(imu.gyroscope_biases[sample]),
            accelerometer_bias: Some(imu.accelerometer_biases[sample]),
        }
    });
    Sequence {
        root: PathBuf::new(),
        groundtruth: Some(groundtruth.collect()),
        reference_poses: (kind == Kind::Map).then(|| reference_poses(options, trajectory, &frames)),
        imu: Some(ImuSensor {
            noise: options.imu_noise,
            rate_hz: options.imu_rate_hz,
            gravity_magnitude: Some(GRAVITY),
            intrinsics: None,
        }),
        imu_samples: imu.samples,
        wheels: None,
        wheel_readings: Vec::new(),
        gnss: None,
        gnss_readings: Vec::new(),
        cameras: cameras.to_vec(),
        frames,
    }
}

fn frames(
    options: &SimulationOptions,
    run: Run,
    trajectory: &Spline,
    cameras: &[CameraSensor],
    landmarks: &[Landmark],
) -> Vec<Frame> {
    let mut front_end = FrontEnd::new(options, run.number, cameras);
    let mut extractor = Extractor::new(options, run.number);
    let (dropouts, period_s) = match run.kind {
        Kind::Map => (Vec::new(), options.map_feature_period_s),
        Kind::Live => (dropout_intervals(options, run.number), options.live_feature_period_s),
    };
    let described: Vec<usize> = camera_groups(cameras).iter().map(|group| group.first).collect();
    let every = (period_s * options.frame_rate_hz).round().max(1.0) as usize;
    let duration = (trajectory.end_ns() - trajectory.start_ns()) as f64;
    frame_stamps(options, trajectory)
        .enumerate()
        .map(|(index, stamp_ns)| {
            let exposure = Exposure::of(trajectory, stamp_ns);
            let fraction = (stamp_ns - trajectory.start_ns()) as f64 / duration;
            let has_features =
                index.is_multiple_of(every) && !dropouts.iter().any(|stretch| stretch.contains(&fraction));
            let described = if has_features { &described[..] } else { &[] };
            let mut extract = |camera: usize| extractor.extract(&exposure, &cameras[camera], landmarks);
            Frame {
                stamp_ns,
                tracks: front_end.track(&exposure, landmarks),
                features: described.iter().map(|&camera| (camera, extract(camera))).collect(),
                ..Frame::default()
            }
        })
        .collect()
}

/// Times of the images of a run, nanoseconds.
pub(crate) fn frame_stamps(
    options: &SimulationOptions,
    trajectory: &Spline,
) -> impl Iterator<Item = i64> + use<> {
    let (first_ns, rate_hz) = (trajectory.start_ns() + FIRST_FRAME_NS, options.frame_rate_hz);
    let seconds = (trajectory.end_ns() - first_ns) as f64 * 1e-9;
    let count = (seconds * rate_hz).max(0.0) as usize + 1;
    (0..count).map(move |index| first_ns + (index as f64 * 1e9 / rate_hz).round() as i64)
}

/// The poses of the images with features as a mapping system gives them: each with an independent error.
fn reference_poses(options: &SimulationOptions, trajectory: &Spline, frames: &[Frame]) -> Vec<ReferencePose> {
    let mut rng = stream(options.seed, Kind::Map as u64, Purpose::Reference);
    let (sigma_theta_rad, sigma_p_m) = (options.sigma_reference_theta_rad, options.sigma_reference_p_m);
    let has_features = frames.iter().any(|frame| !frame.features.is_empty());
    frames
        .iter()
        .filter(|frame| !has_features || !frame.features.is_empty())
        .map(|frame| {
            let truth = trajectory.at(frame.stamp_ns).pose;
            let turn: Vector3<f64> = normal3(&mut rng) * sigma_theta_rad;
            let shift: Vector3<f64> = normal3(&mut rng) * sigma_p_m;
            let pose = Pose::new(rotation::exp(&turn) * truth.rotation, truth.translation + shift);
            ReferencePose::isotropic(frame.stamp_ns, pose, sigma_theta_rad, sigma_p_m)
        })
        .collect()
}
