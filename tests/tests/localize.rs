//! Build a map, store it, serve it, localize in it: the main job.

use estimator::Localization;
use evaluation::trajectory::{StateKind, states, tum};
use onboard::{Outcome, run_robot};
use std::path::Path;
use tests::robot::{arguments, assert_every_frame_has_a_state, run};
use tests::scenario::MappedScenario;
use tests::server::Client;
use tools::in_process::{LocalServer, load_map};

/// Position error (RMS) that a robot may have in G in this scenario, metres. The map's poses are off by 0.1 m an axis.
const BOUND_M: f64 = 0.15;
/// The same of its rotation, degrees. The map's poses are off by 0.9 degrees an axis.
const BOUND_DEG: f64 = 0.5;
/// Position error of odometry alone after alignment in yaw and position, metres, over 88 m.
const BOUND_ODOMETRY_M: f64 = 0.5;
/// NEES per degree of freedom that one run may have, whose errors are correlated all along.
const PLAUSIBLE_NEES: std::ops::Range<f64> = 0.1..4.0;

/// The robot initialized in the map early, is accurate and consistent, and is localized at the end.
fn check_localized(outcome: &Outcome) {
    let summary = &outcome.summary;
    let status = summary.final_status.as_ref().unwrap();
    assert_eq!(status.localization, Localization::Localized, "{}", status.reason);
    assert!(summary.queries.sent > 30 && summary.queries.failed == 0, "{:?}", summary.queries);
    assert!(summary.queries.accepted * 10 > summary.queries.sent * 8, "{:?}", summary.queries);
    let score = summary.score.as_ref().unwrap();
    assert!(score.map_initialization_s.unwrap() < 3.0, "{:?}", score.map_initialization_s);
    let pose = score.pose.as_ref().unwrap();
    assert!(pose.samples > 200 && pose.rmse_m < BOUND_M && pose.rmse_deg < BOUND_DEG, "{pose:?}");
    assert!(PLAUSIBLE_NEES.contains(&pose.nees_pose.unwrap()), "{pose:?}");
    assert!(PLAUSIBLE_NEES.contains(&score.local.nees_pose.unwrap()), "{:?}", score.local);
    assert!(score.local.rmse_m < 2.0 * BOUND_M, "{:?}", score.local);
}

/// Every file of the output folder exists, can be read, and agrees with the run.
fn check_files(folder: &Path, outcome: &Outcome, with_map: bool) {
    let read = states::read(&folder.join("states.csv")).unwrap();
    assert_eq!(read.len(), outcome.summary.frames);
    for (name, kind) in [
        ("odometry.tum", StateKind::LocalFromImu),
        ("pose.tum", StateKind::GlobalFromImu),
        ("transform.tum", StateKind::GlobalFromLocal),
    ] {
        let expected: Vec<_> =
            read.iter().filter_map(|row| Some((row.stamp_ns, row.get(kind)?.pose))).collect();
        let path = folder.join(name);
        if expected.is_empty() {
            assert!(!with_map && path.is_file(), "{name}");
            continue;
        }
        let poses = tum::read(&path).unwrap();
        assert_eq!(poses.len(), expected.len(), "{name}");
        for (pose, (stamp_ns, wanted)) in poses.iter().zip(&expected) {
            assert_eq!(pose.stamp_ns, *stamp_ns, "{name}");
            assert!(pose.pose.local(wanted).amax() < 1e-6, "{name}");
        }
        let covered = read.iter().filter(|row| row.get(kind).is_some()).count();
        assert_eq!(covered, expected.len(), "{name}");
    }

    let mut events = csv::Reader::from_path(folder.join("events.csv")).unwrap();
    let rows: Vec<csv::StringRecord> = events.records().collect::<Result<_, _>>().unwrap();
    let queries = &outcome.summary.queries;
    assert_eq!(rows.len() as u64, queries.answered + queries.failed);
    if with_map {
        let columns = events.headers().unwrap().clone();
        let column = columns.iter().position(|column| column == "accepted").unwrap();
        let accepted = rows.iter().filter(|row| &row[column] == "true").count() as u64;
        assert_eq!(accepted, outcome.summary.queries.accepted);
    }

    let text = std::fs::read_to_string(folder.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(summary["frames"], read.len());
    assert_eq!(summary["map"].is_string(), with_map);
    assert_eq!(summary["score"]["pose"]["rmse_m"].is_f64(), with_map);
    assert!(summary["score"]["local"]["nees_pose"].is_f64());
    let on_wire = summary["wire_bytes"]["received"].as_u64().unwrap();
    assert_eq!(on_wire > 0, with_map);
}

#[test]
fn a_robot_localizes_in_a_map_that_was_built_stored_and_served() {
    let scenario = MappedScenario::shared();
    let folder = tempfile::tempdir().unwrap();
    let map = load_map(&scenario.database(folder.path())).unwrap();
    let server = LocalServer::start(vec![("ring".to_owned(), map)]).unwrap();
    let client = Client::connect(server.endpoint());
    let mut errors = Vec::new();
    for mode in ["single", "multi"] {
        let out = folder.path().join(mode);
        let outcome =
            run(&scenario.recordings.live, &out, &format!("--mode {mode}"), Some(client.link("ring")));
        assert_every_frame_has_a_state(&outcome, &scenario.recordings.live);
        check_localized(&outcome);
        check_files(&out, &outcome, true);
        errors.push(outcome.summary.score.unwrap().pose.unwrap().rmse_m);
    }
    assert!((errors[0] - errors[1]).abs() > 1e-6, "single and multi did the same");
    client.close();
    server.stop().unwrap();
}

#[test]
fn one_camera_and_a_start_in_motion_will_do() {
    let scenario = MappedScenario::shared();
    let folder = tempfile::tempdir().unwrap();
    let server = LocalServer::start(vec![("ring".to_owned(), scenario.loaded())]).unwrap();
    let client = Client::connect(server.endpoint());
    // From the middle of the run on: there is no rest to start from.
    let mut late = scenario.recordings.live.clone();
    let begin_ns = late.frames[late.frames.len() / 2].stamp_ns;
    late.imu_samples.retain(|sample| sample.stamp_ns >= begin_ns);
    late.frames.retain(|frame| frame.stamp_ns >= begin_ns);
    late.groundtruth.as_mut().unwrap().retain(|row| row.stamp_ns >= begin_ns);
    let refused =
        run_robot(&late, &arguments(folder.path(), "--init static"), Some(client.link("ring")), |_| {});
    assert!(refused.unwrap_err().to_string().contains("--init static"));
    let outcome = run(&late, folder.path(), "--cameras mono --init truth", Some(client.link("ring")));
    let status = outcome.summary.final_status.unwrap();
    assert_eq!(status.localization, Localization::Localized, "{}", status.reason);
    let pose = outcome.summary.score.unwrap().pose.unwrap();
    assert!(pose.rmse_m < 2.0 * BOUND_M && pose.rmse_deg < 2.0 * BOUND_DEG, "{pose:?}");
    client.close();
    server.stop().unwrap();
}

#[test]
fn odometry_needs_neither_server_nor_map() {
    let scenario = MappedScenario::shared();
    let folder = tempfile::tempdir().unwrap();
    let outcome = run(&scenario.recordings.live, folder.path(), "--mode odometry", None);
    let summary = &outcome.summary;
    assert_every_frame_has_a_state(&outcome, &scenario.recordings.live);
    assert_eq!((summary.queries.sent, summary.keyframes_pulled), (0, 0));
    assert_eq!(summary.final_status.as_ref().unwrap().localization, Localization::OdometryOnly);
    assert!(outcome.states().unwrap().iter().all(|state| state.global_from_imu.is_none()));
    let score = summary.score.as_ref().unwrap();
    assert!(score.pose.is_none() && score.transform.is_none());
    assert!(score.odometry_yaw_aligned_m.rmse < BOUND_ODOMETRY_M, "{score:?}");
    assert!(PLAUSIBLE_NEES.contains(&score.local.nees_pose.unwrap()), "{:?}", score.local);
    check_files(folder.path(), &outcome, false);
}
