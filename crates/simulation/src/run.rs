//! One run: everything that is recorded along a way.

use super::features::{Extractor, dropouts};
use super::random::{Purpose, normal3, stream};
use super::spline::Spline;
use super::tracks::FrontEnd;
use super::world::Landmark;
use super::{GRAVITY, Scenario, SimulationError, SimulationOptions, imu, path};
use geometry::pose::Pose;
use geometry::rotation;
use nalgebra::Vector3;
use sensors::{CameraSensor, Frame, ImuSensor, ReferencePose, Sequence, TruthRow};
use std::path::PathBuf;

/// When the map's run begins, nanoseconds: any time will do.
const MAP_START_NS: i64 = 1_700_000_000_000_000_000;
/// The live run begins a day later.
const LIVE_START_NS: i64 = MAP_START_NS + 86_400_000_000_000;
/// The first image comes so long after the first IMU sample, as in most recordings.
const FIRST_FRAME_NS: i64 = 100_000_000;
/// How far beside a given trajectory the live run goes, metres.
const SIDEWAYS: f64 = 1.0;

/// What a run is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// To build a map from.
    Map = 0,
    /// To localize in it.
    Live = 1,
}

/// Landmarks of the map's run reach further than where the live run ends, by so long, seconds.
const AHEAD_S: f64 = 5.0;

/// The ways of both runs.
pub(crate) struct Ways {
    pub(crate) map: Spline,
    pub(crate) live: Spline,
    /// Both as far as they show something new: once round.
    pub(crate) first_laps: [Spline; 2],
}

/// The built-in ways, or the given ones.
pub(crate) fn ways(options: &SimulationOptions) -> Result<Ways, SimulationError> {
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
    let first_lap = |way: &Spline| {
        let repeats = is_built_in && options.scenario == Scenario::Loops;
        if repeats { way.until(way.start_ns() + (lap_s * 1e9) as i64) } else { way.clone() }
    };
    let first_laps = [first_lap(&map), first_lap(&live)];
    Ok(Ways { map, live, first_laps })
}

/// Records a run.
pub(crate) fn record(
    options: &SimulationOptions,
    kind: Kind,
    way: &Spline,
    cameras: &[CameraSensor],
    landmarks: &[Landmark],
) -> Sequence {
    let run = kind as u64;
    let imu = imu::record(options, way, run);
    let frames = frames(options, kind, way, cameras, landmarks);
    let truth_stamps = std::iter::once(way.start_ns()).chain(frames.iter().map(|frame| frame.stamp_ns));
    let groundtruth = truth_stamps.map(|stamp_ns| {
        let motion = way.at(stamp_ns);
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
        reference_poses: (kind == Kind::Map).then(|| reference_poses(options, way, &frames)),
        imu: Some(ImuSensor {
            noise: options.imu_noise,
            rate_hz: options.imu_rate_hz,
            gravity_magnitude: Some(GRAVITY),
        }),
        imu_samples: imu.samples,
        cameras: cameras.to_vec(),
        frames,
    }
}

fn frames(
    options: &SimulationOptions,
    kind: Kind,
    way: &Spline,
    cameras: &[CameraSensor],
    landmarks: &[Landmark],
) -> Vec<Frame> {
    let run = kind as u64;
    let mut front_end = FrontEnd::new(options, run);
    let mut extractor = Extractor::new(options, run);
    let (blind, period_s) = match kind {
        Kind::Map => (Vec::new(), options.map_feature_period_s),
        Kind::Live => (dropouts(options, run), options.live_feature_period_s),
    };
    let every = (period_s * options.frame_rate_hz).round().max(1.0) as usize;
    let duration = (way.end_ns() - way.start_ns()) as f64;
    let count = ((duration - FIRST_FRAME_NS as f64) * 1e-9 * options.frame_rate_hz).max(0.0) as usize + 1;
    (0..count)
        .map(|index| {
            let since = (index as f64 * 1e9 / options.frame_rate_hz).round() as i64;
            let stamp_ns = way.start_ns() + FIRST_FRAME_NS + since;
            let pose = way.at(stamp_ns).pose;
            let fraction = (stamp_ns - way.start_ns()) as f64 / duration;
            let sees_map =
                index.is_multiple_of(every) && !blind.iter().any(|stretch| stretch.contains(&fraction));
            Frame {
                stamp_ns,
                images: [None, None],
                tracks: front_end.look(&pose, cameras, landmarks),
                features: sees_map.then(|| extractor.extract(&pose, &cameras[0], landmarks)),
            }
        })
        .collect()
}

/// The poses of the images with features as an imperfect mapping system gives them: each off on its own.
fn reference_poses(options: &SimulationOptions, way: &Spline, frames: &[Frame]) -> Vec<ReferencePose> {
    let mut rng = stream(options.seed, Kind::Map as u64, Purpose::Reference);
    let (sigma_theta_rad, sigma_p_m) = (options.sigma_reference_theta_rad, options.sigma_reference_p_m);
    frames
        .iter()
        .filter(|frame| frame.features.is_some())
        .map(|frame| {
            let truth = way.at(frame.stamp_ns).pose;
            let turn: Vector3<f64> = normal3(&mut rng) * sigma_theta_rad;
            let shift: Vector3<f64> = normal3(&mut rng) * sigma_p_m;
            let pose = Pose::new(rotation::exp(&turn) * truth.rotation, truth.translation + shift);
            ReferencePose { stamp_ns: frame.stamp_ns, pose, sigma_theta_rad, sigma_p_m }
        })
        .collect()
}
