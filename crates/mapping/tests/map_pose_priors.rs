//! Maps in the frame of known positions and poses: as accurate and as uncertain as they state.

use crate::common::map_errors::{errors, true_pose, true_poses_in};
use crate::common::sessions::{ALL_TRACKS, FEW_TRACKS};
use geometry::uncertain_pose::isotropic_covariance;
use geometry::{Pose, rotation};
use map::contents::MapContents;
use mapping::run_odometry;
use mapping::{BuildError, BuildOptions, BuildReport, PosePriors, build_map_from_odometry};
use nalgebra::{Matrix3, Vector3, Vector6};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use sensors::{ReferencePose, ReferencePosition, Sequence};
use simulation::{Scenario, SimulationOptions, simulate};

/// Standard deviations of known positions (m), and of known poses (rad, m).
const SIGMA_POSITION: f64 = 0.05;
const SIGMAS_POSE: [f64; 2] = [0.01, 0.05];

/// One and a half rounds of a loop of 126 m.
fn recording(seed: u64) -> Sequence {
    recording_with(FEW_TRACKS, seed)
}

fn recording_with(max_tracks: usize, seed: u64) -> Sequence {
    let options = SimulationOptions {
        seed,
        scenario: Scenario::Loops,
        speed: 3.0,
        duration_s: Some(60.0),
        max_tracks,
        live_feature_period_s: 0.5,
        dropout_fraction: 0.0,
        ..SimulationOptions::default()
    };
    simulate(&options).unwrap().live
}

fn global_from_truth() -> Pose {
    Pose::new(rotation::exp(&Vector3::new(0.0, 0.0, 2.1)), Vector3::new(300.0, -120.0, 45.0))
}

fn normal(rng: &mut StdRng) -> f64 {
    StandardNormal.sample(rng)
}

/// Times in the recording, between images.
fn times(sequence: &Sequence, period_s: f64) -> Vec<i64> {
    let (first, last) = (sequence.frames[0].stamp_ns, sequence.frames[sequence.frames.len() - 1].stamp_ns);
    (first + 13_000_000..last).step_by((period_s * 1e9) as usize).collect()
}

/// Positions of an antenna, a part of them off by metres.
fn positions(sequence: &Sequence, seed: u64, wrong: f64) -> PosePriors {
    let mut rng = StdRng::seed_from_u64(seed);
    let mut priors = PosePriors::default();
    priors.lever_arm = Vector3::new(0.2, -0.1, 0.5);
    for stamp_ns in times(sequence, 1.0) {
        let global_from_imu = global_from_truth().compose(&true_pose(sequence, stamp_ns));
        let mut position = global_from_imu.transform(&priors.lever_arm);
        position += Vector3::from_fn(|_, _| SIGMA_POSITION * normal(&mut rng));
        if rng.random_bool(wrong) {
            position += Vector3::from_fn(|_, _| rng.random_range(1.0..5.0));
        }
        let covariance = Matrix3::identity() * SIGMA_POSITION.powi(2);
        priors.positions.push(ReferencePosition { stamp_ns, position, covariance });
    }
    priors
}

/// Poses, and no positions.
fn poses(sequence: &Sequence, seed: u64) -> PosePriors {
    let mut rng = StdRng::seed_from_u64(seed);
    let mut priors = PosePriors::default();
    let [sigma_theta, sigma_p] = SIGMAS_POSE;
    let covariance = isotropic_covariance(sigma_theta, sigma_p);
    for stamp_ns in times(sequence, 20.0) {
        let error = Vector6::from_fn(|row, _| SIGMAS_POSE[row / 3] * normal(&mut rng));
        let pose = global_from_truth().compose(&true_pose(sequence, stamp_ns)).retract(&error);
        priors.poses.push(ReferencePose { stamp_ns, pose, covariance });
    }
    priors
}

fn build(sequence: &mut Sequence, priors: &PosePriors) -> Result<(MapContents, BuildReport), BuildError> {
    let odometry = run_odometry(sequence, 2, |_, _| {}).unwrap();
    build_map_from_odometry(sequence, &odometry, priors, None, &BuildOptions::default(), &mut |_, _, _| {})
}

/// # Returns
/// NEES of all keyframes together over its degrees of freedom, and the RMS of their positions (m).
fn nees(sequence: &Sequence, contents: &MapContents) -> (f64, f64) {
    let truth = true_poses_in(&global_from_truth(), sequence, contents);
    let (error, covariance) = errors(contents, &truth);
    let nees = error.dot(&covariance.cholesky().unwrap().solve(&error));
    let square: f64 = (0..error.len()).filter(|row| row % 6 >= 3).map(|row| error[row].powi(2)).sum();
    (nees / error.len() as f64, (square / contents.keyframes.len() as f64).sqrt())
}

/// Builds a map of each seed and compares it with the truth in the frame of the priors.
fn errors_are_as_stated(
    max_tracks: usize,
    seeds: std::ops::RangeInclusive<u64>,
    priors: impl Fn(&Sequence, u64) -> PosePriors,
) {
    let count = seeds.clone().count() as f64;
    let mut sum = 0.0;
    for seed in seeds {
        let mut sequence = recording_with(max_tracks, seed);
        let priors = priors(&sequence, seed);
        let (contents, report) = build(&mut sequence, &priors).unwrap();
        let (of_map, metres) = nees(&sequence, &contents);
        println!(
            "seed {seed}: {} keyframes, {} of {} priors refused, {metres:.3} m, NEES {of_map:.2}",
            contents.keyframes.len(),
            report.refused_pose_priors,
            report.pose_priors
        );
        assert!(metres < 0.1, "{metres}");
        sum += of_map;
    }
    let mean = sum / count;
    assert!((0.7..1.4).contains(&mean), "NEES {mean}");
}

#[test]
fn a_map_of_known_positions_is_in_their_frame_and_wrong_ones_are_refused() {
    errors_are_as_stated(FEW_TRACKS, 1..=1, |sequence, seed| positions(sequence, seed, 0.1));
}

#[test]
fn a_map_of_known_poses_is_in_their_frame() {
    errors_are_as_stated(FEW_TRACKS, 1..=1, poses);
}

#[test]
#[ignore = "takes minutes"]
fn errors_of_forty_maps_are_as_stated() {
    errors_are_as_stated(ALL_TRACKS, 1..=20, |sequence, seed| positions(sequence, seed, 0.1));
    errors_are_as_stated(ALL_TRACKS, 1..=20, poses);
}

#[test]
fn what_cannot_be_used_is_said_in_words() {
    let mut sequence = recording(1);
    let good = positions(&sequence, 1, 0.0);
    let odometry = run_odometry(&mut sequence, 2, |_, _| {}).unwrap();
    let refusal = |priors: &PosePriors| {
        let options = BuildOptions::default();
        build_map_from_odometry(&sequence, &odometry, priors, None, &options, &mut |_, _, _| {})
            .unwrap_err()
            .to_string()
    };
    let mut downwards = good.clone();
    downwards.positions.iter_mut().for_each(|known| known.position.y = -known.position.y);
    let said = refusal(&downwards);
    assert!(said.contains("contradict") && said.contains("z points up"), "{said}");
    let mut late = good.clone();
    late.positions.iter_mut().for_each(|known| known.stamp_ns += 3_600_000_000_000);
    let said = refusal(&late);
    assert!(said.contains("clock of the recording"), "{said}");
    let mut single = good;
    single.positions = single.positions.split_off(30);
    single.positions.truncate(1);
    let said = refusal(&single);
    assert!(said.contains("do not determine yaw"), "{said}");
}
