//! Maps from recordings without reference poses: as accurate and as uncertain as they state.

use crate::common::map_errors::{FRAME_DIM, errors, true_pose, true_poses};
use crate::common::sessions::{ALL_TRACKS, FEW_TRACKS};
use map::contents::MapContents;
use mapping::run_odometry;
use mapping::{BuildError, BuildOptions, BuildReport, PosePriors, build_map_from_odometry};
use sensors::Sequence;
use simulation::{Scenario, SimulationOptions, simulate};

/// More than one round of a loop of 126 m, with features of every second image and a third of all descriptors repeated.
fn recording(seed: u64) -> Sequence {
    recording_with(FEW_TRACKS, seed)
}

fn recording_with(max_tracks: usize, seed: u64) -> Sequence {
    let options = SimulationOptions {
        seed,
        scenario: Scenario::Loops,
        speed: 3.0,
        duration_s: Some(48.0),
        max_tracks,
        live_feature_period_s: 0.5,
        dropout_fraction: 0.0,
        ..SimulationOptions::default()
    };
    simulate(&options).unwrap().live
}

fn try_build(sequence: &mut Sequence, cameras: usize) -> Result<(MapContents, BuildReport), BuildError> {
    let odometry = run_odometry(sequence, cameras, |_, _| {}).unwrap();
    let (priors, options) = (PosePriors::default(), BuildOptions::default());
    build_map_from_odometry(sequence, &odometry, &priors, None, &options, &mut |_, _, _| {})
}

fn build(sequence: &mut Sequence, cameras: usize) -> (MapContents, BuildReport) {
    try_build(sequence, cameras).unwrap()
}

/// The recording, one of ten images of which shows a place that was passed long before, far from where the camera is: recognition
/// finds all its matches there, and no loop is as convincing.
fn with_wrong_loops(mut sequence: Sequence) -> Sequence {
    let with_features: Vec<usize> = (0..sequence.frames.len())
        .filter(|&frame| sequence.frames[frame].features.contains_key(&0))
        .collect();
    let mut wrong = 0;
    for k in (0..with_features.len()).filter(|k| k % 10 == 3) {
        let position =
            |frame: usize| true_pose(&sequence, sequence.frames[with_features[frame]].stamp_ns).translation;
        let Some(other) = (0..k).rev().find(|&other| (position(other) - position(k)).norm() > 25.0) else {
            continue;
        };
        let features = sequence.frames[with_features[other]].features.clone();
        sequence.frames[with_features[k]].features = features;
        wrong += 1;
    }
    assert!(wrong > 6, "{wrong} wrong loops");
    sequence
}

/// # Returns
/// NEES of all keyframes together, and its degrees of freedom.
fn joint_nees(seed: u64, mut sequence: Sequence, cameras: usize) -> (f64, f64) {
    let (contents, report) = build(&mut sequence, cameras);
    assert!(report.loops > 3 && report.refused_loops < report.loops, "{report:?}");
    let truth = true_poses(&sequence, &contents);
    let (error, covariance) = errors(&contents, &truth);
    let nees = error.dot(&covariance.cholesky().unwrap().solve(&error));
    let positions = error.iter().skip(3).step_by(6).map(|error| error * error).sum::<f64>();
    println!(
        "seed {seed}: {} keyframes, {} loops, {} refused, error along x {:.3} m, NEES {:.2}",
        contents.keyframes.len(),
        report.loops,
        report.refused_loops,
        (positions / contents.keyframes.len() as f64).sqrt(),
        nees / error.len() as f64
    );
    (nees, (error.len() - FRAME_DIM) as f64)
}

fn errors_are_as_stated(
    recording: fn(u64) -> Sequence,
    seeds: std::ops::RangeInclusive<u64>,
    cameras: usize,
) {
    let (mut nees, mut freedom) = (0.0, 0.0);
    for seed in seeds {
        let (of_run, freedom_of_run) = joint_nees(seed, recording(seed), cameras);
        nees += of_run;
        freedom += freedom_of_run;
    }
    let ratio = nees / freedom;
    assert!((0.7..1.4).contains(&ratio), "NEES {ratio}");
}

#[test]
fn errors_of_a_stereo_map_are_as_stated() {
    errors_are_as_stated(recording, 1..=1, 2);
}

#[test]
fn errors_of_a_mono_map_are_as_stated() {
    errors_are_as_stated(recording, 1..=1, 1);
}

#[test]
#[ignore = "takes minutes"]
fn errors_of_forty_maps_are_as_stated() {
    let recording = |seed| recording_with(ALL_TRACKS, seed);
    errors_are_as_stated(recording, 1..=20, 2);
    errors_are_as_stated(recording, 1..=20, 1);
}

/// A wrong loop that was taken in would be an error of tens of metres.
#[test]
fn wrong_loops_are_refused() {
    let recording = |seed| with_wrong_loops(recording(seed));
    errors_are_as_stated(recording, 1..=1, 2);
    errors_are_as_stated(recording, 2..=2, 1);
}

#[test]
#[ignore = "takes minutes"]
fn wrong_loops_of_forty_maps_are_refused() {
    let recording = |seed| with_wrong_loops(recording_with(ALL_TRACKS, seed));
    errors_are_as_stated(recording, 1..=20, 2);
    errors_are_as_stated(recording, 1..=20, 1);
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
    let error = try_build(&mut still, 2).unwrap_err().to_string();
    assert!(error.contains("the camera moved by 0.0") && error.contains("record while moving"), "{error}");

    let mut dark = recording(1);
    let first_ns = dark.frames[0].stamp_ns;
    for frame in &mut dark.frames {
        if (10..13).contains(&((frame.stamp_ns - first_ns) / 1_000_000_000)) {
            frame.tracks.clear();
            frame.features.clear();
        }
    }
    let (contents, report) = build(&mut dark, 2);
    let untracked = report.untracked_images.unwrap();
    assert!((2.8..3.3).contains(&untracked.longest_s), "{untracked:?}");
    let (error, covariance) = errors(&contents, &true_poses(&dark, &contents));
    let nees = error.dot(&covariance.cholesky().unwrap().solve(&error)) / error.len() as f64;
    assert!((0.5..1.6).contains(&nees), "the covariance covers the dark stretch: {nees}");
}

/// Two recordings of different places as one, the second from 6 s after the end of the first, with its cameras and IMU off meanwhile.
fn two_places() -> Sequence {
    let part = |seed: u64| {
        let mut sequence = recording(seed);
        let end_ns = sequence.frames[0].stamp_ns + 20_000_000_000;
        sequence.frames.retain(|frame| frame.stamp_ns <= end_ns);
        sequence.imu_samples.retain(|reading| reading.stamp_ns <= end_ns);
        sequence.groundtruth.as_mut().unwrap().retain(|row| row.stamp_ns <= end_ns);
        sequence
    };
    let (mut both, mut second) = (part(1), part(2));
    let later_ns = 26_000_000_000;
    for frame in &mut second.frames {
        frame.stamp_ns += later_ns;
    }
    for reading in &mut second.imu_samples {
        reading.stamp_ns += later_ns;
    }
    for row in second.groundtruth.iter_mut().flatten() {
        row.stamp_ns += later_ns;
    }
    both.frames.extend(second.frames);
    both.imu_samples.extend(second.imu_samples);
    both.groundtruth.as_mut().unwrap().extend(second.groundtruth.unwrap());
    both
}

#[test]
fn two_places_in_one_recording_make_no_map_and_are_said() {
    let error = try_build(&mut two_places(), 2).unwrap_err().to_string();
    assert!(error.contains("pieces: at 23.") && error.contains("merge-maps"), "{error}");
}
