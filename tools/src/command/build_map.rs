//! `driftless build-map`: builds a map from a recording with reference poses.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::bail;
use indicatif::{ProgressBar, ProgressStyle};
use nalgebra::Vector3;
use onboard::extraction::FeatureArguments;
use sensors::{ReferencePose, Sequence, read_reference_poses};
use serde_json::json;

use super::import_map::parse_direction;
use crate::plotting::draw_coverage;
use map::store::{ensure_free, save_map};
use mapping::{BuildOptions, BuildReport, Extraction, Spread, Stage, StoredPoses, build_map};

/// Arguments.
#[expect(clippy::struct_excessive_bools, reason = "each is a switch of its own")]
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless build-map town/map --map town.db\n  \
    driftless build-map town/map --map start.db --until 10\n  \
    driftless build-map my_run --map my.db --sigma-theta 0.005 --sigma-p 0.02 --gravity 0,0,-1\n  \
    driftless build-map V1_01_easy --map vicon_room.db --sigma-theta 0.0175 --sigma-p 0.01\n\n\
    SEQ holds mav0/cam0 (and cam1, for stereo) with sensor.yaml, data.csv and images in data/, and\n\
    reference_poses.csv. A cam0/features.csv replaces the images. Without reference_poses.csv the ground truth\n\
    gives the poses, and --sigma-theta and --sigma-p must be given. What is stated too small makes the robots\n\
    overconfident: state the sigmas of your poses, not those you wish for.\n\n\
    All sigmas of poses, given and printed, are standard deviations per axis.")]
pub struct Args {
    /// The recording, a folder in the EuRoC layout
    #[arg(value_name = "SEQ")]
    pub sequence: PathBuf,
    /// Database to create
    #[arg(long, value_name = "DB")]
    pub map: PathBuf,
    /// Poses of the IMU in the map's frame [default: SEQ/reference_poses.csv, else the ground truth]
    #[arg(long, value_name = "FILE")]
    pub poses: Option<PathBuf>,
    /// Standard deviation of every pose's rotation about each axis, rad [default: as in the file of poses]
    #[arg(long, value_name = "RAD")]
    pub sigma_theta: Option<f64>,
    /// Standard deviation of every pose's position along each axis, m [default: as in the file of poses]
    #[arg(long, value_name = "M")]
    pub sigma_p: Option<f64>,
    /// Direction in which gravity points in the map's frame, for example 0,0,-1 [default: unknown]
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_direction, allow_hyphen_values = true)]
    pub gravity: Option<Vector3<f64>>,
    /// Standard deviation of a feature's pixel, px [default: measured]
    #[arg(long, value_name = "PX")]
    pub sigma_pixel: Option<f64>,
    /// State the given poses with independent errors, instead of refined ones with their joint covariance
    #[arg(long)]
    pub no_refine_poses: bool,
    /// Use frames from this time on, seconds from the first frame
    #[arg(long, value_name = "SECONDS")]
    pub from: Option<f64>,
    /// Use frames up to this time, seconds from the first frame
    #[arg(long, value_name = "SECONDS")]
    pub until: Option<f64>,
    /// Select a keyframe when the camera has moved this far, m
    #[arg(long, value_name = "M", default_value_t = 0.2)]
    pub min_distance: f64,
    /// ... or has rotated by this angle, deg
    #[arg(long, value_name = "DEG", default_value_t = 5.0)]
    pub min_rotation: f64,
    /// Match each keyframe with this many that follow it in time
    #[arg(long, value_name = "N", default_value_t = 10)]
    pub time_neighbours: usize,
    /// ... and with this many others nearby with a similar viewing direction
    #[arg(long, value_name = "N", default_value_t = 10)]
    pub space_neighbours: usize,
    /// Use camera 0 only, where the recording has images of two
    #[arg(long)]
    pub mono: bool,
    /// How features are extracted from images
    #[command(flatten)]
    pub features: FeatureArguments,
    /// Plot the coverage of the map: keyframes, landmarks, keyframes with too few
    #[arg(long, value_name = "SVG")]
    pub svg: Option<PathBuf>,
    /// Replace an existing map: the new one is its next version, with the same identity
    #[arg(long)]
    pub force: bool,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// A sequence without features or poses, a file that cannot be read (with its line), a database that exists already.
#[expect(clippy::needless_pass_by_value, reason = "every command owns its arguments")]
pub fn run(args: Args) -> anyhow::Result<()> {
    ensure_free(&args.map, args.force)?;
    let sequence = Sequence::open(&args.sequence)?;
    let references = references(&args, &sequence)?;
    let options = options(&args)?;
    let bar = progress_bar(args.json);
    let mut stage_shown = None;
    let mut show = |stage: Stage, done: usize, all: usize| {
        if stage_shown != Some(stage) {
            stage_shown = Some(stage);
            bar.set_message(stage.label());
        }
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    };
    let from_images = sequence.has_images() && !sequence.has_features();
    let mut extractor = if from_images { Some(args.features.open()?) } else { None };
    let mask = args.features.read_mask()?;
    let extraction = extractor.as_mut().map(|extractor| Extraction {
        extractor: extractor.as_mut(),
        max_features: args.features.max_features,
        mask: mask.as_ref(),
        stereo: !args.mono,
    });
    let built = build_map(&sequence, &references, extraction, &options, &mut show);
    bar.finish_and_clear();
    let (contents, report) = built?;
    let saved = save_map(&args.map, &contents, args.force)?;
    if let Some(picture) = &args.svg {
        draw_coverage(&contents, picture)?;
    }
    if args.json {
        println!(
            "{:#}",
            json!({ "map": args.map, "version": saved.version, "identity": saved.identity, "report": report })
        );
    } else {
        println!("{}: version {} of map {}", args.map.display(), saved.version, saved.identity);
        print_report(&report);
    }
    Ok(())
}

fn progress_bar(hidden: bool) -> ProgressBar {
    if hidden {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("{msg:>9} [{wide_bar}] {pos}/{len} {elapsed_precise}") {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

/// The poses to build from: those of `--poses`, of the sequence, or the ground truth.
fn references(args: &Args, sequence: &Sequence) -> anyhow::Result<Vec<ReferencePose>> {
    if let Some(path) = &args.poses {
        return Ok(read_reference_poses(path)?);
    }
    if let Some(poses) = &sequence.reference_poses {
        return Ok(poses.clone());
    }
    let Some(truth) = &sequence.groundtruth else {
        bail!(
            "{} has neither reference_poses.csv nor ground truth: give the poses of the IMU with --poses FILE",
            args.sequence.display()
        );
    };
    let (Some(sigma_theta), Some(sigma_p)) = (args.sigma_theta, args.sigma_p) else {
        bail!(
            "{} has no reference_poses.csv; to build from its ground truth, state its standard deviations with --sigma-theta \
             RAD and --sigma-p M",
            args.sequence.display()
        );
    };
    let reference = |row: &sensors::TruthRow| ReferencePose {
        stamp_ns: row.stamp_ns,
        pose: row.pose,
        sigma_theta_rad: sigma_theta,
        sigma_p_m: sigma_p,
    };
    Ok(truth.iter().map(reference).collect())
}

fn options(args: &Args) -> anyhow::Result<BuildOptions> {
    let [from_s, until_s] = [args.from.unwrap_or(0.0), args.until.unwrap_or(f64::INFINITY)];
    if until_s.is_nan() || from_s.is_nan() || until_s < from_s {
        bail!("--until {until_s} comes before --from {from_s}");
    }
    let name = args.map.file_stem().unwrap_or(args.map.as_os_str()).to_string_lossy().into_owned();
    let mut options = BuildOptions::default();
    options.name = name;
    options.created_by = format!("driftless build-map {}", args.sequence.display());
    options.gravity_in_global = args.gravity;
    options.from_s = from_s;
    options.until_s = until_s;
    options.sigma_theta_rad = args.sigma_theta;
    options.sigma_p_m = args.sigma_p;
    options.sigma_px = args.sigma_pixel;
    options.stored_poses = if args.no_refine_poses { StoredPoses::Given } else { StoredPoses::Refined };
    options.min_distance = args.min_distance;
    options.min_rotation = args.min_rotation.to_radians();
    options.time_neighbours = args.time_neighbours;
    options.space_neighbours = args.space_neighbours;
    Ok(options)
}

fn print_report(report: &BuildReport) {
    let spread = |spread: &Spread, digits: usize| {
        let Spread { mean, median, p95 } = spread;
        format!("mean {mean:.digits$}, median {median:.digits$}, 95 % below {p95:.digits$}")
    };
    let mean_length = report.observations as f64 / report.landmarks.max(1) as f64;
    println!("keyframes                   {}", report.keyframes);
    println!("landmarks                   {}", report.landmarks);
    println!("observations                {} ({mean_length:.1} a landmark)", report.observations);
    println!("  landmarks with 1, 2, ...  {}", histogram(&report.track_lengths));
    println!("landmarks a keyframe        {}", spread(&report.landmarks_per_keyframe, 0));
    if report.stereo_features > 0 {
        println!("features seen in stereo     {}", report.stereo_features);
    }
    for image in &report.unreadable_images {
        println!("left out                    {image}");
    }
    println!("pairs matched               {} with {} matches", report.pairs, report.matches);
    println!("observations dropped        {}", report.dropped_observations);
    println!("reprojection error, px      {}", spread(&report.reprojection_px, 2));
    println!("  through the given poses   {}", spread(&report.reprojection_through_given_px, 2));
    println!("pixel sigma, px             {:.2}", report.sigma_px);
    println!("poses corrected by, deg     {}", spread(&report.pose_correction_deg, 2));
    println!("                    m       {}", spread(&report.pose_correction_m, 3));
    println!("sigma of poses per axis, deg {}", spread(&report.sigma_pose_deg, 3));
    println!("                         m   {}", spread(&report.sigma_pose_m, 3));
    println!("correlated pairs            {}", report.cross_covariances);
    let few = BuildReport::FEW_LANDMARKS;
    println!("keyframes below {few} landmarks {}", report.poor_keyframes.len());
    if !report.poor_keyframes.is_empty() {
        let shown: Vec<String> = report.poor_keyframes.iter().take(20).map(ToString::to_string).collect();
        let more = if report.poor_keyframes.len() > 20 { ", ..." } else { "" };
        println!("  ids                       {}{more}", shown.join(", "));
    }
    println!("time                        {:.1} s", report.seconds);
}

/// The first counts, and the sum of the rest.
fn histogram(counts: &[usize]) -> String {
    const SHOWN: usize = 9;
    let mut text: Vec<String> = counts.iter().take(SHOWN).map(ToString::to_string).collect();
    if counts.len() > SHOWN {
        text.push(format!("and more: {}", counts[SHOWN..].iter().sum::<usize>()));
    }
    text.join(", ")
}
