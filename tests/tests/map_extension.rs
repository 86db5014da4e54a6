//! Maps extended by further recordings: as accurate and as uncertain as they state, with ids and version kept in order.
#![allow(clippy::unwrap_used)]

use map::contents::MapContents;
use mapping::{BuildOptions, ExtendError, ExtensionReport, build_map_from_odometry, extend_map};
use sensors::Sequence;
use simulation::{Scenario, SimulationOptions, simulate};
use tests::map_errors::{errors, true_poses};
use tools::odometry::run_odometry;

/// Length of a session: a loop takes 42 s.
const SESSION_S: f64 = 46.0;

/// Several sessions over one loop of 126 m, and the whole recording that they are cut from.
///
/// # Arguments
/// * `period_s`: between images with features.
fn sessions(seed: u64, count: usize, period_s: f64) -> (Vec<Sequence>, Sequence) {
    let options = SimulationOptions {
        seed,
        scenario: Scenario::Loops,
        speed: 3.0,
        duration_s: Some(SESSION_S * count as f64),
        live_feature_period_s: period_s,
        dropout_fraction: 0.0,
        ..SimulationOptions::default()
    };
    let whole = simulate(&options).unwrap().live;
    let begin_ns = whole.frames[0].stamp_ns;
    let session = |index: usize| {
        let limit = |index: usize| begin_ns + (index as f64 * SESSION_S * 1e9) as i64;
        let [from_ns, to_ns] = [limit(index), limit(index + 1)];
        let mut part = whole.clone();
        part.frames.retain(|frame| (from_ns..to_ns).contains(&frame.stamp_ns));
        part.imu_samples.retain(|reading| (from_ns - 50_000_000..to_ns).contains(&reading.stamp_ns));
        part
    };
    ((0..count).map(session).collect(), whole)
}

fn build(sequence: &mut Sequence) -> MapContents {
    let odometry = run_odometry(sequence, 2, |_, _| {}).unwrap();
    build_map_from_odometry(sequence, &odometry, None, &BuildOptions::default(), &mut |_, _, _| {}).unwrap().0
}

fn extend(map: &MapContents, sequence: &mut Sequence) -> Result<(MapContents, ExtensionReport), ExtendError> {
    let odometry = run_odometry(sequence, 2, |_, _| {}).unwrap();
    extend_map(map, sequence, &odometry, None, &BuildOptions::default(), &mut |_, _, _| {})
}

/// NEES of all keyframes together, its degrees of freedom, and the error of the positions of the first session along an
/// axis (m).
fn nees(whole: &Sequence, map: &MapContents, first_session: usize) -> (f64, f64, f64) {
    let (error, covariance) = errors(map, &true_poses(whole, map));
    let nees = error.dot(&covariance.cholesky().unwrap().solve(&error));
    let positions = error.rows(0, 6 * (first_session - 1));
    let squares: f64 = positions.iter().enumerate().filter(|(at, _)| at % 6 > 2).map(|(_, e)| e * e).sum();
    (nees, error.len() as f64, (squares / (3 * (first_session - 1)) as f64).sqrt())
}

/// Builds a map of the first session and extends it by the others.
///
/// # Returns
/// NEES and degrees of freedom after the last extension, and the mean square error of the first session's positions before
/// and after (m^2).
fn extended_nees(seed: u64, count: usize, period_s: f64) -> (f64, f64, [f64; 2]) {
    let (mut parts, whole) = sessions(seed, count, period_s);
    let mut map = build(&mut parts[0]);
    let first_session = map.keyframes.len();
    let (of_first, freedom, before_m) = nees(&whole, &map, first_session);
    println!("seed {seed}: {first_session} keyframes, {before_m:.4} m, NEES {:.2}", of_first / freedom);
    let mut result = (0.0, 0.0, [0.0; 2]);
    for part in &mut parts[1..] {
        let (extended, report) = extend(&map, part).unwrap();
        let (nees, freedom, after_m) = nees(&whole, &extended, first_session);
        println!(
            "  {} keyframes, {} of {} places, {} landmarks again, moved {:.4} m, sigma {:.4} -> {:.4} m, error {after_m:.4} m, NEES {:.2}",
            extended.keyframes.len(),
            report.agreeing_places,
            report.places,
            report.landmarks_seen_again,
            report.moved_m,
            report.sigma_before_m,
            report.sigma_after_m,
            nees / freedom
        );
        assert!(report.sigma_after_m < report.sigma_before_m, "{report:?}");
        result = (nees, freedom, [before_m.powi(2), after_m.powi(2)]);
        map = extended;
    }
    result
}

fn errors_are_as_stated(seeds: std::ops::RangeInclusive<u64>, count: usize, period_s: f64) {
    let (mut nees, mut freedom, mut squares) = (0.0, 0.0, [0.0; 2]);
    for seed in seeds {
        let (of_seed, freedom_of_seed, of_positions) = extended_nees(seed, count, period_s);
        nees += of_seed;
        freedom += freedom_of_seed;
        squares[0] += of_positions[0];
        squares[1] += of_positions[1];
    }
    let ratio = nees / freedom;
    assert!((0.6..1.5).contains(&ratio), "NEES {ratio}");
    assert!(squares[1] < squares[0], "{squares:?}");
}

#[test]
fn errors_of_two_sessions_are_as_stated() {
    errors_are_as_stated(1..=3, 2, 1.2);
}

#[test]
#[ignore = "takes minutes"]
fn errors_of_five_sessions_are_as_stated() {
    errors_are_as_stated(1..=6, 5, 2.4);
}
