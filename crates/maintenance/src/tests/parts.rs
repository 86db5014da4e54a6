//! A session that is worked into a part of a map, and into the map as a whole.

use std::collections::{BTreeMap, BTreeSet};

use map::MapContents;
use mapping::{BuildOptions, PosePriors, build_map_from_odometry, part_shown, run_odometry};
use protocol::LandmarkId;
use sensors::Sequence;
use simulation::{ChangingPlace, Scenario, SimulationOptions};
use testing::add_second_kind;

use super::halls::halls;
use super::{DAY_NS, FIRST_NS};
use crate::report::SessionReport;
use crate::session::{PartSizes, take_session_by_parts};
use crate::settings::Settings;

/// A room that robots come to again and again.
fn room() -> ChangingPlace {
    let options = SimulationOptions {
        scenario: Scenario::Room,
        depth_m: Scenario::Room.depth_m(),
        duration_s: Some(12.0),
        landmarks_per_metre: 6.0,
        max_features: 150,
        dropout_fraction: 0.0,
        ..SimulationOptions::default()
    };
    ChangingPlace::new(&options).unwrap()
}

/// A map of the first session in a room.
fn map_of(room: &ChangingPlace) -> MapContents {
    let mut first = room.record(1, FIRST_NS).unwrap();
    let odometry = run_odometry(&mut first, 2, |_, _| {}).unwrap();
    let (build, none) = (BuildOptions::default(), PosePriors::default());
    build_map_from_odometry(&first, &odometry, &none, None, &build, &mut |_, _, _| {}).unwrap().0
}

/// Works a session into a map, with parts of so many keyframes.
fn taken(
    map: &MapContents,
    session: &Sequence,
    settings: &Settings,
    sizes: PartSizes,
) -> (MapContents, SessionReport) {
    let (mut map, mut session) = (map.clone(), session.clone());
    let build = BuildOptions::default();
    let report =
        take_session_by_parts(&mut map, &mut session, &build, settings, sizes, &mut |_, _, _| {}).unwrap();
    map.validate().unwrap();
    assert_eq!(map.audit_sessions(), Vec::new());
    (map, report)
}

fn in_parts_of(keyframes: usize) -> PartSizes {
    PartSizes { large: 0, keyframes: [keyframes; 2] }
}

const AS_A_WHOLE: PartSizes = PartSizes { large: usize::MAX, keyframes: [0; 2] };

#[test]
fn a_part_that_is_the_whole_map_gives_the_same_map() {
    let mut room = room();
    let mut map = map_of(&room);
    add_second_kind(&mut map, "other-1");
    room.move_landmarks(0.1, 1);
    let session = room.record(2, FIRST_NS + DAY_NS).unwrap();
    let settings = Settings::default();
    let [(whole, of_whole), (by_parts, of_parts)] =
        [AS_A_WHOLE, in_parts_of(300)].map(|sizes| taken(&map, &session, &settings, sizes));
    assert!(of_whole.kept_keyframes > 0 && of_whole.seen > 50, "{of_whole:?}");
    let counts = |map: &MapContents| (map.keyframes.len(), map.landmarks.len(), map.observation_count());
    assert_eq!(counts(&by_parts), counts(&whole));
    assert_eq!((of_parts.keyframes, of_parts.landmarks), (of_whole.keyframes, of_whole.landmarks));
    // What is worked on as a whole has its covariances stated anew, with a lower bound added.
    for (a, b) in by_parts.keyframes.iter().zip(&whole.keyframes) {
        let [a, b] = [a, b].map(|keyframe| (keyframe.id, keyframe.global_from_keyframe));
        assert_eq!((a.0, a.1.pose), (b.0, b.1.pose));
        assert!((a.1.covariance - b.1.covariance).amax() < 3e-10, "{} {}", a.1.covariance, b.1.covariance);
    }
    // Of added kinds everything is where it was, with ids beyond the new ones.
    assert_eq!(by_parts.added_features[0].landmarks.len(), whole.added_features[0].landmarks.len());
    let pixels = |map: &MapContents| -> BTreeMap<_, _> {
        let landmarks = map.added_features.iter().flat_map(|added| &added.landmarks);
        let seen =
            landmarks.flat_map(|landmark| landmark.observations.iter().map(move |seen| (landmark, seen)));
        seen.map(|(landmark, seen)| ((seen.keyframe, seen.pixel.map(f32::to_bits)), landmark.clone()))
            .collect()
    };
    let before = pixels(&map);
    for map in [&by_parts, &whole] {
        let after = pixels(map);
        assert!(after.len() > 100 && after.len() <= before.len(), "{} of {}", after.len(), before.len());
        for (seen, landmark) in after {
            let was = &before[&seen];
            assert!(was.anchor != landmark.anchor || was.position_in_anchor == landmark.position_in_anchor);
        }
    }
    assert_eq!(by_parts.existence, whole.existence);
    for (a, b) in by_parts.landmarks_in_global().zip(whole.landmarks_in_global()) {
        assert!(a.0.id == b.0.id && (a.1 - b.1).norm() < 1e-8);
    }
    let pairs = by_parts.cross_covariances.iter().zip(&whole.cross_covariances);
    assert_eq!(by_parts.cross_covariances.len(), whole.cross_covariances.len());
    for (a, b) in pairs {
        assert_eq!((a.a, a.b), (b.a, b.b));
        assert!((a.block - b.block).amax() < 3e-10, "{} {}", a.block, b.block);
    }
    // Places that look alike are searched in all of the map.
    assert_eq!(by_parts.aliases.len(), by_parts.keyframes.len());
}

/// Settings with which a place keeps few landmarks.
fn few_landmarks() -> Settings {
    let mut settings = Settings::default();
    settings.landmarks_a_place = 40;
    settings
}

/// The new landmarks of the hall that a session came to have ids, before they are put back, that landmarks of other halls have.
#[test]
fn a_hall_that_no_session_came_to_stays_as_it_is() {
    let room = room();
    let hall = map_of(&room);
    let count = hall.keyframes.len();
    let session = room.record(2, FIRST_NS + DAY_NS).unwrap();
    for has_ledger in [true, false] {
        let mut before = halls(&hall, 3);
        if !has_ledger {
            before.info.sessions.clear();
        }
        let (after, report) = taken(&before, &session, &few_landmarks(), in_parts_of(count));
        assert!(report.surplus_landmarks > 50 && report.kept_keyframes > 0, "{report:?}");
        let elsewhere = &before.keyframes[count..];
        let last = after.keyframes.len() - report.kept_keyframes;
        assert_eq!(after.keyframes[last - elsewhere.len()..last], *elsewhere);
        let of_halls = |map: &MapContents| {
            let ids = elsewhere[0].id..=elsewhere[elsewhere.len() - 1].id;
            let landmarks = map.landmarks.iter().filter(|landmark| ids.contains(&landmark.anchor));
            landmarks.cloned().collect::<Vec<_>>()
        };
        let [was, is] = [&before, &after].map(of_halls);
        let lost = was.iter().filter(|landmark| !is.contains(landmark)).count();
        assert!(was == is, "with a ledger: {has_ledger}; {lost} of {} are not as they were", was.len());
    }
}

#[test]
fn what_keyframes_beyond_the_border_of_a_part_show_is_not_thinned() {
    let room = room();
    let before = map_of(&room);
    let session = room.record(2, FIRST_NS + DAY_NS).unwrap();
    let most = before.keyframes.len() / 2;
    let part = part_shown(&before, &session, most, &mut |_, _, _| {}).unwrap();
    let (after, report) = taken(&before, &session, &few_landmarks(), in_parts_of(most));
    assert!(report.surplus_landmarks > 10 && report.gone_m.is_empty(), "{report:?}");
    let shown_beyond: BTreeSet<LandmarkId> = before
        .landmarks
        .iter()
        .filter(|landmark| landmark.observations.iter().any(|seen| !part.contains(&seen.keyframe)))
        .map(|landmark| landmark.id)
        .collect();
    let left: BTreeSet<LandmarkId> = after.landmarks.iter().map(|landmark| landmark.id).collect();
    let lost: Vec<&LandmarkId> = shown_beyond.difference(&left).collect();
    assert!(shown_beyond.len() > 100 && lost.is_empty(), "{} of {} are lost", lost.len(), shown_beyond.len());
}
