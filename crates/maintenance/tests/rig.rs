//! Sessions of a robot with a stereo pair that looks ahead and a camera that looks back: what only that camera sees is confirmed, lost
//! and learned.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use hand_in::{Candidate, Chunk, Header, SessionFrame, SessionWriter};
use maintenance::{SessionReport, Settings, log_odds, take_session};
use map::{Landmark, MapContents};
use mapping::{BuildOptions, PosePriors, build_map_from_odometry, part_shown, run_odometry};
use nalgebra::Vector3;
use sensors::Sequence;
use simulation::{ChangingPlace, Scenario, SimulationOptions};

use crate::nees::Truth;

const FIRST_NS: i64 = 1_700_000_000_000_000_000;
const DAY_NS: i64 = 86_400_000_000_000;
/// The first camera of the pair, and the one that looks back.
const FRONT: usize = 0;
const REAR: usize = 2;
/// A landmark of the map and one of the world that are this near are the same (m).
const NEAR_M: f64 = 0.1;

fn place() -> ChangingPlace {
    let options = SimulationOptions {
        scenario: Scenario::Room,
        rear_camera: true,
        depth_m: Scenario::Room.depth_m(),
        duration_s: Some(12.0),
        landmarks_per_metre: 6.0,
        repeated_texture: 0.0,
        max_tracks: 40,
        max_features: 150,
        live_feature_period_s: 0.5,
        dropout_fraction: 0.0,
        ..SimulationOptions::default()
    };
    ChangingPlace::new(&options).unwrap()
}

fn map_of(session: &mut Sequence) -> MapContents {
    let odometry = run_odometry(session, session.cameras.len(), |_, _| {}).unwrap();
    let (build, none) = (BuildOptions::default(), PosePriors::default());
    build_map_from_odometry(session, &odometry, &none, None, &build, &mut |_, _, _| {}).unwrap().0
}

/// A session as its file gives it, of a robot that asks the map about some cameras.
///
/// # Arguments
/// * `asked`: the cameras that it asks about, by the number of the image with features.
fn handed_in(session: &Sequence, asked: impl Fn(usize) -> Vec<usize>) -> Sequence {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.session");
    let header = Header {
        robot: "ada".to_owned(),
        name: "ada_1".to_owned(),
        program: "test".to_owned(),
        started_unix_s: 0,
        imu: session.imu.clone().unwrap(),
        cameras: session.cameras.clone(),
    };
    let mut images = 0;
    let mut chunk = Chunk { readings: session.imu_samples.clone(), ..Chunk::default() };
    for frame in &session.frames {
        let cameras = if frame.features.is_empty() { Vec::new() } else { asked(images) };
        images += usize::from(!frame.features.is_empty());
        let candidate = |camera: usize| Candidate { camera, features: frame.features[&camera].clone() };
        chunk.frames.push(SessionFrame {
            stamp_ns: frame.stamp_ns,
            tracks: frame.tracks.clone(),
            candidates: cameras.into_iter().map(candidate).collect(),
        });
    }
    let mut writer = SessionWriter::create(&path, &header).unwrap();
    writer.append(&chunk).unwrap();
    writer.finish().unwrap();
    read(&path)
}

fn read(path: &Path) -> Sequence {
    Sequence::open(path).unwrap()
}

fn take(map: &MapContents, session: &Sequence) -> (MapContents, SessionReport) {
    let (mut map, mut session) = (map.clone(), session.clone());
    let settings = Settings::default();
    let build = BuildOptions::default();
    let report = take_session(&mut map, &mut session, &build, &settings, &mut |_, _, _| {}).unwrap();
    map.validate().unwrap();
    assert_eq!(map.audit_sessions(), Vec::new());
    (map, report)
}

/// Whether a keyframe of a map that was built of one recording is of the rear camera: ids tell pair and single camera apart.
fn is_rear(keyframe: u64) -> bool {
    (keyframe - 1) % 2 == 1
}

/// The landmarks that only the rear camera observes, each with whether it is moved between two states of the world.
fn seen_by_rear_alone(
    map: &MapContents,
    truth: &Truth,
    [before, after]: [&ChangingPlace; 2],
) -> BTreeMap<u64, bool> {
    let mut of_front = map.clone();
    of_front.keyframes.retain(|keyframe| !is_rear(keyframe.id));
    let world_from_global = truth.global_from_world(&of_front).inverse();
    let is_of_rear = |landmark: &Landmark| landmark.observations.iter().all(|seen| is_rear(seen.keyframe));
    let of_rear = map.landmarks_in_global().filter(|(landmark, _)| is_of_rear(landmark));
    let moved = of_rear.filter_map(|(landmark, position)| {
        let position = world_from_global.transform(&position);
        let is_same = |at: &Vector3<f64>| (at - position).norm() < NEAR_M;
        let world = before.landmark_positions().zip(after.landmark_positions());
        let mut same = world.filter(|(was, _)| is_same(was));
        let (was, is) = same.next()?;
        Some((landmark.id, was != is))
    });
    moved.collect()
}

/// How many of some landmarks are more, and less, probable than new ones by what a map states.
fn confirmed_and_doubted(map: &MapContents, landmarks: impl Iterator<Item = u64>) -> [usize; 2] {
    let landmarks: BTreeSet<u64> = landmarks.collect();
    let new = log_odds(Settings::default().new_existence);
    let stated = || map.existence.iter().filter(|of| landmarks.contains(&of.landmark));
    [stated().filter(|of| of.log_odds > new).count(), stated().filter(|of| of.log_odds < new).count()]
}

#[test]
fn what_only_the_rear_camera_sees_is_confirmed_lost_and_learned() {
    let before = place();
    let mut first = before.record(1, FIRST_NS).unwrap();
    let mut truth = Truth::default();
    truth.add(&first);
    let map = map_of(&mut first);
    assert!(map.keyframes.iter().any(|keyframe| is_rear(keyframe.id)));
    let mut after = before.clone();
    after.move_landmarks(0.15, 1);
    let of_rear = seen_by_rear_alone(&map, &truth, [&before, &after]);
    let moved = || of_rear.iter().filter(|(_, moved)| **moved).map(|(id, _)| *id);
    let unmoved = || of_rear.iter().filter(|(_, moved)| !**moved).map(|(id, _)| *id);
    println!("{} landmarks of the rear camera alone, {} are moved", of_rear.len(), moved().count());

    let session = after.record(2, FIRST_NS + DAY_NS).unwrap();
    let last = map.keyframes.last().unwrap().id;
    // What a robot records that asks about the front alone says next to nothing of them.
    let (of_front, report) = take(&map, &handed_in(&session, |_| vec![FRONT]));
    println!("front: {report:.2?}");
    let said: usize = confirmed_and_doubted(&of_front, of_rear.keys().copied()).iter().sum();
    assert!(of_front.keyframes.iter().all(|keyframe| keyframe.id <= last || !is_rear(keyframe.id - last)));

    let in_turn = |image: usize| vec![[FRONT, REAR][image % 2]];
    let at_once = |_: usize| vec![FRONT, REAR];
    let ways: [&dyn Fn(usize) -> Vec<usize>; 2] = [&in_turn, &at_once];
    for asked in ways {
        let (taken, report) = take(&map, &handed_in(&session, asked));
        println!("front and rear: {report:.2?}");
        let confirmed = [confirmed_and_doubted(&taken, unmoved()), confirmed_and_doubted(&taken, moved())];
        println!(
            "confirmed and doubted of unmoved and of moved ones: {confirmed:?}, {said} by the front alone"
        );
        let [[true_seen, missed], [false_seen, lost]] = confirmed;
        assert!(true_seen > 40 && true_seen > 3 * missed, "{confirmed:?}");
        assert!(lost >= 5 && lost > 3 * false_seen, "{confirmed:?}");
        assert!(4 * said < true_seen + missed + false_seen + lost, "{said} of {confirmed:?}");
        let new = taken.keyframes.iter().filter(|keyframe| keyframe.id > last);
        assert!(new.filter(|keyframe| is_rear(keyframe.id - last)).count() > 0, "{report:?}");
    }
}

/// Large maps are worked on in the part that a session shows.
#[test]
fn the_part_of_a_map_is_found_that_the_rear_camera_alone_shows() {
    let place = place();
    let map = map_of(&mut place.record(1, FIRST_NS).unwrap());
    let session = handed_in(&place.record(2, FIRST_NS + DAY_NS).unwrap(), |_| vec![REAR]);
    let most = map.keyframes.len() / 2;
    let part = part_shown(&map, &session, most, &mut |_, _, _| {}).unwrap().keyframes;
    assert_eq!(part.len(), most);
}
