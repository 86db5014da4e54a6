//! Maps from recordings without reference poses: as accurate and as uncertain as they state.
#![allow(clippy::unwrap_used)]

use map::contents::MapContents;
use mapping::{BuildOptions, BuildReport, PosePriors, build_map_from_odometry};
use sensors::Sequence;
use simulation::{Scenario, SimulationOptions, simulate};
use tests::map_errors::{errors, true_poses};
use tools::odometry::run_odometry;

/// More than one round of a loop of 126 m, with features of every second image and a third of all descriptors repeated.
fn recording(seed: u64) -> Sequence {
    let options = SimulationOptions {
        seed,
        scenario: Scenario::Loops,
        speed: 3.0,
        duration_s: Some(48.0),
        live_feature_period_s: 0.5,
        dropout_fraction: 0.0,
        ..SimulationOptions::default()
    };
    simulate(&options).unwrap().live
}

fn build(sequence: &mut Sequence, cameras: usize) -> (MapContents, BuildReport) {
    let odometry = run_odometry(sequence, cameras, |_, _| {}).unwrap();
    build_map_from_odometry(
        sequence,
        &odometry,
        &PosePriors::default(),
        None,
        &BuildOptions::default(),
        &mut |_, _, _| {},
    )
    .unwrap()
}

/// # Returns
/// NEES of all keyframes together, and its degrees of freedom.
fn joint_nees(seed: u64, cameras: usize) -> (f64, f64) {
    let mut sequence = recording(seed);
    let (contents, report) = build(&mut sequence, cameras);
    assert!(report.loops > 3 && report.refused_loops < report.loops, "{report:?}");
    let truth = true_poses(&sequence, &contents);
    let (error, covariance) = errors(&contents, &truth);
    let nees = error.dot(&covariance.cholesky().unwrap().solve(&error));
    let positions = error.iter().skip(3).step_by(6).map(|error| error * error).sum::<f64>();
    println!(
        "seed {seed}: {} keyframes, {} loops, error along x {:.3} m, NEES {:.2}",
        contents.keyframes.len(),
        report.loops,
        (positions / contents.keyframes.len() as f64).sqrt(),
        nees / error.len() as f64
    );
    (nees, error.len() as f64)
}

fn errors_are_as_stated(seeds: std::ops::RangeInclusive<u64>, cameras: usize) {
    let (mut nees, mut freedom) = (0.0, 0.0);
    for seed in seeds {
        let (of_run, freedom_of_run) = joint_nees(seed, cameras);
        nees += of_run;
        freedom += freedom_of_run;
    }
    let ratio = nees / freedom;
    assert!((0.7..1.4).contains(&ratio), "NEES {ratio}");
}

#[test]
fn errors_of_a_stereo_map_are_as_stated() {
    errors_are_as_stated(1..=3, 2);
}

#[test]
fn errors_of_a_mono_map_are_as_stated() {
    errors_are_as_stated(1..=3, 1);
}

#[test]
#[ignore = "takes minutes"]
fn errors_of_forty_maps_are_as_stated() {
    errors_are_as_stated(1..=20, 2);
    errors_are_as_stated(1..=20, 1);
}

#[test]
fn a_recording_without_imu_says_what_is_missing() {
    let mut sequence = recording(1);
    sequence.imu_samples.clear();
    let error = run_odometry(&mut sequence, 2, |_, _| {}).unwrap_err().to_string();
    assert!(error.contains("IMU") && error.contains("--poses"), "{error}");
}

#[test]
fn a_camera_that_stands_still_makes_no_map_and_a_dark_stretch_is_said() {
    let options = SimulationOptions {
        scenario: Scenario::Room,
        depth_m: Scenario::Room.depth_m(),
        duration_s: Some(2.2),
        live_feature_period_s: 0.5,
        dropout_fraction: 0.0,
        ..SimulationOptions::default()
    };
    let mut still = simulate(&options).unwrap().live;
    let odometry = run_odometry(&mut still, 2, |_, _| {}).unwrap();
    let built = build_map_from_odometry(
        &still,
        &odometry,
        &PosePriors::default(),
        None,
        &BuildOptions::default(),
        &mut |_, _, _| {},
    );
    let error = built.unwrap_err().to_string();
    assert!(error.contains("the camera moved by 0.0") && error.contains("record while moving"), "{error}");

    let mut dark = recording(1);
    let first_ns = dark.frames[0].stamp_ns;
    for frame in &mut dark.frames {
        if (10..13).contains(&((frame.stamp_ns - first_ns) / 1_000_000_000)) {
            frame.tracks.clear();
            frame.features = None;
        }
    }
    let (contents, report) = build(&mut dark, 2);
    let untracked = report.untracked_images.unwrap();
    assert!((2.8..3.3).contains(&untracked.longest_s), "{untracked:?}");
    let (error, covariance) = errors(&contents, &true_poses(&dark, &contents));
    let nees = error.dot(&covariance.cholesky().unwrap().solve(&error)) / error.len() as f64;
    assert!((0.5..1.6).contains(&nees), "the covariance covers the dark stretch: {nees}");
}
