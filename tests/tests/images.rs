//! Real images, with the bounds that the system must keep on them.
//!
//! They are not part of the repository. Unpacked to `target/data` they are run; elsewhere each test says that it has
//! nothing to run.
#![allow(clippy::unwrap_used)]

use onboard::sequence::{Sequence, TruthTrack};
use std::path::Path;
use std::sync::Arc;
use tests::images::{Found, Split, within, wrong_by};
use tests::robot::run;
use tools::in_process::LocalServer;
use vision::FeatureExtractor;
use vision::features::open;

const MAP_FEATURES: usize = 1000;
/// Time after the first fix from which on poses are scored, nanoseconds.
const SETTLED_NS: i64 = 5_000_000_000;
/// The truth's own standard deviation, m.
const TRUTH_SIGMA: f64 = 0.01;
const QUERY_FEATURES: usize = 1000;

fn vicon_room() -> Option<Sequence> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/data/images/v1_01_keyframes");
    if !folder.is_dir() {
        eprintln!("v1_01_keyframes is not unpacked in target/data: nothing to run");
        return None;
    }
    Some(Sequence::open(&folder).unwrap())
}

fn odd_images() -> Option<Split> {
    Some(Split::new(vicon_room()?, |index, _| index % 2 == 1))
}

fn classical() -> Box<dyn FeatureExtractor> {
    open("sift-1", None).unwrap()
}

fn tell(what: &str, found: &[Found]) {
    let near = found.iter().filter(|found| found.near).count();
    println!(
        "{what}: of {} queries {near} have a map image near; {} within 5 cm and 1 deg, {} within 10 cm and 2 deg, {} \
         wrong by 0.5 m",
        found.len(),
        within(found, 0.05, 1.0),
        within(found, 0.10, 2.0),
        wrong_by(found, 0.5)
    );
    let mut nees: Vec<f64> = found.iter().filter_map(|found| found.nees).collect();
    nees.sort_by(f64::total_cmp);
    if !nees.is_empty() {
        println!("  NEES/6 median {:.2}, 90 % below {:.2}", nees[nees.len() / 2], nees[nees.len() * 9 / 10]);
    }
    for found in found.iter().filter(|found| found.near && within(&[**found], 0.05, 1.0) == 0) {
        println!("  frame {}: {:?}", found.frame, found.error);
    }
}

#[test]
fn images_between_those_of_the_map_are_localized() {
    let Some(split) = odd_images() else { return };
    let mut extractor = classical();
    let (map, report) = split.build(extractor.as_mut(), MAP_FEATURES);
    println!(
        "{} keyframes, {} landmarks, {} observations, pixel sigma {:.2}, {:.2?} px, poses to {:.4?} m {:.3?} deg, corrected \
         {:.4?} m {:.3?} deg",
        report.keyframes,
        report.landmarks,
        report.observations,
        report.pixel_sigma,
        report.reprojection_px,
        report.pose_sigma_m,
        report.pose_sigma_deg,
        report.pose_correction_m,
        report.pose_correction_deg
    );
    let found = split.localize(&map, extractor.as_mut(), QUERY_FEATURES, |image| image);
    tell("even in odd", &found);
    assert!(within(&found, 0.05, 1.0) >= 45);
    assert_eq!(wrong_by(&found, 0.5), 0);
}

#[test]
fn later_images_are_localized_in_a_map_of_the_first_50_s() {
    let Some(sequence) = vicon_room() else { return };
    let first_ns = sequence.frames[0].stamp_ns;
    let split = Split::new(sequence, |_, frame| frame.stamp_ns - first_ns < 50_000_000_000);
    let mut extractor = classical();
    let (map, _) = split.build(extractor.as_mut(), MAP_FEATURES);
    let found = split.localize(&map, extractor.as_mut(), QUERY_FEATURES, |image| image);
    tell("later in the first 50 s", &found);
    assert!(within(&found, 0.10, 2.0) >= 22);
    assert_eq!(wrong_by(&found, 0.5), 0);
}

/// The whole flight with one image every one to five seconds: nothing to track, only the map and the IMU.
#[test]
fn few_images_keep_a_robot_in_the_map() {
    let Some(split) = odd_images() else { return };
    let (map, _) = split.build(classical().as_mut(), MAP_FEATURES);
    let mut live = split.sequence.clone();
    live.frames = split.queries.iter().map(|&index| split.sequence.frames[index].clone()).collect();
    let server = LocalServer::start(vec![("map".to_owned(), Arc::clone(&map))]).unwrap();
    let link = server.link("map").unwrap();
    let out = tempfile::tempdir().unwrap();
    let switches = "--cameras mono --imu-noise-scale 3 --gyroscope-bias-sigma 0.1 --accelerometer-bias-sigma 0.2 --match-sigma 2";
    let outcome = run(&live, out.path(), switches, Some(link.clone()));
    server.unlink(&link);
    server.stop().unwrap();
    let truth = TruthTrack::new(live.groundtruth.as_deref().unwrap());
    let first_fix_ns =
        outcome.recorder.states.iter().find(|state| state.global_from_imu.is_some()).unwrap().stamp_ns;
    let (mut last_ns, mut scored) = (i64::MIN, 0);
    for state in outcome.recorder.states.iter().filter(|state| state.stamp_ns > first_fix_ns + SETTLED_NS) {
        let gap_ns = state.stamp_ns.saturating_sub(last_ns);
        last_ns = state.stamp_ns;
        let estimate = state.global_from_imu.as_ref().unwrap();
        let Some(truth) = truth.pose(state.stamp_ns, 110_000_000) else { continue };
        let error = estimate.pose.local(&truth);
        let (theta, p) = (error.fixed_rows::<3>(0).norm().to_degrees(), error.fixed_rows::<3>(3).norm());
        let sigmas = estimate.covariance.diagonal().map(f64::sqrt);
        println!("after {:.2} s: {p:.3} m, {theta:.2} deg, sigma {sigmas:.4?}", gap_ns as f64 * 1e-9);
        if gap_ns < 2_000_000_000 {
            scored += 1;
            assert!(p <= 0.10, "{p} m after a gap of {} s", gap_ns as f64 * 1e-9);
        }
        for axis in 3..6 {
            assert!(error[axis].abs() <= 3.0 * sigmas[axis].hypot(TRUTH_SIGMA), "{error:?} of {sigmas:?}");
        }
    }
    assert!(scored > 15, "only {scored} states were scored");
}
