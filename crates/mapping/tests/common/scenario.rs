//! A small simulated scenario: once round a ring of 88 m, at rest at both ends.

use evaluation::trajectory::StampedPose;
use geometry::pose::Pose;
use map::contents::MapContents;
use map::store;
use mapping::{BuildOptions, build_map};
use nalgebra::{UnitQuaternion, Vector3};
use recognition::LoadedMap;
use simulation::{SimulatedScenario, SimulationOptions, simulate};
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// Name of the map's database.
const DATABASE: &str = "ring.db";
/// Radius of the ring, metres.
const RADIUS: f64 = 14.0;
/// Rest before the start, from which the robot finds gravity and its gyroscope's bias, seconds.
const REST_BEFORE_S: f64 = 2.0;
/// Rest at the end, seconds.
const REST_AFTER_S: f64 = 1.0;
/// Time for the round, seconds.
const ROUND_S: f64 = 27.0;
/// Distance between the given poses, nanoseconds.
const STEP_NS: i64 = 50_000_000;

/// A scenario: its two recordings, and the map that was built from the first.
#[derive(Clone, Debug)]
pub struct MappedScenario {
    /// The simulated recordings.
    pub recordings: SimulatedScenario,
    /// The map.
    pub map: MapContents,
}

impl MappedScenario {
    /// Simulates and maps the scenario of a seed.
    pub fn new(seed: u64) -> Self {
        Self::of(&options(seed))
    }

    /// Simulates and maps another scenario.
    pub fn of(simulation: &SimulationOptions) -> Self {
        let recordings = simulate(simulation).unwrap();
        let references = recordings.map.reference_poses.clone().unwrap();
        let mut options = BuildOptions::default();
        options.name = String::from("ring");
        options.gravity_in_global = Some(-Vector3::z());
        let (mut map, _) =
            build_map(&recordings.map, &references, None, &options, &mut |_, _, _| {}).unwrap();
        // Changed versions of it are versions of the same map.
        map.info.identity = Some(map.digest());
        Self { recordings, map }
    }

    /// The scenario of most tests; its map is built once.
    pub fn shared() -> &'static Self {
        static SHARED: OnceLock<MappedScenario> = OnceLock::new();
        SHARED.get_or_init(|| {
            let made = testing::made_once("ring", &[], |folder| {
                MappedScenario::new(7).database(folder);
            });
            let map = store::load_map(made.join(DATABASE)).unwrap().contents;
            MappedScenario { recordings: simulate(&options(7)).unwrap(), map }
        })
    }

    /// The map in a new database in `folder`, closed again.
    pub fn database(&self, folder: &Path) -> PathBuf {
        let path = folder.join(DATABASE);
        store::save_map(&path, &self.map, false).unwrap();
        path
    }

    /// The map as a server holds it, without a database.
    pub fn loaded(&self) -> Arc<LoadedMap> {
        Arc::new(LoadedMap::from_contents(self.map.clone()).unwrap())
    }
}

/// Options of the simulation.
pub fn options(seed: u64) -> SimulationOptions {
    let phase = seed as f64;
    SimulationOptions {
        seed,
        map_trajectory: Some(ring(phase, -0.5)),
        live_trajectory: Some(ring(phase + 2.0, 0.6)),
        live_feature_period_s: 0.5,
        dropout_fraction: 0.2,
        ..SimulationOptions::default()
    }
}

/// Trajectory of one run: `lateral` metres to the left of the ring, swaying.
fn ring(phase: f64, lateral: f64) -> Vec<StampedPose> {
    let duration_s = REST_BEFORE_S + ROUND_S + REST_AFTER_S;
    let count = (duration_s * 1e9) as i64 / STEP_NS;
    let pose = |step: i64| StampedPose {
        stamp_ns: step * STEP_NS,
        pose: ring_pose((step * STEP_NS) as f64 * 1e-9, phase, lateral),
    };
    (0..=count).map(pose).collect()
}

fn ring_pose(time: f64, phase: f64, lateral: f64) -> Pose {
    // Smooth from rest to rest: position, velocity and acceleration are continuous.
    let part = ((time - REST_BEFORE_S) / ROUND_S).clamp(0.0, 1.0);
    let angle = TAU * part - (TAU * part).sin() * 0.7;
    let envelope = (part * (1.0 - part) * 8.0).clamp(0.0, 1.0);
    let sway = |period: f64, shift: f64| envelope * (TAU * time / period + phase + shift).sin();
    let radius = RADIUS - lateral - 0.3 * sway(6.0, 0.0);
    let position = Vector3::new(
        radius * angle.sin(),
        RADIUS - radius * angle.cos(),
        1.5 + 0.5 * sway(9.0, 1.0) + 0.05 * sway(0.9, 2.0),
    );
    let rotation = UnitQuaternion::from_euler_angles(
        0.04 * sway(1.3, 0.5),
        0.04 * sway(1.7, 1.5),
        angle + 0.05 * sway(4.1, 2.5),
    );
    Pose::new(rotation, position)
}
