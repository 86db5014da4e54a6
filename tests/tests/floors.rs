//! A building of two floors: a map each, served by one server, and a robot that goes from one to the other.

use estimator::Localization;
use onboard::Outcome;
use sensors::Sequence;
use std::sync::{Arc, OnceLock};
use tests::robot::run;
use tests::scenario::MappedScenario;
use tools::in_process::LocalServer;

/// Another floor: the same corridor, other things in it.
fn upper_floor() -> &'static MappedScenario {
    static UPPER: OnceLock<MappedScenario> = OnceLock::new();
    UPPER.get_or_init(|| MappedScenario::new(8))
}

/// Largest error of the poses in the map, metres, and how many there are.
fn worst_error(outcome: &Outcome, drive: &Sequence) -> (f64, usize) {
    let truth = drive.groundtruth.as_ref().unwrap();
    let states = outcome.states().unwrap();
    let error = |stamp_ns: i64, position: nalgebra::Vector3<f64>| {
        let nearest = truth.iter().min_by_key(|row| (row.stamp_ns - stamp_ns).abs()).unwrap();
        (position - nearest.pose.translation).norm()
    };
    let errors: Vec<f64> = states
        .iter()
        .filter_map(|state| Some(error(state.stamp_ns, state.global_from_imu.as_ref()?.pose.translation)))
        .collect();
    (errors.iter().copied().fold(0.0, f64::max), errors.len())
}

#[test]
fn a_robot_is_localized_on_each_floor_in_its_own_map_and_in_no_other() {
    let (lower, upper) = (MappedScenario::shared(), upper_floor());
    let maps = [("floor1", lower.loaded()), ("floor2", upper.loaded())];
    let served = maps.iter().map(|(name, map)| ((*name).to_owned(), Arc::clone(map))).collect();
    let server = LocalServer::start(served).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let drive = |drive: &Sequence, map: &str, out: &str| {
        let link = server.link(map).unwrap();
        let outcome = run(drive, &folder.path().join(out), "--robot cart7", Some(link.clone()));
        server.unlink(&link);
        outcome
    };
    // Up, as the page says: a run each, which begins where the lift has stopped.
    for (floor, map, out) in [(lower, "floor1", "down"), (upper, "floor2", "up")] {
        let outcome = drive(&floor.recordings.live, map, out);
        let status = outcome.summary.final_status.as_ref().unwrap();
        assert_eq!(status.localization, Localization::Localized, "{map}: {}", status.reason);
        let (error_m, poses) = worst_error(&outcome, &floor.recordings.live);
        assert!(poses > 100 && error_m < 1.0, "{map}: {poses} poses, {error_m} m");
    }
    // Who forgot to change the map has no pose at all, and not one of the wrong floor.
    let outcome = drive(&upper.recordings.live, "floor1", "forgotten");
    let status = outcome.summary.final_status.as_ref().unwrap();
    assert_eq!(status.localization, Localization::OdometryOnly, "{}", status.reason);
    assert_eq!(worst_error(&outcome, &upper.recordings.live).1, 0);
    server.stop().unwrap();
}
