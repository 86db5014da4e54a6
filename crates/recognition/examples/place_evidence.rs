//! Single images of recordings, localized in a map without a prior, against the truth: what right and wrong places explain of their
//! images. The likelihoods of `recognition::evidence` and the matching of each extractor were fitted to this table.
//!
//! `cargo run --release -p driftless-recognition --example place_evidence -- MAP MAP_RECORDING EVERY RECORDING...`
//!
//! * `MAP`: built from `MAP_RECORDING`, whose truth at the keyframes aligns the map's frame (in yaw and position).
//! * `EVERY`: of the frames of a recording each so many is asked for.
//! * `RECORDING`: a folder in the layout of EuRoC with `state_groundtruth_estimate0`.
//!
//! Prints a line for each place that was verified, or one without a place, and a summary for each recording.

use std::error::Error;
use std::path::Path;

use evaluation::{Alignment, align};
use geometry::Pose;
use nalgebra::Vector3;
use protocol::MatchRequest;
use recognition::{Hypothesis, LoadedMap, RecognitionOptions, SearchReport};
use sensors::{CalibrationFiles, Sequence, TruthTrack};
use vision::{FeatureExtractor, feature_set};

/// Longest gap in the truth, nanoseconds.
const MAX_GAP_NS: i64 = 100_000_000;
/// A pose farther from the truth is of another place, metres.
const RIGHT_M: f64 = 0.3;
/// A map has a view of an image where a keyframe is so near (m) and looks in the same direction (cosine of 30 deg).
const VIEW_M: f64 = 2.0;
const VIEW_COSINE: f64 = 0.866;
const MAX_FEATURES: usize = 1000;

const HEADER: &str = "recording,stamp_ns,view,outcome,matches_in_view,inliers_in_view,place,error_m,error_deg,nees,features,\
    within_expected,within_confirmed,beyond_expected,beyond_confirmed,parts,picture,log_prior_odds,log_odds";

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [map, map_recording, every, recordings @ ..] = arguments.as_slice() else {
        return Err("usage: place_evidence MAP MAP_RECORDING EVERY RECORDING...".into());
    };
    let map = LoadedMap::read(map)?;
    let map_from_truth = map_from_truth(&map, Path::new(map_recording))?;
    let mut extractor = vision::features::open(&map.info().extractor, None)?;
    println!("{HEADER}");
    for recording in recordings {
        localize(&map, &map_from_truth, extractor.as_mut(), Path::new(recording), every.parse()?)?;
    }
    Ok(())
}

/// The map's frame by the truth at its keyframes.
fn map_from_truth(map: &LoadedMap, recording: &Path) -> Result<Pose, Box<dyn Error>> {
    let sequence = Sequence::open_without_readings(recording, &CalibrationFiles::default())?;
    let truth = sequence.groundtruth.ok_or("the map's recording has no ground truth")?;
    let track = TruthTrack::new(&truth);
    let imu_from_camera = &sequence.cameras[0].imu_from_camera;
    let pair = |keyframe: &map::Keyframe| {
        let truth_from_camera = track.pose(keyframe.stamp_ns, MAX_GAP_NS)?.compose(imu_from_camera);
        Some((keyframe.global_from_keyframe.pose.translation, truth_from_camera.translation))
    };
    let pairs: Vec<(Vector3<f64>, Vector3<f64>)> = map.keyframes().filter_map(pair).collect();
    let down = -Vector3::z();
    let gravity_in_reference = map.info().gravity_in_global.map_or(down, |gravity| gravity.normalize());
    Ok(align(&pairs, &Alignment::Yaw { gravity_in_reference, gravity_in_estimate: down })?)
}

fn localize(
    map: &LoadedMap,
    map_from_truth: &Pose,
    extractor: &mut dyn FeatureExtractor,
    recording: &Path,
    every: usize,
) -> Result<(), Box<dyn Error>> {
    let sequence = Sequence::open_without_readings(recording, &CalibrationFiles::default())?;
    let truth = sequence.groundtruth.ok_or("the recording has no ground truth")?;
    let track = TruthTrack::new(&truth);
    let sensor = &sequence.cameras[0];
    let options = RecognitionOptions::default();
    let name = recording.file_name().unwrap_or_default().to_string_lossy();
    let mut summary = Summary::default();
    for frame in sequence.frames.iter().step_by(every.max(1)) {
        let Some(data) = frame.images.get(&0) else { continue };
        let Some(truth_from_imu) = track.pose(frame.stamp_ns, MAX_GAP_NS) else { continue };
        let true_pose = map_from_truth.compose(&truth_from_imu).compose(&sensor.imu_from_camera);
        let features = extractor.extract(&*data.read()?, None, MAX_FEATURES)?;
        let request = MatchRequest {
            robot: "none".to_owned(),
            stamp_ns: frame.stamp_ns,
            camera: sensor.camera.clone(),
            features: feature_set(extractor.name(), features),
            prior: None,
            gravity_in_camera: None,
            held: Vec::new(),
            map_version_held: None,
            max_keyframes: options.max_keyframes as u16,
        };
        let (_, report) = map.answer_with_report(&request, &options)?;
        let claimed = report.hypotheses.first().filter(|first| {
            report.candidates.iter().any(|candidate| candidate.in_answer)
                && first.log_odds() >= options.min_fix_log_odds
                && first.place.features >= options.min_fix_inliers
        });
        let is_right = |place: &Hypothesis| error_m(place, &true_pose) <= RIGHT_M;
        let view = views(map, &true_pose);
        summary.images += 1;
        summary.with_view += usize::from(!view.is_empty());
        summary.right_found += usize::from(report.hypotheses.iter().any(is_right));
        summary.wrong_found += usize::from(report.hypotheses.iter().any(|place| !is_right(place)));
        summary.right_claimed += usize::from(claimed.is_some_and(is_right));
        summary.claimed_with_view += usize::from(claimed.is_some_and(is_right) && !view.is_empty());
        summary.wrong_claimed += usize::from(claimed.is_some_and(|place| !is_right(place)));
        print_rows(&format!("{name},{},", frame.stamp_ns), &report, &view, claimed.is_some(), &true_pose);
    }
    println!("# {name}: {summary:?}");
    Ok(())
}

/// What a recording gave.
#[derive(Debug, Default)]
struct Summary {
    images: usize,
    with_view: usize,
    right_found: usize,
    right_claimed: usize,
    claimed_with_view: usize,
    wrong_found: usize,
    wrong_claimed: usize,
}

fn error_m(place: &Hypothesis, true_pose: &Pose) -> f64 {
    (place.place.global_from_camera.pose.translation - true_pose.translation).norm()
}

/// The keyframes that see what an image from a pose sees.
fn views(map: &LoadedMap, pose: &Pose) -> Vec<u64> {
    let sees = |keyframe: &&map::Keyframe| {
        let difference = pose.inverse().compose(&keyframe.global_from_keyframe.pose);
        difference.translation.norm() <= VIEW_M && (difference.rotation * Vector3::z()).z >= VIEW_COSINE
    };
    map.keyframes().filter(sees).map(|keyframe| keyframe.id).collect()
}

fn print_rows(image: &str, report: &SearchReport, view: &[u64], is_claimed: bool, true_pose: &Pose) {
    let in_view = report.candidates.iter().filter(|candidate| view.contains(&candidate.keyframe));
    let (matches, inliers) = in_view.fold((0, 0), |(matches, inliers), candidate| {
        (candidate.matches.max(matches), candidate.inliers.max(inliers))
    });
    let image = format!("{image}{},{},{matches},{inliers}", view.len(), u8::from(is_claimed));
    if report.hypotheses.is_empty() {
        println!("{image},,,,,,,,,,,,,");
    }
    for (number, found) in report.hypotheses.iter().enumerate() {
        let pose = &found.place.global_from_camera.pose;
        let error_deg = pose.rotation.angle_to(&true_pose.rotation).to_degrees();
        let coverage = &found.coverage;
        let (within, beyond) = (coverage.within_picture, coverage.beyond_picture);
        println!(
            "{image},{number},{:.4},{error_deg:.3},{:.2},{},{},{},{},{},{},{:.3},{:.4},{:.4}",
            error_m(found, true_pose),
            found.place.global_from_camera.nees(true_pose).map_or(f64::NAN, |nees| nees / 6.0),
            found.place.features,
            within.expected,
            within.confirmed,
            beyond.expected,
            beyond.confirmed,
            coverage.parts,
            coverage.picture,
            found.log_prior_odds,
            found.log_odds(),
        );
    }
}
