//! A robot drives while its map becomes one release after the other, as sessions of a place that changes make them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use estimator::Localization;
use evaluation::trajectory::StateRow;
use evaluation::{Alignment, align};
use geometry::Pose;
use maintenance::{Settings, take_session};
use map::MapContents;
use mapping::{BuildOptions, PosePriors, build_map_from_odometry, run_odometry};
use nalgebra::Vector3;
use onboard::run_robot;
use protocol::keys;
use recognition::LoadedMap;
use sensors::Sequence;
use simulation::{ChangingPlace, Scenario, SimulationOptions};
use tests::robot::{arguments, assert_every_frame_has_a_state};
use tests::server::{Client, Server};

const FIRST_NS: i64 = 1_700_000_000_000_000_000;
const DAY_NS: i64 = 86_400_000_000_000;
/// Part of the landmarks that are moved until the last release.
const MOVED: f64 = 0.3;
/// With 6 degrees of freedom as likely as 3 sigma with one.
const THREE_SIGMAS: f64 = 20.06;

fn options(seed: u64) -> SimulationOptions {
    SimulationOptions {
        seed,
        scenario: Scenario::Room,
        depth_m: Scenario::Room.depth_m(),
        duration_s: Some(24.0),
        landmarks_per_metre: 6.0,
        repeated_texture: 0.0,
        max_tracks: 60,
        max_features: 150,
        live_feature_period_s: 0.5,
        dropout_fraction: 0.0,
        ..SimulationOptions::default()
    }
}

/// The first release and those that the sessions of the following days make of it, and the place as it is then.
fn releases(seed: u64, count: usize) -> (Vec<MapContents>, ChangingPlace, Pose) {
    let mut place = ChangingPlace::new(&options(seed)).unwrap();
    let mut first = place.record(1, FIRST_NS).unwrap();
    let odometry = run_odometry(&mut first, 2, |_, _| {}).unwrap();
    let (build, none) = (BuildOptions::default(), PosePriors::default());
    let mut map =
        build_map_from_odometry(&first, &odometry, &none, None, &build, &mut |_, _, _| {}).unwrap().0;
    let global_from_world = global_from_world(&map, &first);
    map.info.version = 1;
    map.info.identity = Some(map.digest());
    let mut releases = vec![map];
    for day in 1..count {
        place.move_landmarks(1.0 - (1.0 - MOVED).powf(1.0 / (count - 1) as f64), day as u64);
        let mut session = place.record(1 + day as u64, FIRST_NS + DAY_NS * day as i64).unwrap();
        let mut map = releases[day - 1].clone();
        take_session(&mut map, &mut session, &build, &Settings::default(), &mut |_, _, _| {}).unwrap();
        map.info.version += 1;
        releases.push(map);
    }
    (releases, place, global_from_world)
}

/// From the world to the frame of a map, which its keyframes define.
fn global_from_world(map: &MapContents, recording: &Sequence) -> Pose {
    let imu_from_camera = recording.cameras[0].imu_from_camera;
    let rows = recording.groundtruth.iter().flatten();
    let truth: BTreeMap<i64, Pose> =
        rows.map(|row| (row.stamp_ns, row.pose.compose(&imu_from_camera))).collect();
    let pairs = map.keyframes.iter().map(|keyframe| {
        (keyframe.global_from_keyframe.pose.translation, truth[&keyframe.stamp_ns].translation)
    });
    let gravity = -Vector3::z();
    let yaw = Alignment::Yaw { gravity_in_reference: gravity, gravity_in_estimate: gravity };
    align(&pairs.collect::<Vec<_>>(), &yaw).unwrap()
}

/// A drive through so many releases, evenly. More than 8 notices in one drive of a minute would be taken for an attack.
///
/// # Returns
/// Mean NEES of the pose over 6.
fn drive(seed: u64, count: usize) -> f64 {
    let (releases, place, global_from_world) = releases(seed, count);
    let live = place.record(1000, FIRST_NS + 2 * count as i64 * DAY_NS).unwrap();
    let load = |map: &MapContents| Arc::new(LoadedMap::from_contents(map.clone()).unwrap());
    let loaded: Vec<Arc<LoadedMap>> = releases.iter().map(load).collect();
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start("room", Arc::clone(&loaded[0]));
    let client = Client::connect(server.endpoint());
    let key = keys::map_changes("room").unwrap();
    let news = client.runtime.block_on(async { client.session.declare_subscriber(&key).await }).unwrap();
    let step = live.frames.len() / count;
    let switches = arguments(folder.path(), "--robot ada");
    let outcome = run_robot(&live, &switches, Some(client.link("room")), |frame| {
        // A recording is read faster than a robot drives: what changed takes its time to come.
        std::thread::sleep(Duration::from_millis(5));
        let is_next = frame > 0 && frame.is_multiple_of(step);
        let Some(next) = loaded.get(frame / step).filter(|_| is_next) else { return };
        server.replace("room", Arc::clone(next));
        // The robot gets the same notification, perhaps a moment later than this subscriber.
        client.runtime.block_on(async { news.recv_async().await }).unwrap();
        std::thread::sleep(Duration::from_millis(50));
    })
    .unwrap();
    client.close();
    server.stop();

    assert_every_frame_has_a_state(&outcome, &live);
    let changes = outcome.summary.map_changes;
    assert_eq!((changes.carried_over, changes.found_anew), (count as u64 - 1, 0));
    let states = outcome.states().unwrap();
    let fix = states.iter().position(|state| state.global_from_imu.is_some()).unwrap();
    assert!(states[fix].stamp_ns - live.frames[0].stamp_ns < 3_000_000_000, "{fix}");
    let localized = &states[fix..];
    assert!(localized.iter().all(|state| state.global_from_imu.is_some()), "the robot was lost");
    assert_eq!(outcome.summary.final_status.as_ref().unwrap().localization, Localization::Localized);

    let truth = live.groundtruth.as_ref().unwrap();
    let error = |state: &StateRow| {
        let row = truth.iter().min_by_key(|row| (row.stamp_ns - state.stamp_ns).abs()).unwrap();
        let pose = state.global_from_imu.as_ref().unwrap();
        (pose.pose.local(&(global_from_world * row.pose)), pose.covariance)
    };
    let mut largest = 0.0_f64;
    for pair in localized.windows(2) {
        let ((before, covariance), (now, _)) = (error(&pair[0]), error(&pair[1]));
        let jump = now - before;
        largest = largest.max(jump.dot(&covariance.cholesky().unwrap().solve(&jump)));
    }
    assert!(largest < THREE_SIGMAS, "a jump of {largest:.1} over 6");

    let (mut nees, mut squares) = (0.0, 0.0);
    for (error, covariance) in localized.iter().map(error) {
        nees += error.dot(&covariance.cholesky().unwrap().solve(&error)) / 6.0;
        squares += error.fixed_rows::<3>(3).norm_squared();
    }
    let frames = localized.len() as f64;
    let accepted = outcome.events().unwrap().iter().filter(|event| event.accepted).count();
    println!(
        "seed {seed}: {count} releases, {} keyframes in the last, {accepted} answers used, NEES {:.2}, {:.4} m, largest jump {largest:.1} \
         over 6",
        releases[count - 1].keyframes.len(),
        nees / frames,
        f64::sqrt(squares / frames)
    );
    assert!(accepted > 2 * count, "{accepted}");
    nees / frames
}

#[test]
#[ignore = "takes two minutes"]
fn robots_drive_through_nine_releases_of_places_that_change() {
    const SEEDS: u64 = 5;
    let mean = (1..=SEEDS).map(|seed| drive(seed, 9)).sum::<f64>() / SEEDS as f64;
    println!("NEES {mean:.2}");
    assert!(mean < 1.5, "{mean}");
}
