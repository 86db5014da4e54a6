//! `driftless evaluate`: accuracy (ATE, RPE) and consistency (NEES) of an estimated trajectory.

mod report;
#[cfg(test)]
mod tests;

use anyhow::{Context, ensure};
use evaluation::trajectory::{PoseFormat, StateKind, TrajectoryFile, read_any_with};
use evaluation::{
    Alignment, Delta, MAX_TRUTH_GAP_NS, NeesSum, Pair, ScoreOptions, absolute_errors, align, alignment_scale,
    associate, interpolate_reference, nees, nees_bounds, relative_errors,
};
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::Vector3;
use std::path::{Path, PathBuf};

use super::pose_files::QuaternionArgument;
use report::{NeesReport, Report, print};

/// Confidence of the bounds printed beside the NEES.
const CONFIDENCE: f64 = 0.95;
/// Why an aligned estimate has no NEES.
const NO_NEES_ALIGNED: &str = "the alignment removes a part of the errors that the covariances include: use --align none, with poses in \
                               the frame of the ground truth";

/// How the estimate is aligned with the ground truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum AlignArgument {
    /// Not aligned: both are in the same frame
    None,
    /// Rotation about gravity, and translation
    Yaw,
    /// Rotation and translation (Umeyama, without scale)
    Se3,
    /// Rotation, translation and scale, for an estimate of one camera without an IMU
    Sim3,
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
    after_help = "Files: TUM trajectories, EuRoC ground truth (data.csv), states.csv of a run, tables of other programs (OKVIS2, OpenVINS,\n\
    Basalt, Kimera, VINS, ORB-SLAM3), recognized by header and form, or two files of KITTI (12 columns, paired by row).\n\n\
    For a run the figures are those of its own summary: the truth is interpolated (gaps up to 0.25 s), the pose in the\n\
    map is not aligned and counts from 5 s after the map initialization on, odometry counts from its first pose on.\n\
    `--skip 0 --max-difference 0.01` compares as evo does.\n\n\
    Examples:\n  \
    driftless evaluate --groundtruth REC/mav0/state_groundtruth_estimate0/data.csv --estimate out/pose.tum\n  \
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
    pub(super) align: AlignArgument,
    /// Order of the quaternions in a file whose header does not name its columns
    #[arg(long, value_name = "ORDER", value_enum)]
    quaternion: Option<QuaternionArgument>,
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
    pub(super) delta: f64,
    /// Unit of --delta
    #[arg(long, value_enum, default_value = "frames")]
    pub(super) delta_unit: UnitArgument,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
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
    let read = |path: &Path, state| read_any_with(path, &[state], args.quaternion.map(Into::into));
    let truth =
        read(&args.groundtruth, StateKind::GlobalFromImu).context("the ground truth cannot be read")?;
    let estimate = read(&args.estimate, args.state.into()).context("the estimate cannot be read")?;
    let (truth, mut estimate, pairs, scored) = paired(args, truth, estimate)?;
    let is_aligned = args.align != AlignArgument::None;
    let no_nees = (is_aligned && estimate.covariances.is_some()).then_some(NO_NEES_ALIGNED);
    let scale = match args.align {
        AlignArgument::Sim3 => Some(rescale(&truth, &mut estimate, &pairs)?),
        _ => None,
    };
    let positions = positions(&truth, &estimate, &pairs);
    let alignment = match args.align {
        AlignArgument::None => Alignment::None,
        AlignArgument::Se3 | AlignArgument::Sim3 => Alignment::Se3,
        AlignArgument::Yaw => Alignment::Yaw {
            gravity_in_reference: direction(&args.gravity, "--gravity")?,
            gravity_in_estimate: direction(&args.estimate_gravity, "--estimate-gravity")?,
        },
    };
    let aligned = align(&positions, &alignment).context("the trajectories cannot be compared")?;
    let absolute = absolute_errors(&truth.poses, &estimate.poses, &pairs, &aligned);
    let relative = relative_errors(&truth.poses, &estimate.poses, &pairs, delta(args)?);
    let (nees, nees_left_out) = if is_aligned { (None, 0) } else { consistency(&truth, &estimate, &pairs) };
    Ok(Report {
        pairs: pairs.len(),
        scored,
        scale,
        ate_m: absolute.translation(),
        ate_deg: absolute.rotation(),
        rpe_m: relative.translation(),
        rpe_deg: relative.rotation(),
        nees,
        no_nees,
        nees_left_out,
    })
}

/// Positions of the pairs in both trajectories.
fn positions(
    truth: &TrajectoryFile,
    estimate: &TrajectoryFile,
    pairs: &[Pair],
) -> Vec<(Vector3<f64>, Vector3<f64>)> {
    let of = |pair: &Pair| {
        (truth.poses[pair.reference].pose.translation, estimate.poses[pair.estimate].pose.translation)
    };
    pairs.iter().map(of).collect()
}

/// Scales the estimate's positions so that they fit the truth best.
fn rescale(truth: &TrajectoryFile, estimate: &mut TrajectoryFile, pairs: &[Pair]) -> anyhow::Result<f64> {
    let scale = alignment_scale(&positions(truth, estimate, pairs))
        .context("the trajectories cannot be aligned in scale")?;
    estimate.poses.iter_mut().for_each(|row| row.pose.translation *= scale);
    Ok(scale)
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
    if [truth.format, estimate.format].contains(&PoseFormat::Kitti) {
        let pairs = paired_by_row(&truth, &estimate)?;
        return Ok((truth, estimate, pairs, "all poses, truth of the same row".to_owned()));
    }
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

/// Pairs of two files without times.
fn paired_by_row(truth: &TrajectoryFile, estimate: &TrajectoryFile) -> anyhow::Result<Vec<Pair>> {
    ensure!(
        truth.format == estimate.format,
        "KITTI's poses have no times, and the other file is {}: give both in KITTI's layout (12 columns), row by row, or both \
         with times (`evo_traj kitti` writes TUM files)",
        if truth.format == PoseFormat::Kitti { estimate.format } else { truth.format }
    );
    ensure!(
        truth.poses.len() == estimate.poses.len(),
        "KITTI's poses are paired by row, but the ground truth has {} rows and the estimate {}",
        truth.poses.len(),
        estimate.poses.len()
    );
    Ok((0..truth.poses.len()).map(|row| Pair { reference: row, estimate: row }).collect())
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

/// NEES, where the estimate has covariances, of poses in the frame of the truth.
///
/// # Returns
/// The NEES, and of how many poses the covariance is not positive definite, which are left out of it.
fn consistency(
    truth: &TrajectoryFile,
    estimate: &TrajectoryFile,
    pairs: &[Pair],
) -> (Option<NeesReport>, usize) {
    let Some(covariances) = &estimate.covariances else { return (None, 0) };
    let mut sum = NeesSum::default();
    for pair in pairs {
        let pose = estimate.poses[pair.estimate].pose;
        let state = PoseWithCovariance::new(pose, covariances[pair.estimate]);
        if let Some(nees) = nees(&state, &truth.poses[pair.reference].pose) {
            sum.push(&nees);
        }
    }
    let samples = sum.samples();
    let report = sum.mean().map(|mean| NeesReport {
        mean,
        samples,
        bounds_3: nees_bounds(3, 1, CONFIDENCE),
        bounds_6: nees_bounds(6, 1, CONFIDENCE),
    });
    (report, pairs.len() - samples)
}
