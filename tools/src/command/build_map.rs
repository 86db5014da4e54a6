//! `driftless build-map`: builds a map from a recording, with reference poses or without.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::bail;
use clap::Parser as _;
use nalgebra::Vector3;
use onboard::arguments::{CalibrationArguments, FeatureArguments};
use sensors::{ReferencePose, Sequence, check_stereo};
use serde_json::json;
use vision::{FeatureExtractor, GrayImage};

use super::build_report::{print_extension, print_kept, print_partial_kinds, print_report};
use super::import_map::parse_direction;
use super::pose_files::PriorArguments;
use crate::plotting::draw_coverage;
use crate::session_files;
use crate::stage_bar::StageBar;
use map::contents::MapContents;
use map::store::{MapTarget, load_map};
use mapping::{
    BuildOptions, BuildReport, ExtendError, ExtensionReport, Extraction, KeptImages, Odometry, Progress,
    Stage, StoredPoses, build_map, build_map_from_odometry, check_new_recording, extend_map, keep_images,
    register_stereo_images, select_during,
};
use mapping::{is_sparse, odometry_config, run_odometry, run_watched};

/// Largest plausible `--sigma-theta`, rad: 29 degrees. With more the pose says nothing, and linearization fails.
const MAX_SIGMA_THETA: f64 = 0.5;

/// Images that are too far apart to track points are all keyframes, unless the camera stands still, m.
const MIN_DISTANCE_OF_SPARSE_IMAGES: f64 = 0.01;

/// Quality of kept images where none is given.
const DEFAULT_QUALITY: &str = "90";

/// Arguments.
#[expect(clippy::struct_excessive_bools, reason = "each is a switch of its own")]
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless build-map my_run --map my.db --svg my.svg\n  \
    driftless build-map town/map --map town.db --gravity 0,0,-1\n  \
    driftless build-map town/map --map start.db --until 10\n  \
    driftless build-map my_run --map my.db --sigma-theta 0.005 --sigma-p 0.02 --gravity 0,0,-1\n  \
    driftless build-map my_run --map my.db --poses odometry.tum --sigma-theta 0.02 --sigma-p 0.1\n  \
    driftless build-map my_run --map my.db --poses out/states.csv\n  \
    driftless build-map my_run --map my.db --position-priors gnss_enu.csv --lever-arm 0.1,0,0.4\n  \
    driftless build-map another_run --map my.db --extend\n  \
    driftless build-map my_run --map my.db --keep-images\n  \
    driftless build-map inbox/robot7/1a2b.session --map my.db --extend\n  \
    driftless build-map V1_01_easy --map vicon_room.db --sigma-theta 0.0175 --sigma-p 0.01\n\n\
    REC holds mav0/cam0, and cam1, cam2 ... of a rig, with sensor.yaml, data.csv and images in data/, and mav0/imu0. A\n\
    cam0/features.csv replaces the images. Odometry, places seen again and one visual-inertial adjustment give the poses.\n\n\
    Where poses are known, REC/reference_poses.csv or --poses gives them, or the ground truth with --sigma-theta and\n\
    --sigma-p, and the map is built in their frame. What is stated too small makes the robots overconfident: state the\n\
    sigmas of your poses, not those you wish for.\n\n\
    --poses takes reference_poses.csv, states.csv of a run, a TUM file (t x y z qx qy qz qw), EuRoC ground truth, or a\n\
    table of another program (OKVIS2, OpenVINS, Basalt, Kimera, VINS, ORB-SLAM3): by its header where it names the\n\
    columns, else by its form; where neither tells the order of the quaternion, --quaternion does. The first two\n\
    state their uncertainty; the others need --sigma-theta and --sigma-p. All sigmas of poses, given and printed, are\n\
    standard deviations per axis.\n\n\
    --position-priors and --pose-priors are poses at some times only, of a total station, GNSS, surveyed marks or tags. The\n\
    map is built from odometry, in their frame, whose z axis must point up. Positions are lines `ns,x,y,z`, as EuRoC's\n\
    leica0/data.csv, or `ns,x,y,z,sigma_x,sigma_y,sigma_z` in metres; wrong ones are refused.")]
pub struct Args {
    /// The recording: a folder in the EuRoC layout, a bag (MCAP, rosbag2, rosbag1), or a session that a robot handed in
    #[arg(value_name = "REC")]
    pub recording: PathBuf,
    /// Calibration
    #[command(flatten)]
    pub calibration: CalibrationArguments,
    /// Database to create, or with --extend the one to extend
    #[arg(long, value_name = "DB")]
    pub map: PathBuf,
    /// Poses of the IMU in the map's frame, in any of the formats below; `none` builds from odometry and loops
    /// [default: REC/reference_poses.csv, if there is one, else none]
    #[arg(long, value_name = "FILE|none")]
    pub poses: Option<PathBuf>,
    /// Known poses and positions
    #[command(flatten)]
    pub priors: PriorArguments,
    /// Standard deviation of every pose's rotation about each axis, rad [default: as in the file of poses]
    #[arg(long, value_name = "RAD")]
    pub sigma_theta: Option<f64>,
    /// Standard deviation of every pose's position along each axis, m [default: as in the file of poses]
    #[arg(long, value_name = "M")]
    pub sigma_p: Option<f64>,
    /// Direction in which gravity points in the map's frame, for example 0,0,-1 [default: by the recording's IMU]
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
    /// Select a keyframe when the camera has moved this far, m [default: 0.2; without poses, all images that are too far
    /// apart to track points]
    #[arg(long, value_name = "M")]
    pub min_distance: Option<f64>,
    /// ... or has rotated by this angle, deg [default: 5]
    #[arg(long, value_name = "DEG")]
    pub min_rotation: Option<f64>,
    /// Match each keyframe with this many that follow it in time
    #[arg(long, value_name = "N", default_value_t = 10)]
    pub time_neighbours: usize,
    /// ... and with this many others nearby with a similar viewing direction
    #[arg(long, value_name = "N", default_value_t = 10)]
    pub space_neighbours: usize,
    /// Use camera 0 only, where the recording has images of several: otherwise each stereo pair or single camera has keyframes of its
    /// own
    #[arg(long)]
    pub mono: bool,
    /// How features are extracted from images
    #[command(flatten)]
    pub features: FeatureArguments,
    /// Keep the images of the keyframes in the map, as JPEG of this quality, 1 to 100: `add-features` computes further kinds of features
    /// in them. With --extend, a map that keeps images goes on to keep them
    #[arg(long, value_name = "QUALITY", num_args = 0..=1, require_equals = true, default_missing_value = DEFAULT_QUALITY,
        value_parser = clap::value_parser!(u8).range(1..=100))]
    pub keep_images: Option<u8>,
    /// Plot the coverage of the map: keyframes, landmarks, keyframes with too few
    #[arg(long, value_name = "SVG")]
    pub svg: Option<PathBuf>,
    /// Replace an existing map: the new one is its next version, with the same identity
    #[arg(long)]
    pub force: bool,
    /// Extend the existing map by this recording of the same place; the result is its next version
    #[arg(long, conflicts_with_all = ["force", "poses", "position_priors", "pose_priors", "sigma_theta", "sigma_p", "gravity", "no_refine_poses"])]
    pub extend: bool,
    /// Name of the robot that made the recording, for the ledger of the map's sessions
    #[arg(long, value_name = "NAME")]
    pub robot: Option<String>,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

impl Args {
    /// Those of `driftless build-map REC --map DB --poses none`.
    ///
    /// # Errors
    /// None, as long as the switches are as they are spelled here.
    pub(crate) fn without_poses(
        recording: &Path,
        map: &Path,
        calibration: &CalibrationArguments,
        features: &FeatureArguments,
    ) -> anyhow::Result<Self> {
        let line = ["build-map".as_ref(), recording.as_os_str(), "--map".as_ref(), map.as_os_str()];
        let line = line.into_iter().chain(["--poses".as_ref(), "none".as_ref()]);
        let args = CommandLine::try_parse_from(line)?.args;
        Ok(Self { calibration: calibration.clone(), features: features.clone(), ..args })
    }
}

/// The arguments by themselves.
#[derive(clap::Parser)]
struct CommandLine {
    #[command(flatten)]
    args: Args,
}

/// Runs the command.
///
/// # Errors
/// A sequence without features or poses, a file that cannot be read (with its line), a database that exists already.
#[expect(clippy::needless_pass_by_value, reason = "every command owns its arguments")]
pub fn run(args: Args) -> anyhow::Result<()> {
    let target = MapTarget::new(&args.map, args.force || args.extend)?;
    let stored = if args.extend { Some(load_map(&args.map)?.contents) } else { None };
    let mut bar = StageBar::new(args.json);
    let (contents, report) =
        build(&args, stored.as_ref(), &mut |stage, done, all| bar.show(stage, done, all))?;
    let times = bar.finish();
    let saved = target.save(&contents)?;
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
        match &report.report {
            Report::Built(report) => print_report(report),
            Report::Extended(report) => print_extension(report),
        }
        if let Some(kept) = &report.kept {
            print_kept(kept);
        }
        print_partial_kinds(&contents);
        println!("  of it                     {times}");
    }
    Ok(())
}

/// The map that the arguments ask for.
///
/// # Arguments
/// * `stored`: the map that is extended, if one is.
///
/// # Errors
/// As of [`run`], but for the database.
pub(crate) fn build(
    args: &Args,
    stored: Option<&MapContents>,
    show: Progress<'_>,
) -> anyhow::Result<(MapContents, Built)> {
    let mut sequence = Sequence::open_with(&args.recording, &args.calibration.files())?;
    if !args.mono {
        check_stereo(&sequence.cameras, || Ok(sequence.frames.iter().cloned().map(Ok)))?;
    }
    let mut options = options(args)?;
    if let Some((robot, recorded)) = session_files::of_recording(&args.recording)? {
        if args.from.is_some() || args.until.is_some() {
            bail!(
                "--from and --until are for recordings; a session is used as a whole, and entered into the ledger as a whole"
            );
        }
        options.robot.get_or_insert(robot);
        options.recorded = Some(recorded);
    }
    if let Some(stored) = stored {
        // Odometry would take minutes to get to the same.
        check_new_recording(&stored.info, &sequence, &options).map_err(ExtendError::from)?;
    }
    let references = if args.extend { None } else { references(args, &sequence)? };
    if references.is_none() {
        check_unused(args)?;
    }
    let priors = args.priors.read(args.sigma_theta, args.sigma_p)?;
    let start = Instant::now();
    let cameras = if args.mono { 1 } else { sequence.cameras.len() };
    let from_images = sequence.has_images() && !sequence.has_features();
    if !from_images {
        check_images_wanted(args)?;
    }
    let features = args.features.or_of_map(stored.map_or("", |map| &map.info.extractor));
    let mut extractors = if from_images { features.open_several()? } else { Vec::new() };
    let masks = args.features.read_masks()?;
    let (mut contents, mut report) = if let Some(references) = references {
        let extraction = extraction_of(&mut extractors, &masks, cameras, args);
        let (contents, report) = build_map(&sequence, &references, extraction, &options, show)?;
        (contents, Report::Built(Box::new(report)))
    } else {
        let extraction = extraction_of(&mut extractors, &masks, cameras, args);
        let odometry = odometry(&mut sequence, extraction, args, &mut options, show)?;
        let extraction = extraction_of(&mut extractors, &masks, cameras, args);
        if let Some(stored) = stored {
            let (contents, report) = extend_map(stored, &sequence, &odometry, extraction, &options, show)?;
            (contents, Report::Extended(Box::new(report)))
        } else {
            let (contents, report) =
                build_map_from_odometry(&sequence, &odometry, &priors, extraction, &options, show)?;
            (contents, Report::Built(Box::new(report)))
        }
    };
    let kept = match quality(args, stored, &sequence)? {
        Some(quality) => Some(keep_images(&mut contents, stored, &sequence, cameras, quality)?),
        None => None,
    };
    report.set_seconds(start.elapsed().as_secs_f64());
    Ok((contents, Built { report, kept }))
}

/// The quality of the images that are kept; `None` where none are.
fn quality(args: &Args, stored: Option<&MapContents>, sequence: &Sequence) -> anyhow::Result<Option<u8>> {
    let goes_on = stored.is_some_and(|stored| !stored.images.is_empty()) && sequence.has_images();
    let default = if goes_on { Some(DEFAULT_QUALITY.parse()?) } else { None };
    Ok(args.keep_images.or(default))
}

/// What is said of a map that was built.
#[derive(serde::Serialize)]
pub(crate) struct Built {
    #[serde(flatten)]
    pub(crate) report: Report,
    /// The images that were kept.
    #[serde(rename = "kept_images", skip_serializing_if = "Option::is_none")]
    kept: Option<KeptImages>,
}

/// Statistics of the map.
#[derive(serde::Serialize)]
#[serde(untagged)]
pub(crate) enum Report {
    Built(Box<BuildReport>),
    Extended(Box<ExtensionReport>),
}

impl Report {
    /// Sets how long all of it took, with the odometry that came before the map.
    fn set_seconds(&mut self, seconds: f64) {
        match self {
            Report::Built(report) => report.seconds = seconds,
            Report::Extended(report) => report.seconds = seconds,
        }
    }
}

/// The trajectory of a recording without reference poses.
fn odometry(
    sequence: &mut Sequence,
    extraction: Option<Extraction<'_>>,
    args: &Args,
    options: &mut BuildOptions,
    show: Progress<'_>,
) -> anyhow::Result<Odometry> {
    let cameras = if args.mono { 1 } else { sequence.cameras.len() };
    let Some(extraction) = extraction else {
        return Ok(run_odometry(sequence, cameras, |done, all| show(Stage::Odometry, done, all))?);
    };
    if cameras > 1 && is_sparse(sequence) {
        let config = odometry_config(sequence)?;
        options.min_distance = args.min_distance.unwrap_or(MIN_DISTANCE_OF_SPARSE_IMAGES);
        return Ok(register_stereo_images(sequence, extraction, &config, show)?);
    }
    let sensors = sequence.cameras.clone();
    let first_ns = sequence.frames.first().map_or(0, |frame| frame.stamp_ns);
    let (odometry, keyframes) =
        select_during(&sensors, first_ns, extraction, options, show, |located, show| {
            run_watched(sequence, cameras, |done, all| show(Stage::Odometry, done, all), located)
        });
    let odometry = odometry?;
    Ok(Odometry { keyframes: Some(Arc::new(keyframes?)), ..odometry })
}

/// What the switches say of extraction; `None` for a recording that has features.
fn extraction_of<'a>(
    extractors: &'a mut [Box<dyn FeatureExtractor>],
    masks: &'a [Option<GrayImage>],
    cameras: usize,
    args: &Args,
) -> Option<Extraction<'a>> {
    let (extractor, others) = extractors.split_first_mut()?;
    let extractor = extractor.as_mut();
    Some(Extraction { extractor, others, max_features: args.features.max_features, masks, cameras })
}

/// The poses to build from: those of `--poses`, of the sequence, or the ground truth where its standard deviations are
/// given; `None` to build without.
fn references(args: &Args, sequence: &Sequence) -> anyhow::Result<Option<Vec<ReferencePose>>> {
    if args.poses.as_deref() == Some(Path::new("none")) || args.priors.are_given() {
        return Ok(None);
    }
    if let Some(path) = &args.poses {
        return args.priors.poses_of_file(path, args.sigma_theta, args.sigma_p).map(Some);
    }
    if let Some(poses) = &sequence.reference_poses {
        return Ok(Some(poses.clone()));
    }
    match (&sequence.groundtruth, args.sigma_theta, args.sigma_p) {
        (_, None, None) => Ok(None),
        (Some(truth), Some(sigma_theta), Some(sigma_p)) => {
            let reference = |row: &sensors::TruthRow| {
                ReferencePose::isotropic(row.stamp_ns, row.pose, sigma_theta, sigma_p)
            };
            Ok(Some(truth.iter().map(reference).collect()))
        }
        (Some(_), ..) => bail!(
            "{} has no reference_poses.csv; to build from its ground truth, state both its standard deviations, with \
             --sigma-theta RAD and --sigma-p M; without either the map is built from odometry",
            args.recording.display()
        ),
        (None, ..) => bail!(
            "--sigma-theta and --sigma-p are the uncertainty of poses, and {} has none: give them with --poses FILE, or leave \
             the switches out to build from odometry",
            args.recording.display()
        ),
    }
}

/// Refuses switches about given poses where the map is built from odometry.
fn check_unused(args: &Args) -> anyhow::Result<()> {
    let priors = &args.priors;
    let has_poses = priors.pose_priors.is_some();
    let unused = [
        ("--gravity", args.gravity.is_some_and(|down| down.dot(&-Vector3::z()) < 0.9999)),
        ("--no-refine-poses", args.no_refine_poses),
        ("--sigma-theta", args.sigma_theta.is_some() && !has_poses),
        ("--sigma-p", args.sigma_p.is_some() && !priors.are_given()),
        ("--quaternion", priors.quaternion.is_some() && !has_poses),
    ];
    let unused: Vec<&str> = unused.iter().filter(|(_, is_given)| *is_given).map(|(name, _)| *name).collect();
    if !unused.is_empty() {
        bail!(
            "{}: the map is built from odometry, and its z axis points up; give the poses that this is about, with --poses FILE or \
             --pose-priors FILE, or leave it out",
            unused.join(", ")
        );
    }
    Ok(())
}

/// Refuses switches about images where none are looked at.
fn check_images_wanted(args: &Args) -> anyhow::Result<()> {
    let given = args.features.given();
    if !given.is_empty() {
        bail!(
            "{}: this is about features of images, and those of {} were extracted before, or it has no images: leave \
             it out",
            given.join(", "),
            args.recording.display()
        );
    }
    Ok(())
}

fn options(args: &Args) -> anyhow::Result<BuildOptions> {
    check_sigma_theta(args.sigma_theta)?;
    let [from_s, until_s] = [args.from.unwrap_or(0.0), args.until.unwrap_or(f64::INFINITY)];
    if until_s.is_nan() || from_s.is_nan() || until_s < from_s {
        bail!("--until {until_s} comes before --from {from_s}");
    }
    let name = args.map.file_stem().unwrap_or(args.map.as_os_str()).to_string_lossy().into_owned();
    let mut options = BuildOptions::default();
    options.name = name;
    options.created_by = format!("driftless build-map {}", args.recording.display());
    options.robot.clone_from(&args.robot);
    options.gravity_in_global = args.gravity;
    options.from_s = from_s;
    options.until_s = until_s;
    options.sigma_theta_rad = args.sigma_theta;
    options.sigma_p_m = args.sigma_p;
    options.sigma_px = args.sigma_pixel;
    options.stored_poses = if args.no_refine_poses { StoredPoses::Given } else { StoredPoses::Refined };
    options.min_distance = args.min_distance.unwrap_or(options.min_distance);
    options.min_rotation = args.min_rotation.map_or(options.min_rotation, f64::to_radians);
    options.time_neighbours = args.time_neighbours;
    options.space_neighbours = args.space_neighbours;
    Ok(options)
}

/// Refuses degrees given for radians.
fn check_sigma_theta(sigma_theta: Option<f64>) -> anyhow::Result<()> {
    if let Some(sigma) = sigma_theta.filter(|sigma| *sigma > MAX_SIGMA_THETA) {
        bail!(
            "--sigma-theta {sigma} is more than {MAX_SIGMA_THETA}: it is in radians; {sigma} degrees are {:.3}",
            sigma.to_radians()
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(switches: &str) -> Args {
        let line = ["build-map", "REC", "--map", "m.db"].into_iter().chain(switches.split_whitespace());
        CommandLine::try_parse_from(line).unwrap().args
    }

    #[test]
    fn degrees_for_radians_are_refused() {
        let error = options(&args("--sigma-theta 5")).unwrap_err().to_string();
        assert!(error.contains("radians") && error.contains("5 degrees are 0.087"), "{error}");
        assert!(options(&args("--sigma-theta 0.087")).is_ok());
    }

    #[test]
    fn switches_about_images_are_refused_where_none_are_looked_at() {
        check_images_wanted(&args("--min-distance 0.3")).unwrap();
        let error = check_images_wanted(&args("--mask hood.png --max-features 500")).unwrap_err().to_string();
        assert!(error.starts_with("--max-features, --mask: ") && error.contains("of REC"), "{error}");
    }

    #[test]
    fn switches_about_poses_are_refused_without_poses() {
        for (switches, unused) in [
            ("--gravity 0,0,-1", None),
            ("--gravity 0,1,0", Some("--gravity:")),
            ("--sigma-theta 0.1 --sigma-p 0.1", Some("--sigma-theta, --sigma-p:")),
            ("--position-priors p.csv --sigma-p 0.1", None),
            ("--position-priors p.csv --quaternion xyzw", Some("--quaternion:")),
            ("--pose-priors p.tum --sigma-theta 0.1 --sigma-p 0.1 --quaternion xyzw", None),
            ("--pose-priors p.tum --no-refine-poses", Some("--no-refine-poses:")),
        ] {
            let found = check_unused(&args(switches)).err().map(|error| error.to_string());
            match unused {
                Some(name) => assert!(found.as_ref().is_some_and(|text| text.starts_with(name)), "{found:?}"),
                None => assert_eq!(found, None, "{switches}"),
            }
        }
    }
}
