//! `driftless evaluate`: accuracy (ATE, RPE) and consistency (NEES) of an estimated trajectory.

use anyhow::{Context, ensure};
use evaluation::trajectory::{StateKind, TrajectoryFile, read_any};
use evaluation::{
    Alignment, Delta, Nees, NeesSum, Pair, Statistics, absolute_errors, align, associate, nees, nees_bounds,
    relative_errors,
};
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::Vector3;
use serde::Serialize;
use std::path::PathBuf;

/// Confidence of the bounds printed beside the NEES.
const CONFIDENCE: f64 = 0.95;

/// How the estimate is aligned with the ground truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum AlignArgument {
    /// Not aligned: both are in the same frame
    None,
    /// Rotation about gravity, and translation
    Yaw,
    /// Rotation and translation (Umeyama, without scale)
    Se3,
}

/// Which pose of a `states.csv`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum StateArgument {
    /// The IMU in the odometry frame
    #[value(name = "local_from_imu")]
    LocalFromImu,
    /// The odometry frame in the map
    #[value(name = "global_from_local")]
    GlobalFromLocal,
    /// The IMU in the map
    #[value(name = "global_from_imu")]
    GlobalFromImu,
}

impl From<StateArgument> for StateKind {
    fn from(argument: StateArgument) -> Self {
        match argument {
            StateArgument::LocalFromImu => Self::LocalFromImu,
            StateArgument::GlobalFromLocal => Self::GlobalFromLocal,
            StateArgument::GlobalFromImu => Self::GlobalFromImu,
        }
    }
}

/// Unit of the segment length of the relative error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum UnitArgument {
    /// Poses
    Frames,
    /// Metres of the estimated path
    Metres,
    /// Seconds
    Seconds,
}

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Files: TUM trajectories, EuRoC ground truth (data.csv), or states.csv of a run.\n\n\
    Examples:\n  \
    driftless evaluate --groundtruth SEQ/mav0/state_groundtruth_estimate0/data.csv --estimate out/pose.tum\n  \
    driftless evaluate --groundtruth truth.tum --estimate out/odometry.tum --align yaw\n  \
    driftless evaluate --groundtruth truth.tum --estimate out/states.csv --state global_from_imu --json")]
pub struct Args {
    /// Ground truth
    #[arg(long, value_name = "FILE")]
    groundtruth: PathBuf,
    /// The estimate
    #[arg(long, value_name = "FILE")]
    estimate: PathBuf,
    /// How the estimate is aligned with the ground truth
    #[arg(long, value_enum, default_value = "none")]
    align: AlignArgument,
    /// Which pose, where the estimate is a states.csv
    #[arg(long, value_enum, default_value = "global_from_imu")]
    state: StateArgument,
    /// Direction of gravity in the ground truth's frame, for --align yaw
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_delimiter = ',',
        allow_hyphen_values = true,
        default_value = "0,0,-1"
    )]
    gravity: Vec<f64>,
    /// Direction of gravity in the estimate's frame, for --align yaw
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_delimiter = ',',
        allow_hyphen_values = true,
        default_value = "0,0,-1"
    )]
    estimate_gravity: Vec<f64>,
    /// Largest time difference of associated poses, seconds
    #[arg(long, value_name = "S", default_value_t = 0.01)]
    max_difference: f64,
    /// Segment length of the relative error (RPE)
    #[arg(long, default_value_t = 1.0)]
    delta: f64,
    /// Unit of --delta
    #[arg(long, value_enum, default_value = "frames")]
    delta_unit: UnitArgument,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// The figures.
#[derive(Debug, Serialize)]
struct Report {
    pairs: usize,
    ate_m: Option<Statistics>,
    ate_deg: Option<Statistics>,
    rpe_m: Option<Statistics>,
    rpe_deg: Option<Statistics>,
    nees: Option<NeesReport>,
}

/// Consistency, with the bounds of as many *independent* samples.
#[derive(Debug, Serialize)]
struct NeesReport {
    #[serde(flatten)]
    mean: Nees,
    samples: usize,
    bounds_3: Option<(f64, f64)>,
    bounds_6: Option<(f64, f64)>,
}

/// Runs the command.
///
/// # Errors
/// Files that cannot be read, have no time in common, or cannot be aligned.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let truth =
        read_any(&args.groundtruth, StateKind::GlobalFromImu).context("the ground truth cannot be read")?;
    let estimate = read_any(&args.estimate, args.state.into()).context("the estimate cannot be read")?;
    ensure!(args.max_difference >= 0.0, "--max-difference must not be negative");
    let pairs = associate(&truth.poses, &estimate.poses, (args.max_difference * 1e9).round() as i64);
    let positions: Vec<_> = pairs
        .iter()
        .map(|pair| {
            (truth.poses[pair.reference].pose.translation, estimate.poses[pair.estimate].pose.translation)
        })
        .collect();
    let alignment = match args.align {
        AlignArgument::None => Alignment::None,
        AlignArgument::Se3 => Alignment::Se3,
        AlignArgument::Yaw => Alignment::Yaw {
            gravity_in_reference: direction(&args.gravity, "--gravity")?,
            gravity_in_estimate: direction(&args.estimate_gravity, "--estimate-gravity")?,
        },
    };
    let aligned = align(&positions, &alignment).context("the trajectories cannot be compared")?;
    let absolute = absolute_errors(&truth.poses, &estimate.poses, &pairs, &aligned);
    let relative = relative_errors(&truth.poses, &estimate.poses, &pairs, delta(args)?);
    let report = Report {
        pairs: pairs.len(),
        ate_m: absolute.translation(),
        ate_deg: absolute.rotation(),
        rpe_m: relative.translation(),
        rpe_deg: relative.rotation(),
        nees: consistency(&truth, &estimate, &pairs, &aligned),
    };
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print(&report, args);
    }
    Ok(())
}

fn direction(given: &[f64], option: &str) -> anyhow::Result<Vector3<f64>> {
    ensure!(given.len() == 3, "{option} takes three numbers, as in 0,0,-1");
    let vector = Vector3::from_column_slice(given);
    vector.try_normalize(1e-9).filter(|unit| unit.iter().all(|value| value.is_finite())).with_context(|| {
        format!("{option} must be a direction, not {}, {}, {}", vector.x, vector.y, vector.z)
    })
}

fn delta(args: &Args) -> anyhow::Result<Delta> {
    ensure!(args.delta.is_finite() && args.delta > 0.0, "--delta must be positive");
    Ok(match args.delta_unit {
        UnitArgument::Frames => {
            ensure!(
                args.delta >= 1.0 && args.delta.fract() == 0.0,
                "--delta must be a whole number of frames"
            );
            Delta::Frames(args.delta as usize)
        }
        UnitArgument::Metres => Delta::Metres(args.delta),
        UnitArgument::Seconds => Delta::Seconds(args.delta),
    })
}

/// NEES, where the estimate has covariances. Alignment moves them along.
fn consistency(
    truth: &TrajectoryFile,
    estimate: &TrajectoryFile,
    pairs: &[Pair],
    moved: &Pose,
) -> Option<NeesReport> {
    let covariances = estimate.covariances.as_ref()?;
    let mut sum = NeesSum::default();
    for pair in pairs {
        let pose = estimate.poses[pair.estimate].pose;
        let state = PoseWithCovariance::new(pose, covariances[pair.estimate]).change_of_parent(moved);
        if let Some(nees) = nees(&state, &truth.poses[pair.reference].pose) {
            sum.push(&nees);
        }
    }
    let samples = sum.samples();
    Some(NeesReport {
        mean: sum.mean()?,
        samples,
        bounds_3: nees_bounds(3, samples, CONFIDENCE),
        bounds_6: nees_bounds(6, samples, CONFIDENCE),
    })
}

fn print(report: &Report, args: &Args) {
    let align = match args.align {
        AlignArgument::None => "not aligned",
        AlignArgument::Yaw => "aligned in yaw and position",
        AlignArgument::Se3 => "aligned in rotation and position",
    };
    println!("{} pairs of poses, {align}", report.pairs);
    println!("{:<16}{:>12}{:>12}{:>12}{:>12}{:>12}", "", "rmse", "mean", "median", "std", "max");
    let unit = match args.delta_unit {
        UnitArgument::Frames => "frames",
        UnitArgument::Metres => "m",
        UnitArgument::Seconds => "s",
    };
    for (name, statistics) in [
        ("ATE [m]", &report.ate_m),
        ("ATE [deg]", &report.ate_deg),
        ("RPE [m]", &report.rpe_m),
        ("RPE [deg]", &report.rpe_deg),
    ] {
        match statistics {
            Some(s) => println!(
                "{name:<16}{:>12.6}{:>12.6}{:>12.6}{:>12.6}{:>12.6}",
                s.rmse, s.mean, s.median, s.std, s.max
            ),
            None => println!("{name:<16}   no segment of {} {unit} is complete", args.delta),
        }
    }
    if let Some(nees) = &report.nees {
        let bounds = |bounds: Option<(f64, f64)>| {
            bounds.map_or_else(String::new, |(low, high)| format!(" ({low:.3} to {high:.3})"))
        };
        println!(
            "NEES per degree of freedom, 1 is consistent (95 % bounds of {} independent samples): \
             rotation {:.3}{}, position {:.3}{}, pose {:.3}{}",
            nees.samples,
            nees.mean.rotation,
            bounds(nees.bounds_3),
            nees.mean.position,
            bounds(nees.bounds_3),
            nees.mean.pose,
            bounds(nees.bounds_6)
        );
    }
}
