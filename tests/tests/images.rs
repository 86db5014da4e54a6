//! Real images, with the bounds that the system must keep on them.
//!
//! They are not part of the repository. Unpacked to `target/data` they are run; elsewhere each test says that it has
//! nothing to run.
#![allow(clippy::unwrap_used)]

use onboard::sequence::Sequence;
use std::path::Path;
use tests::images::{Found, Split, within, wrong_by};
use vision::FeatureExtractor;
use vision::features::open;

const MAP_FEATURES: usize = 1000;
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
