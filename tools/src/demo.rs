//! The whole system on simulated input: a place, a map of it, a served map, and a robot in it, once for
//! each variant of the paper's table.

use crate::in_process::{LocalServer, load_map};
use crate::plotting::comparison::{ComparedRun, Comparison, draw, stretches_without_features};
use crate::plotting::{RunFiles, Truth, draw_run};
use anyhow::{Context as _, Result, bail};
use evaluation::trajectory::StampedPose;
use evaluation::{Score, run_errors};
use map::text::save_map;
use mapping::{BuildOptions, BuildReport, build_map};
use nalgebra::Vector3;
use onboard::arguments::{Init, Mode};
use onboard::{Outcome, RobotArguments, run_robot};
use sensors::{ImuNoise, Sequence};
use serde::Serialize;
use simulation::{SimulatedScenario, SimulationOptions, simulate};
use std::path::{Path, PathBuf};

/// One row of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Variant {
    /// As the paper calls it.
    pub name: &'static str,
    /// Folder of its run.
    pub folder: &'static str,
    /// The robot's mode.
    pub mode: Mode,
    /// Whether it moves its linearization point (R).
    pub relinearize: bool,
}

/// The rows of the table, in its order.
pub const VARIANTS: [Variant; 6] = [
    Variant { name: "odometry", folder: "odometry", mode: Mode::Odometry, relinearize: false },
    Variant { name: "SM", folder: "sm", mode: Mode::Single, relinearize: false },
    Variant { name: "SM+R", folder: "sm_r", mode: Mode::Single, relinearize: true },
    Variant { name: "MM", folder: "mm", mode: Mode::Multi, relinearize: false },
    Variant { name: "MM+R", folder: "mm_r", mode: Mode::Multi, relinearize: true },
    Variant { name: "mapconst", folder: "mapconst", mode: Mode::Mapconst, relinearize: true },
];

/// A variant's result.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The variant.
    pub name: &'static str,
    /// Pose in G; for plain odometry the local pose, as if L had been put where it truly lies.
    pub pose: Option<Score>,
    /// Pose in L.
    pub local: Option<Score>,
    /// `G_T_L`.
    pub transform: Option<Score>,
    /// Queries that corrected the state, and how many were sent.
    pub accepted: u64,
    /// Queries sent.
    pub sent: u64,
    /// Milliseconds a frame.
    pub milliseconds_per_frame: f64,
}

/// What the demo made.
#[derive(Clone, Debug, Serialize)]
pub struct Demo {
    /// Length of the live run, metres.
    pub distance_m: f64,
    /// How the map turned out.
    pub map: BuildReport,
    /// The table.
    pub rows: Vec<Row>,
    /// Pictures that were drawn.
    pub pictures: Vec<PathBuf>,
}

/// Runs the demo into `out`.
///
/// # Arguments
/// * `note`: told what is being done.
///
/// # Errors
/// A folder that cannot be written, or no free port for the server.
pub fn run_demo(out: &Path, seed: u64, note: &mut dyn FnMut(&str)) -> Result<Demo> {
    std::fs::create_dir_all(out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    note("simulating a place and two runs through it");
    let place = simulate(&options(seed))?;
    note("building the map");
    let gravity = -Vector3::z();
    let references = place.map.reference_poses.clone().unwrap_or_default();
    let build = BuildOptions { gravity_in_global: Some(gravity), ..BuildOptions::default() };
    let (contents, map) = build_map(&place.map, &references, None, &build, &mut |_, _, _| {})?;
    let keyframes =
        contents.keyframes.iter().map(|keyframe| keyframe.global_from_keyframe.pose.translation).collect();
    let database = out.join("map.db");
    save_map(&database, &contents, true)?;

    note("starting the map server");
    let server = LocalServer::start(vec![("demo".to_owned(), load_map(&database)?)])?;
    let mut rows = Vec::new();
    let mut outcomes = Vec::new();
    for variant in VARIANTS {
        note(&format!("the robot runs: {}", variant.name));
        let outcome = run_variant(&place.live, &variant, &server, &out.join(variant.folder))?;
        rows.push(row(&variant, &outcome));
        outcomes.push((variant, outcome));
    }
    server.stop()?;

    note("drawing");
    let pictures = pictures(&place, keyframes, gravity, &outcomes, out)?;
    let distance_m = outcomes[0].1.summary.score.as_ref().map_or(0.0, |score| score.distance_m);
    let demo = Demo { distance_m, map, rows, pictures };
    std::fs::write(out.join("demo.json"), serde_json::to_string_pretty(&demo)?)?;
    Ok(demo)
}

/// A robot with a cheap gyroscope (ten times EuRoC's noise), few tracks, and a third of its way without a
/// map: odometry alone drifts visibly, and the map brings it back.
fn options(seed: u64) -> SimulationOptions {
    let mut imu_noise = ImuNoise::default();
    imu_noise.gyroscope *= 10.0;
    imu_noise.gyroscope_walk *= 10.0;
    SimulationOptions {
        seed,
        imu_noise,
        max_tracks: 40,
        dropout_fraction: 0.35,
        ..SimulationOptions::default()
    }
}

fn run_variant(live: &Sequence, variant: &Variant, server: &LocalServer, out: &Path) -> Result<Outcome> {
    let mut arguments = RobotArguments::with_defaults(out)?;
    arguments.mode = Some(variant.mode);
    arguments.no_relinearize = !variant.relinearize;
    arguments.init = Init::Truth;
    let link = server.link("demo")?;
    let outcome = run_robot(live, &arguments, Some(link.clone()), |_| {})?;
    server.unlink(&link);
    if let Some(reason) = &outcome.summary.ended_early {
        bail!("the run of {} ended early: {reason}", variant.name);
    }
    Ok(outcome)
}

fn row(variant: &Variant, outcome: &Outcome) -> Row {
    let score = outcome.summary.score.as_ref();
    let local = score.map(|score| score.local);
    let pose = if variant.mode == Mode::Odometry { local } else { score.and_then(|score| score.pose) };
    Row {
        name: variant.name,
        pose,
        local,
        transform: score.and_then(|score| score.transform),
        accepted: outcome.summary.queries.accepted,
        sent: outcome.summary.queries.sent,
        milliseconds_per_frame: outcome.summary.milliseconds_per_frame.total,
    }
}

fn pictures(
    place: &SimulatedScenario,
    keyframes: Vec<Vector3<f64>>,
    gravity: Vector3<f64>,
    outcomes: &[(Variant, Outcome)],
    out: &Path,
) -> Result<Vec<PathBuf>> {
    let truth = Truth { rows: place.live.groundtruth.clone().unwrap_or_default(), gravity };
    let mut drawn = Vec::new();
    let mut runs = Vec::new();
    for (variant, outcome) in outcomes {
        let states = &outcome.states()?;
        let lays_in_global = match variant.mode {
            Mode::Odometry => Some(run_errors(states, &truth.rows, gravity)?.true_global_from_local),
            _ => None,
        };
        let pose_of = |state: &evaluation::trajectory::StateRow| match lays_in_global {
            Some(global_from_local) => Some(global_from_local * state.local_from_imu.pose),
            None => state.global_from_imu.as_ref().map(|global_from_imu| global_from_imu.pose),
        };
        if matches!(variant.name, "odometry" | "SM+R" | "MM+R" | "mapconst") {
            let poses = states
                .iter()
                .filter_map(|state| Some(StampedPose { stamp_ns: state.stamp_ns, pose: pose_of(state)? }))
                .collect();
            runs.push(ComparedRun { name: variant.name.to_owned(), poses });
        }
        if variant.name == "MM+R" {
            let folder = out.join(variant.folder);
            let mut run = RunFiles::read(&folder, None, None)
                .or_else(|_| RunFiles::read(&folder, None, Some(gravity)))?;
            "demo, MM+R".clone_into(&mut run.name);
            run.truth = Some(truth.clone());
            run.keyframes.clone_from(&keyframes);
            drawn.extend(draw_run(&run, &folder)?.pictures);
        }
    }
    let dropouts = stretches_without_features(&place.live.frames, 3_000_000_000);
    let title = "Simulated town: truth, odometry, and the robot in the served map".to_owned();
    let comparison = Comparison { title, truth, keyframes, dropouts, runs };
    drawn.push(draw(&comparison, &out.join("comparison.svg"))?);
    Ok(drawn)
}
