//! Build a map, serve it, localize in it: the main job.
#![allow(clippy::unwrap_used)]

use onboard::evaluation::Score;
use onboard::robot::Outcome;
use onboard::robot::run_robot;
use onboard::trajectory::{StateKind, states, tum};
use protocol::RobotState;
use std::path::Path;
use tests::place::Place;
use tests::robot::{arguments, frames_with_imu, run};
use tests::server::{Client, Server};
use tools::in_process::load_map;

/// Position error that a localized robot may have in this place, metres. The map's poses are off by 0.1 m an axis.
const BOUND_M: f64 = 0.15;
/// Rotation error, degrees. The map's poses are off by 0.9 degrees an axis.
const BOUND_DEG: f64 = 1.0;

fn localized(outcome: &Outcome) -> &Score {
    let summary = &outcome.summary;
    let status = summary.final_status.as_ref().unwrap();
    assert_eq!(status.localization, RobotState::Localized, "{}", status.reason);
    let score = summary.score.as_ref().unwrap();
    assert!(score.first_fix_s.unwrap() < 8.0, "{:?}", score.first_fix_s);
    score.pose.as_ref().unwrap()
}

#[test]
fn a_robot_localizes_in_a_map_that_was_built_stored_and_served() {
    let place = Place::shared();
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start("ring", load_map(&place.database(folder.path())).unwrap());
    let client = Client::connect(server.endpoint());
    for mode in ["single", "multi"] {
        let out = folder.path().join(mode);
        let outcome = run(&place.recordings.live, &out, &format!("--mode {mode}"), Some(client.link("ring")));
        let score = localized(&outcome);
        eprintln!("{mode}: {score:?}");
        eprintln!("{:?}", outcome.summary.score);
        eprintln!("{:?}", outcome.summary.queries);
        eprintln!("{:?}", outcome.summary.milliseconds_per_frame);
        assert!(score.rmse_m < BOUND_M && score.rmse_deg < BOUND_DEG, "{mode}: {score:?}");
    }
    client.close();
    server.stop();
    let _ = (Path::new(""), arguments, run_robot::<fn(usize)>, frames_with_imu, StateKind::ALL, states::read, tum::read);
}
