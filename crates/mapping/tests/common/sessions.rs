//! Sessions over one place, and maps of them.

use map::contents::MapContents;
use mapping::run_odometry;
use mapping::{BuildOptions, PosePriors, build_map_from_odometry};
use sensors::Sequence;
use simulation::{Scenario, SimulationOptions, simulate};

use super::map_errors::{FRAME_DIM, errors, global_from_truth, true_poses_in};

/// Length of a session, of which a loop takes 42 s, ...
const SESSION_S: f64 = 46.0;
/// ... and of all sessions together, at most.
const RECORDING_S: f64 = 410.0;

/// Tracks in an image, in every run of the tests.
pub const FEW_TRACKS: usize = 40;
/// Tracks in an image, in the nightly run.
pub const ALL_TRACKS: usize = 60;

/// Several sessions over one loop of 126 m, and the whole recording that they are cut from.
///
/// # Arguments
/// * `period_s`: between images with features.
pub fn sessions(seed: u64, count: usize, period_s: f64) -> (Vec<Sequence>, Sequence) {
    sessions_with(FEW_TRACKS, seed, count, period_s)
}

/// As [`sessions`], with so many tracks in an image.
pub fn sessions_with(max_tracks: usize, seed: u64, count: usize, period_s: f64) -> (Vec<Sequence>, Sequence) {
    let session_s = SESSION_S.min(RECORDING_S / count as f64);
    let options = SimulationOptions {
        seed,
        scenario: Scenario::Loops,
        speed: 3.0,
        duration_s: Some(session_s * count as f64),
        max_tracks,
        live_feature_period_s: period_s,
        dropout_fraction: 0.0,
        ..SimulationOptions::default()
    };
    let whole = simulate(&options).unwrap().live;
    let begin_ns = whole.frames[0].stamp_ns;
    let session = |index: usize| {
        let limit = |index: usize| begin_ns + (index as f64 * session_s * 1e9) as i64;
        let [from_ns, to_ns] = [limit(index), limit(index + 1)];
        let mut part = whole.clone();
        part.frames.retain(|frame| (from_ns..to_ns).contains(&frame.stamp_ns));
        part.imu_samples.retain(|reading| (from_ns - 50_000_000..to_ns).contains(&reading.stamp_ns));
        part
    };
    ((0..count).map(session).collect(), whole)
}

/// A map of a session, in its own frame.
pub fn build(sequence: &mut Sequence) -> MapContents {
    let odometry = run_odometry(sequence, 2, |_, _| {}).unwrap();
    build_map_from_odometry(
        sequence,
        &odometry,
        &PosePriors::default(),
        None,
        &BuildOptions::default(),
        &mut |_, _, _| {},
    )
    .unwrap()
    .0
}

/// NEES of all keyframes together, its degrees of freedom, and the error of the positions of the first session along an
/// axis (m).
///
/// # Arguments
/// * `first`: the map that defines the frame.
pub fn nees(whole: &Sequence, map: &MapContents, first: &MapContents) -> (f64, f64, f64) {
    let truth = true_poses_in(&global_from_truth(whole, first), whole, map);
    let (error, covariance) = errors(map, &truth);
    let nees = error.dot(&covariance.cholesky().unwrap().solve(&error));
    let first_session = first.keyframes.len();
    let positions = error.rows(0, 6 * first_session);
    let squares: f64 = positions.iter().enumerate().filter(|(at, _)| at % 6 > 2).map(|(_, e)| e * e).sum();
    (nees, (error.len() - FRAME_DIM) as f64, (squares / (3 * first_session) as f64).sqrt())
}
