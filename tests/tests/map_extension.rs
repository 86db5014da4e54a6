//! Maps extended by further recordings: as accurate and as uncertain as they state, with ids and version kept in order.

use std::sync::Arc;
use std::time::Duration;

use estimator::Localization;
use map::contents::MapContents;
use map::store::{load_map, save_map};
use mapping::{BuildOptions, ExtendError, ExtensionReport, check_new_recording, extend_map};
use mapping::{Odometry, run_odometry};
use onboard::run_robot;
use protocol::keys;
use recognition::LoadedMap;
use sensors::Sequence;
use tests::data::recording;
use tests::map_errors::{global_from_truth, true_pose, true_poses_in, with_common_errors};
use tests::robot::arguments;
use tests::server::{Client, Server};
use tests::sessions::{ALL_TRACKS, FEW_TRACKS, build, nees, sessions, sessions_with};

type Extended = Result<(MapContents, ExtensionReport), ExtendError>;

fn extend(map: &MapContents, sequence: &mut Sequence) -> Extended {
    let odometry = run_odometry(sequence, 2, |_, _| {}).unwrap();
    extend_by(map, sequence, &odometry)
}

fn extend_by(map: &MapContents, sequence: &Sequence, odometry: &Odometry) -> Extended {
    extend_map(map, sequence, odometry, None, &BuildOptions::default(), &mut |_, _, _| {})
}

/// Builds a map of the first session and extends it by the others; with an even seed the map states common errors, as a large one.
///
/// # Returns
/// NEES and degrees of freedom after the last extension, and the mean square error of the first session's positions before
/// and after (m^2).
fn extended_nees(max_tracks: usize, seed: u64, count: usize, period_s: f64) -> (f64, f64, [f64; 2]) {
    let (mut parts, whole) = sessions_with(max_tracks, seed, count, period_s);
    let mut map = build(&mut parts[0]);
    let first = map.clone();
    let (of_first, freedom, before_m) = nees(&whole, &map, &first);
    println!(
        "seed {seed}: {} keyframes, {before_m:.4} m, NEES {:.2}",
        first.keyframes.len(),
        of_first / freedom
    );
    if seed.is_multiple_of(2) {
        map = with_common_errors(&map);
    }
    let mut result = (0.0, 0.0, [0.0; 2]);
    for part in &mut parts[1..] {
        let (extended, report) = extend(&map, part).unwrap();
        let (nees, freedom, after_m) = nees(&whole, &extended, &first);
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

fn errors_are_as_stated(
    max_tracks: usize,
    seeds: std::ops::RangeInclusive<u64>,
    count: usize,
    period_s: f64,
) {
    let (mut nees, mut freedom, mut squares) = (0.0, 0.0, [0.0; 2]);
    for seed in seeds {
        let (of_seed, freedom_of_seed, of_positions) = extended_nees(max_tracks, seed, count, period_s);
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
    errors_are_as_stated(FEW_TRACKS, 2..=2, 2, 1.2);
}

#[test]
#[ignore = "takes minutes"]
fn errors_of_five_sessions_are_as_stated() {
    errors_are_as_stated(ALL_TRACKS, 1..=6, 5, 2.4);
}

#[test]
#[ignore = "takes minutes"]
fn ten_extensions_do_not_make_a_map_overconfident() {
    let mut mean = 0.0;
    let seeds = 1..=6;
    for seed in seeds.clone() {
        let (mut parts, whole) = sessions_with(ALL_TRACKS, seed, 11, 2.4);
        let first = build(&mut parts[0]);
        let mut map = first.clone();
        for part in &mut parts[1..] {
            map = extend(&map, part).unwrap().0;
        }
        let (nees, error_m) = single(&whole, &map, &first);
        println!("seed {seed}: {} keyframes, {error_m:.4} m, NEES {nees:.2}", map.keyframes.len());
        mean += nees / seeds.clone().count() as f64;
    }
    assert!((0.4..1.5).contains(&mean), "NEES {mean}");
}

#[test]
fn what_stays_keeps_its_id_and_what_does_not_belong_is_refused() {
    let (mut parts, _) = sessions(4, 2, 1.6);
    let first = build(&mut parts[0]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("loop.db");
    let saved = save_map(&path, &first, false).unwrap();
    let stored = load_map(&path).unwrap().contents;
    let odometry = run_odometry(&mut parts[1], 2, |_, _| {}).unwrap();
    let (extended, report) = extend_by(&stored, &parts[1], &odometry).unwrap();
    let again = save_map(&path, &extended, true).unwrap();
    assert_eq!((saved.version, again.version), (1, 2));
    assert_eq!(saved.identity, again.identity);

    for (before, after) in stored.keyframes.iter().zip(&extended.keyframes) {
        assert_eq!((before.id, before.stamp_ns), (after.id, after.stamp_ns));
    }
    assert_eq!(extended.keyframes.len(), stored.keyframes.len() + report.new_keyframes);
    let last = stored.keyframes.last().unwrap().id;
    let mut seen_again = 0;
    for (before, after) in stored.landmarks.iter().zip(&extended.landmarks) {
        assert_eq!((before.id, before.anchor), (after.id, after.anchor));
        let kept: Vec<_> = after.observations.iter().filter(|seen| seen.keyframe <= last).collect();
        assert!(kept.iter().copied().eq(&before.observations), "landmark {}", before.id);
        seen_again += after.observations.len() - kept.len();
    }
    assert!(seen_again > 100 && report.landmarks_seen_again > 50, "{report:?}");

    assert!(extended.audit_sessions().is_empty());
    let ledger = &extended.info.sessions;
    assert_eq!((ledger.len(), ledger[1].keyframes as usize), (2, report.new_keyframes));
    assert_eq!(ledger[1].seen_again as usize, seen_again);
    parts[1].root = "another/name".into();
    let twice = extend_by(&extended, &parts[1], &odometry).unwrap_err();
    assert!(matches!(&twice, ExtendError::SessionInMap(_)), "{twice}");
    assert!(twice.to_string().contains("\"name\" is the recording of session"), "{twice}");
    let mut without_ledger = extended.clone();
    without_ledger.info.sessions.clear();
    let twice = extend_by(&without_ledger, &parts[1], &odometry).unwrap_err();
    assert!(matches!(twice, ExtendError::AlreadyInMap { keyframe, .. } if keyframe > last), "{twice}");
    let mut piece = parts[1].clone();
    piece.frames.drain(..piece.frames.len() / 2);
    let piece = check_new_recording(&extended.info, &piece, &BuildOptions::default()).unwrap_err();
    assert!(piece.to_string().contains("has readings of the IMU of session"), "{piece}");
    let mut elsewhere = sessions(5, 1, 1.6).0.remove(0);
    let day_ns = 86_400_000_000_000;
    elsewhere.frames.iter_mut().for_each(|frame| frame.stamp_ns += day_ns);
    elsewhere.imu_samples.iter_mut().for_each(|reading| reading.stamp_ns += day_ns);
    let apart = extend(&stored, &mut elsewhere).unwrap_err();
    assert!(matches!(apart, ExtendError::NotConnected { agreeing: 0..3, .. }), "{apart}");
    let mut leaning = stored;
    leaning.info.gravity_in_global = None;
    let unknown = extend_by(&leaning, &parts[1], &odometry).unwrap_err().to_string();
    assert!(unknown.contains("--gravity") && unknown.contains("unknown"), "{unknown}");
}

/// Frame before which the served map is replaced.
const EXTENDED: usize = 200;

#[test]
fn a_robot_stays_localized_while_its_map_is_extended() {
    let (mut parts, whole) = sessions(6, 3, 1.2);
    let mut first = build(&mut parts[0]);
    first.info.identity = Some(first.digest());
    let (mut second, report) = extend(&first, &mut parts[1]).unwrap();
    second.info.version = first.info.version + 1;
    assert!(report.moved_m > 0.0);
    let load = |map: &MapContents| Arc::new(LoadedMap::from_contents(map.clone()).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start("loop", load(&first));
    let client = Client::connect(server.endpoint());
    let key = keys::map_changes("loop").unwrap();
    let news = client.runtime.block_on(async { client.session.declare_subscriber(&key).await }).unwrap();

    let live = &parts[2];
    let switches = arguments(folder.path(), "--robot ada");
    let outcome = run_robot(live, &switches, Some(client.link("loop")), |frame| {
        if frame == EXTENDED {
            server.replace("loop", load(&second));
            client.runtime.block_on(async { news.recv_async().await }).unwrap();
            // The robot gets the same notice, perhaps a moment later than this subscriber.
            std::thread::sleep(Duration::from_millis(50));
        }
    })
    .unwrap();

    let changes = outcome.summary.map_changes;
    assert_eq!((changes.carried_over, changes.found_anew), (1, 0));
    let states = outcome.states().unwrap();
    let fix = states.iter().position(|state| state.global_from_imu.is_some()).unwrap();
    assert!(states[fix..].iter().all(|state| state.global_from_imu.is_some()), "the robot was lost");
    assert_eq!(outcome.summary.final_status.as_ref().unwrap().localization, Localization::Localized);
    let events = outcome.events().unwrap();
    let changed_ns = live.frames[EXTENDED].stamp_ns;
    assert!(events.iter().any(|event| event.accepted && event.stamp_ns > changed_ns), "no match afterwards");
    for stamp_ns in [live.frames[EXTENDED - 1].stamp_ns, live.frames.last().unwrap().stamp_ns] {
        let state = states.iter().find(|state| state.stamp_ns == stamp_ns).unwrap();
        let truth = global_from_truth(&whole, &first).compose(&true_pose(&whole, stamp_ns));
        let pose = state.global_from_imu.as_ref().unwrap();
        let (error, nees) = (pose.pose.local(&truth), pose.nees(&truth).unwrap());
        println!("{:.3} m, NEES {:.2}", error.fixed_rows::<3>(3).norm(), nees / 6.0);
        // Chi-square with 6 degrees of freedom, 0.1 %.
        assert!(error.fixed_rows::<3>(3).norm() < 0.5 && nees < 22.5, "{error} {nees}");
    }
    client.close();
    server.stop();
}

/// Mean NEES of single keyframes, and their error (m).
///
/// # Arguments
/// * `first`: the map that defines the frame.
fn single(whole: &Sequence, map: &MapContents, first: &MapContents) -> (f64, f64) {
    let truth = true_poses_in(&global_from_truth(whole, first), whole, map);
    let poses = || map.keyframes.iter().zip(&truth);
    let count = map.keyframes.len() as f64;
    let nees = poses().map(|(keyframe, truth)| keyframe.global_from_keyframe.nees(truth).unwrap() / 6.0);
    let squares = poses().map(|(keyframe, truth)| {
        (keyframe.global_from_keyframe.pose.translation - truth.translation).norm_squared()
    });
    (nees.sum::<f64>() / count, (squares.sum::<f64>() / count).sqrt())
}

#[test]
#[ignore = "needs the recordings in target/data"]
fn a_recorded_map_is_extended_by_another_flight() {
    let open = |name: &str| Sequence::open(&recording(name)).unwrap();
    let [mut first, mut second] = ["odometry/MH_01_easy", "odometry/MH_03_medium"].map(open);
    let map = build(&mut first);
    let (extended, report) = extend(&map, &mut second).unwrap();
    let mut whole = first;
    whole.groundtruth.as_mut().unwrap().extend(second.groundtruth.unwrap());
    whole.groundtruth.as_mut().unwrap().sort_by_key(|row| row.stamp_ns);
    let [(nees_before, before_m), (nees_after, after_m)] =
        [&map, &extended].map(|extended| single(&whole, extended, &map));
    println!("{report:?}");
    println!("{before_m:.4} m, NEES {nees_before:.2}; extended: {after_m:.4} m, NEES {nees_after:.2}");
    assert!(report.agreeing_places > 50, "{report:?}");
    assert!(after_m < 0.02 && (0.1..2.0).contains(&nees_after), "{after_m} m, NEES {nees_after}");
}
