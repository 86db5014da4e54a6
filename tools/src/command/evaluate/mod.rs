//! `driftless evaluate`: accuracy (ATE, RPE) and consistency (NEES) of an estimated trajectory.

use anyhow::{Context, ensure};
use evaluation::trajectory::{PoseFormat, StateKind, TrajectoryFile, read_any};
use evaluation::{
    Alignment, Delta, MAX_TRUTH_GAP_NS, Nees, NeesSum, Pair, ScoreOptions, Statistics, absolute_errors,
    align, associate, interpolate_reference, nees, nees_bounds, relative_errors,
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
#[command(
    after_help = "Files: TUM trajectories, EuRoC ground truth (data.csv), or states.csv of a run, recognized by content.\n\n\
    For a run the figures are those of its own summary: the truth is interpolated (gaps up to 0.25 s), the pose in the\n\
    map is not aligned and counts from 5 s after the map initialization on, odometry counts from its first pose on.\n\
    `--skip 0 --max-difference 0.01` compares as evo does.\n\n\
    Examples:\n  \
    driftless evaluate --groundtruth SEQ/mav0/state_groundtruth_estimate0/data.csv --estimate out/pose.tum\n  \
    driftless evaluate --groundtruth truth.tum --estimate out/odometry.tum --align yaw\n  \
    driftless evaluate --groundtruth truth.tum --estimate out/states.csv --state global_from_imu --json"
)]
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
    /// Pair each pose with the nearest one of the ground truth within this time, seconds, as evo does [default: interpolate
    /// the ground truth, as `run` does]
    #[arg(long, value_name = "S")]
    max_difference: Option<f64>,
    /// Leave out so many seconds from the first pose on [default: 5 for the poses of a run in the map, which are not
    /// aligned, as `run` does; else 0]
    #[arg(long, value_name = "S")]
    skip: Option<f64>,
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
    /// What was compared, in words.
    scored: String,
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
    let report = evaluate(args)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print(&report, args);
    }
    Ok(())
}

fn evaluate(args: &Args) -> anyhow::Result<Report> {
    let truth = read_any(&args.groundtruth, &[StateKind::GlobalFromImu])
        .context("the ground truth cannot be read")?;
    let estimate = read_any(&args.estimate, &[args.state.into()]).context("the estimate cannot be read")?;
    let (truth, estimate, pairs, scored) = paired(args, truth, estimate)?;
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
    Ok(Report {
        pairs: pairs.len(),
        scored,
        ate_m: absolute.translation(),
        ate_deg: absolute.rotation(),
        rpe_m: relative.translation(),
        rpe_deg: relative.rotation(),
        nees: consistency(&truth, &estimate, &pairs, &aligned),
    })
}

/// Poses of both trajectories at the same times, and which they are, in words.
fn paired(
    args: &Args,
    mut truth: TrajectoryFile,
    mut estimate: TrajectoryFile,
) -> anyhow::Result<(TrajectoryFile, TrajectoryFile, Vec<Pair>, String)> {
    let skip_s = args.skip.unwrap_or_else(|| default_skip(args.align, estimate.format));
    ensure!(skip_s >= 0.0, "--skip must not be negative");
    skip(&mut estimate, skip_s);
    let from = if skip_s > 0.0 {
        format!("from {skip_s} s after the first pose on")
    } else {
        "all poses".to_owned()
    };
    let (pairs, truth_at) = match args.max_difference {
        None => {
            let (interpolated, pairs) =
                interpolate_reference(&truth.poses, &estimate.poses, MAX_TRUTH_GAP_NS);
            truth.poses = interpolated;
            (pairs, "interpolated".to_owned())
        }
        Some(seconds) => {
            ensure!(seconds >= 0.0, "--max-difference must not be negative");
            let pairs = associate(&truth.poses, &estimate.poses, (seconds * 1e9).round() as i64);
            (pairs, format!("the nearest within {seconds} s"))
        }
    };
    Ok((truth, estimate, pairs, format!("{from}, truth {truth_at}")))
}

/// The poses of a run in the map are scored from some time after the map initialization on, which is their first pose.
fn default_skip(align: AlignArgument, estimate: PoseFormat) -> f64 {
    let of_run = match estimate {
        PoseFormat::TumOfRun => true,
        PoseFormat::States(kind) => kind != StateKind::LocalFromImu,
        _ => false,
    };
    if of_run && align == AlignArgument::None {
        ScoreOptions::default().skip_after_initialization_s
    } else {
        0.0
    }
}

/// Removes the first seconds of a trajectory.
fn skip(file: &mut TrajectoryFile, seconds: f64) {
    let Some(first) = file.poses.first() else { return };
    let from_ns = first.stamp_ns.saturating_add((seconds * 1e9) as i64);
    let skipped = file.poses.partition_point(|row| row.stamp_ns < from_ns);
    file.poses.drain(..skipped);
    if let Some(covariances) = &mut file.covariances {
        covariances.drain(..skipped);
    }
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
    println!("{} pairs of poses ({}), {align}", report.pairs, report.scored);
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

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use evaluation::score_run;
    use evaluation::trajectory::states::{self, StateRow};
    use evaluation::trajectory::{StampedPose, tum};
    use geometry::uncertain_pose::isotropic_covariance;
    use nalgebra::UnitQuaternion;
    use sensors::TruthRow;

    #[derive(Parser)]
    struct CommandLine {
        #[command(flatten)]
        args: Args,
    }

    fn report(truth: &std::path::Path, estimate: &std::path::Path, switches: &str) -> Report {
        let paths =
            ["evaluate", "--groundtruth", truth.to_str().unwrap(), "--estimate", estimate.to_str().unwrap()];
        let line = paths.into_iter().chain(switches.split_whitespace());
        evaluate(&CommandLine::try_parse_from(line).unwrap().args).unwrap()
    }

    /// A curve; `t` in seconds.
    fn pose(t: f64) -> Pose {
        Pose::new(
            UnitQuaternion::from_scaled_axis(Vector3::new(0.1 * t.sin(), 0.0, 0.3 * t)),
            Vector3::new((0.9 * t).sin(), (0.7 * t).cos(), 0.1 * t),
        )
    }

    /// A run of 20 s that is localized after 3 s, with errors that shrink, and truth at other times.
    fn files(folder: &std::path::Path) -> (Vec<StateRow>, Vec<TruthRow>) {
        let rows = (0..400).map(|index| {
            let t = f64::from(index) * 0.05;
            let error = Vector3::new(0.3, -0.2, 0.1) * (-0.2 * t).exp();
            let wrong = Pose::new(pose(t).rotation, pose(t).translation + error);
            let with = |pose| PoseWithCovariance::new(pose, isotropic_covariance(0.01, 0.1));
            StateRow {
                stamp_ns: i64::from(index) * 50_000_000,
                local_from_imu: with(wrong),
                global_from_local: (index >= 60).then(|| with(Pose::identity())),
                global_from_imu: (index >= 60).then(|| with(wrong)),
            }
        });
        let rows: Vec<StateRow> = rows.collect();
        let truth: Vec<TruthRow> = (0..2000)
            .map(|index| {
                TruthRow::of_pose(index * 11_000_000 - 7_000_000, pose(index as f64 * 0.011 - 0.007))
            })
            .collect();
        states::write(&folder.join("states.csv"), &rows).unwrap();
        let stamped = |stamp_ns, pose| StampedPose { stamp_ns, pose };
        let global = rows.iter().filter_map(|row| Some(stamped(row.stamp_ns, row.global_from_imu?.pose)));
        tum::write(&folder.join("pose.tum"), &global.collect::<Vec<_>>()).unwrap();
        let local: Vec<_> = rows.iter().map(|row| stamped(row.stamp_ns, row.local_from_imu.pose)).collect();
        tum::write(&folder.join("odometry.tum"), &local).unwrap();
        let reference: Vec<_> = truth.iter().map(|row| stamped(row.stamp_ns, row.pose)).collect();
        tum::write(&folder.join("truth.tum"), &reference).unwrap();
        (rows, truth)
    }

    #[test]
    fn the_figures_of_a_run_are_those_of_its_summary() {
        let folder = tempfile::tempdir().unwrap();
        let (rows, truth) = files(folder.path());
        let summary = score_run(&rows, &truth, -Vector3::z(), &ScoreOptions::default()).unwrap();
        let pose = summary.pose.unwrap();
        let truth = folder.path().join("truth.tum");
        for file in ["states.csv", "pose.tum"] {
            let report = report(&truth, &folder.path().join(file), "");
            assert_eq!(report.pairs, pose.samples);
            assert!((report.ate_m.unwrap().rmse - pose.rmse_m).abs() < 1e-7, "{file}");
            assert!((report.ate_deg.unwrap().rmse - pose.rmse_deg).abs() < 1e-4, "{file}");
            assert!(report.scored.contains("from 5 s") && report.scored.contains("interpolated"));
        }
        let odometry = report(&truth, &folder.path().join("odometry.tum"), "--align yaw");
        assert!((odometry.ate_m.unwrap().rmse - summary.odometry_yaw_aligned_m.rmse).abs() < 1e-7);
        assert!(odometry.scored.starts_with("all poses"));
        // As evo compares: other frames, other partners, other figures.
        let evo = report(&truth, &folder.path().join("pose.tum"), "--skip 0 --max-difference 0.01");
        assert!(evo.pairs == 340 && evo.ate_m.unwrap().rmse > 1.5 * pose.rmse_m);
    }
}
