//! `driftless inspect`: the matches of an image with a map, as a plot and as numbers.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use onboard::arguments::{CalibrationArguments, FeatureArguments};
use protocol::{Format, KeyframeId};
use recognition::{InspectedKeyframe, InspectedMatch, Inspection, RecognitionOptions};
use sensors::{CalibrationFiles, Sequence, is_recording};
use serde_json::{Value, json};
use vision::GrayImage;

use super::localize::NOT_RECOGNIZED;
use crate::in_process::load_map;
use crate::plotting::{MatchPicture, describe_verdict, draw_matches};
use crate::query_image::{QueryImage, read_image};
use crate::server_query::{describe, print_fix};

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless inspect query.png --camera V1_01_easy/mav0/cam0/sensor.yaml --map room.db --recording V1_01_easy\n  \
    driftless inspect town/live --at 12.5 --map town.db --out match.svg\n  \
    driftless inspect query.png --camera sensor.yaml --map room.db --keyframe 17 --json\n\n\
    The plot shows the query beside the keyframe that matched best, with a line for each match: green for inliers, red\n\
    for outliers, orange where no camera pose fits. In a browser, the pointer over a match shows its descriptor distance\n\
    and its reprojection error. A map holds no images; --recording names the recording that it was built from. Without\n\
    it the keyframe's landmarks are drawn on grey.\n\n\
    How to read it:\n  \
    few matches            another place, light or viewpoint than in the map; other settings of the extractor\n  \
    many, no inliers       repeated texture; a wrong --camera\n  \
    inliers in a corner    too little of the image is in the map for a certain pose\n  \
    errors near the gate   a wrong --camera, or inaccurate landmarks in the map\n\n\
    Exit code 0: recognized. 2: the map was searched and the image was not recognized. 1: anything else.")]
pub struct Args {
    /// An image, PNG or JPEG, or a recording: a folder in the EuRoC layout or a bag
    #[arg(value_name = "IMAGE|REC")]
    pub query: PathBuf,
    /// Database of the map, or its releases: a folder or URL, with @7 for release 7, or @candidate
    #[arg(long, value_name = "DB|URL")]
    pub map: PathBuf,
    /// The camera that took IMAGE: its sensor.yaml, or a camera chain of Kalibr (cam0)
    #[arg(long, value_name = "YAML")]
    pub camera: Option<PathBuf>,
    /// Calibration of REC
    #[command(flatten)]
    pub calibration: CalibrationArguments,
    /// Time in REC, seconds from the first frame; its features.csv is used where it has one, else its image
    #[arg(long, value_name = "SECONDS")]
    pub at: Option<f64>,
    /// The recording that the map was built from, for the keyframe's image
    #[arg(long, value_name = "MAP_REC")]
    pub recording: Option<PathBuf>,
    /// Draw this keyframe instead of the best one
    #[arg(long, value_name = "ID")]
    pub keyframe: Option<KeyframeId>,
    /// The plot
    #[arg(long, value_name = "SVG", default_value = "inspection.svg")]
    pub out: PathBuf,
    /// How features are extracted
    #[command(flatten)]
    pub features: FeatureArguments,
    /// Print the summary as JSON, with every match of the picture
    #[arg(long)]
    pub json: bool,
}

/// An inspected query, and its plot.
#[derive(Clone, Debug)]
pub struct Report {
    /// Name of the query.
    pub query: String,
    /// Number of its features.
    pub features: usize,
    /// Name of the map.
    pub map: String,
    /// The answer and its candidates.
    pub inspection: Inspection,
    /// The keyframe in the picture; `None` where there was nothing to compare.
    pub shown: Option<InspectedKeyframe>,
    /// The picture.
    pub picture: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// See [`inspect`].
pub fn run(args: &Args) -> Result<()> {
    let report = inspect(args)?;
    if args.json {
        println!("{:#}", as_json(&report)?);
    } else {
        print(&report);
    }
    if report.inspection.reply.fix.is_none() {
        std::process::exit(NOT_RECOGNIZED);
    }
    Ok(())
}

/// Inspects a query and draws the picture.
///
/// # Errors
/// A query, a camera, weights, a map or a recording that cannot be read; an image of another size than its camera's; a
/// keyframe that the map does not have; a recording that is not the map's; features of another extractor than the
/// map's; a picture that cannot be written.
pub fn inspect(args: &Args) -> Result<Report> {
    let map = load_map(&args.map)?;
    let query = read_query(args, &args.features.or_of_map(&map.info().extractor))?;
    let (request, options) = (query.request(), RecognitionOptions::default());
    let inspection = map.inspect(&request, &options)?;
    let candidates = &inspection.keyframes;
    let shown = match args.keyframe {
        Some(id) => match candidates.iter().find(|keyframe| keyframe.id == id) {
            Some(candidate) => Some(candidate.clone()),
            None => Some(map.inspect_keyframe(&request, id, &options)?.with_context(|| {
                format!("--keyframe {id}: the map {} has no such keyframe", args.map.display())
            })?),
        },
        None => candidates.first().cloned(),
    };
    let keyframe_image = match (&args.recording, &shown) {
        (Some(sequence), Some(keyframe)) => keyframe_image(sequence, &args.calibration.files(), keyframe)?,
        _ => None,
    };
    let map_name = args.map.display().to_string();
    let picture = MatchPicture {
        query: &query.name,
        camera: &query.camera,
        image: query.image.as_ref(),
        features: &query.features.pixels,
        map: &map_name,
        inspection: &inspection,
        keyframe: shown.as_ref(),
        keyframe_image: keyframe_image.as_ref(),
    };
    let picture = draw_matches(&picture, &args.out)?;
    let features = query.features.len();
    Ok(Report { query: query.name, features, map: map_name, inspection, shown, picture })
}

fn read_query(args: &Args, features: &FeatureArguments) -> Result<QueryImage> {
    let query = args.query.display();
    if is_recording(&args.query) {
        let Some(at_s) = args.at else { bail!("{query} is a recording: say when in it with --at SECONDS") };
        if args.camera.is_some() {
            bail!("--camera: the recording {query} states its own camera");
        }
        QueryImage::from_recording(&args.query, &args.calibration.files(), at_s, features)
    } else {
        if args.at.is_some() {
            bail!("--at: {query} is no recording, which is a folder with mav0/cam0 in it or a bag");
        }
        let Some(camera) = &args.camera else {
            bail!("{query}: say which camera took it with --camera YAML");
        };
        QueryImage::from_file(&args.query, camera, features)
    }
}

/// The keyframe's image, from the recording that the map was built from; `None` for a recording without images.
fn keyframe_image(
    recording: &Path,
    files: &CalibrationFiles,
    keyframe: &InspectedKeyframe,
) -> Result<Option<GrayImage>> {
    let sequence = Sequence::open_without_readings(recording, files).context("--recording")?;
    let found = sequence.frames.binary_search_by_key(&keyframe.stamp_ns, |frame| frame.stamp_ns);
    let Ok(at) = found else {
        bail!(
            "--recording: {} has no image of {} ns, when keyframe {} was taken: give the recording that the map was \
             built from",
            recording.display(),
            keyframe.stamp_ns,
            keyframe.id
        );
    };
    let camera_of = format!("the camera of keyframe {}", keyframe.id);
    let image = sequence.frames[at].images.get(&0);
    image.map(|image| read_image(image, &keyframe.camera, &camera_of)).transpose()
}

fn print(report: &Report) {
    let reply = &report.inspection.reply;
    println!(
        "{}: {} features against map {} (version {})",
        report.query, report.features, report.map, reply.map_version
    );
    match &reply.fix {
        Some(fix) => print_fix(fix),
        None => println!("not recognized: {}", describe(reply.outcome)),
    }
    let listed = &report.inspection.keyframes;
    if !listed.is_empty() {
        println!("{:>10} {:>7} {:>8} {:>8} {:>9}", "keyframe", "votes", "matches", "inliers", "error px");
    }
    let others = report.shown.iter().filter(|shown| listed.iter().all(|keyframe| keyframe.id != shown.id));
    for keyframe in listed.iter().chain(others) {
        let error = keyframe.mean_error_px.map_or_else(|| "-".to_owned(), |error| format!("{error:.2}"));
        println!(
            "{:>10} {:>7} {:>8} {:>8} {error:>9}  {}{}",
            keyframe.id,
            keyframe.votes,
            keyframe.matches.len(),
            keyframe.inliers(),
            describe_verdict(keyframe),
            if listed.contains(keyframe) { "" } else { ", not among the candidates" }
        );
    }
    match &report.shown {
        Some(shown) => println!("picture of keyframe {}: {}", shown.id, report.picture.display()),
        None => println!("picture: {}", report.picture.display()),
    }
}

fn as_json(report: &Report) -> Result<Value> {
    let reply: Value = serde_json::from_slice(&protocol::encode(Format::Json, &report.inspection.reply)?)?;
    let candidates: Vec<Value> = report.inspection.keyframes.iter().map(keyframe_as_json).collect();
    let shown = report.shown.as_ref().map(|shown| {
        let mut value = keyframe_as_json(shown);
        value["gate_px"] = json!(shown.gate_px);
        value["all_matches"] = shown.matches.iter().map(match_as_json).collect();
        value
    });
    Ok(json!({
        "query": report.query,
        "features": report.features,
        "map": report.map,
        "answer": reply,
        "candidates": candidates,
        "picture": report.picture,
        "keyframe_in_picture": shown,
    }))
}

fn keyframe_as_json(keyframe: &InspectedKeyframe) -> Value {
    let pose = keyframe.global_from_camera.as_ref().map(|pose| {
        let (p, q) = (&pose.pose.translation, pose.pose.rotation.quaternion());
        let sigma = pose.covariance.diagonal().map(f64::sqrt);
        json!({
            "position_m": [p.x, p.y, p.z],
            "quaternion_wxyz": [q.w, q.i, q.j, q.k],
            "sigma_theta_rad": [sigma[0], sigma[1], sigma[2]],
            "sigma_p_m": [sigma[3], sigma[4], sigma[5]],
        })
    });
    json!({
        "keyframe": keyframe.id,
        "stamp_ns": keyframe.stamp_ns,
        "votes": keyframe.votes,
        "verdict": describe_verdict(keyframe),
        "matches": keyframe.matches.len(),
        "inliers": keyframe.inliers(),
        "mean_error_px": keyframe.mean_error_px,
        "global_from_camera": pose,
    })
}

fn match_as_json(found: &InspectedMatch) -> Value {
    json!({
        "feature": found.feature,
        "landmark": found.landmark,
        "query_px": found.query_pixel,
        "keyframe_px": found.keyframe_pixel,
        "descriptor_distance": found.distance,
        "inlier": found.inlier,
        "error_px": found.error_px(),
    })
}
