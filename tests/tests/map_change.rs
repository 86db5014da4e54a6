//! Changes of the served map while robots use it, over a network. How uncertain their poses are afterwards is tested by `simulation`.

use estimator::Localization;
use geometry::{Pose, rotation};
use map::contents::MapContents;
use nalgebra::Vector3;
use onboard::run_robot;
use protocol::keys;
use recognition::LoadedMap;
use std::sync::Arc;
use std::time::Duration;
use tests::robot::{arguments, assert_every_frame_has_a_state};
use tests::scenario::MappedScenario;
use tests::server::{Client, Server};

/// The next version of a map, moved as a whole.
fn moved(mut map: MapContents, new_from_old: &Pose) -> MapContents {
    map.info.version += 1;
    for keyframe in &mut map.keyframes {
        let pose = &mut keyframe.global_from_keyframe.pose;
        *pose = *new_from_old * *pose;
    }
    map
}

/// The next version of a map, with new ids, so that its motion cannot be computed.
fn renamed(mut map: MapContents) -> MapContents {
    const BY: u64 = 10_000;
    map.info.version += 1;
    map.keyframes.iter_mut().for_each(|keyframe| keyframe.id += BY);
    map.info
        .sessions
        .iter_mut()
        .for_each(|session| session.keyframe_ids = session.keyframe_ids.map(|id| id + BY));
    for landmark in &mut map.landmarks {
        landmark.anchor += BY;
        landmark.observations.iter_mut().for_each(|seen| seen.keyframe += BY);
    }
    for cross in &mut map.cross_covariances {
        (cross.a, cross.b) = (cross.a + BY, cross.b + BY);
    }
    for aliases in &mut map.aliases {
        aliases.keyframe += BY;
        aliases.places.iter_mut().for_each(|place| place.keyframe += BY);
    }
    map
}

/// Frames before which an invalid notification comes, the map moves, and it becomes another map.
const NONSENSE: usize = 60;
const MOVES: usize = 120;
const IS_ANOTHER: usize = 180;

#[test]
fn a_robot_follows_changes_of_the_map_and_stays_localized() {
    let scenario = MappedScenario::shared();
    let live = &scenario.recordings.live;
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start("ring", scenario.loaded());
    let client = Client::connect(server.endpoint());
    let key = keys::map_changes("ring").unwrap();
    let news = client.runtime.block_on(async { client.session.declare_subscriber(&key).await }).unwrap();
    // About gravity, so that the map's gravity remains valid.
    let moves = [
        Pose::new(rotation::exp(&Vector3::new(0.0, 0.0, 0.02)), Vector3::new(0.2, -0.3, 0.1)),
        Pose::new(rotation::exp(&Vector3::new(0.0, 0.0, -1.0)), Vector3::new(40.0, 5.0, -7.0)),
    ];
    let second = moved(scenario.map.clone(), &moves[0]);
    let third = renamed(moved(second.clone(), &moves[1]));
    let load = |map: &MapContents| Arc::new(LoadedMap::from_contents(map.clone()).unwrap());
    // The robot gets the same notification, perhaps a moment later than this subscriber.
    let heard = || {
        client.runtime.block_on(async { news.recv_async().await }).unwrap();
        std::thread::sleep(Duration::from_millis(50));
    };

    let switches = arguments(folder.path(), "--robot ada");
    let outcome = run_robot(live, &switches, Some(client.link("ring")), |frame| match frame {
        NONSENSE => {
            client.runtime.block_on(async { client.session.put(&key, "nonsense").await }).unwrap();
            heard();
        }
        MOVES => {
            server.replace("ring", load(&second));
            heard();
        }
        IS_ANOTHER => {
            server.replace("ring", load(&third));
            heard();
        }
        _ => {}
    })
    .unwrap();

    assert_every_frame_has_a_state(&outcome, live);
    let changes = outcome.summary.map_changes;
    assert_eq!((changes.carried_over, changes.found_anew), (1, 1));
    let states = outcome.states().unwrap();
    let fix = states.iter().position(|state| state.global_from_imu.is_some()).unwrap();
    assert!(states[fix..].iter().all(|state| state.global_from_imu.is_some()), "the robot was lost");
    assert_eq!(outcome.summary.final_status.as_ref().unwrap().localization, Localization::Localized);

    let events = outcome.events().unwrap();
    let stamp = |frame: usize| live.frames[frame].stamp_ns;
    let accepted = |from: usize, to: usize| {
        let stamps = stamp(from)..stamp(to);
        let of = events.iter().filter(|event| event.accepted && stamps.contains(&event.stamp_ns));
        of.count()
    };
    let last = live.frames.len() - 1;
    assert!(accepted(0, MOVES) > 5 && accepted(MOVES, IS_ANOTHER) > 5 && accepted(IS_ANOTHER, last) > 5);

    // Before each change, and at the end: the pose is in the frame of the map's version at that time.
    let truth = live.groundtruth.as_ref().unwrap();
    let in_version = [Pose::identity(), moves[0], moves[1] * moves[0]];
    for (frame, new_from_old) in
        [(MOVES - 1, in_version[0]), (IS_ANOTHER - 1, in_version[1]), (last, in_version[2])]
    {
        let state = states.iter().find(|state| state.stamp_ns == stamp(frame)).unwrap();
        let row = truth.iter().min_by_key(|row| (row.stamp_ns - state.stamp_ns).abs()).unwrap();
        let pose = state.global_from_imu.as_ref().unwrap();
        let error = pose.pose.local(&(new_from_old * row.pose));
        let (turn, shift) = (error.fixed_rows::<3>(0).norm(), error.fixed_rows::<3>(3).norm());
        println!(
            "frame {frame}: {turn:.4} rad, {shift:.3} m, NEES {:?}",
            pose.nees(&(new_from_old * row.pose))
        );
        assert!(turn < 0.02 && shift < 0.15, "frame {frame}: {turn} rad, {shift} m");
    }
    // The change did not cause a jump: the pose's covariance was inflated with the notification.
    let index = states.iter().position(|state| state.stamp_ns == stamp(MOVES)).unwrap();
    for pair in states[index..index + 40].windows(2) {
        let [before, now] = [&pair[0], &pair[1]].map(|state| state.global_from_imu.as_ref().unwrap());
        let way = pair[0].local_from_imu.pose.inverse() * pair[1].local_from_imu.pose;
        let squared = before.nees(&(now.pose * way.inverse())).unwrap();
        assert!(squared < 20.06, "a jump of {squared:.1} over 6 at {}", pair[1].stamp_ns);
    }
    client.close();
    server.stop();
}
