//! The ledger of sessions: what is stored is true, and what is not true is found.

use map::model::{Keyframe, MAX_ID};
use map::sessions::{LedgerProblem, RecordedDigest, Session, SessionDifference, SharedReadings};
use map::{MapContents, edit, store};
use proptest::prelude::*;
use testing::{Place, PlaceOptions};

/// A session with readings of some seconds, by 200 a second, and the ids of its keyframes.
fn session(name: &str, seconds: std::ops::Range<i64>, keyframe_ids: [u64; 2]) -> Session {
    let mut digest = RecordedDigest::default();
    for at in 200 * seconds.start..200 * seconds.end {
        digest.add_reading(at * 5_000_000, [at as f64 * 1e-3, 0.1, 0.2, 0.3, 0.4, 9.8]);
    }
    seconds.for_each(|second| digest.add_image(second * 1_000_000_000));
    Session { keyframe_ids, ..Session::new(digest.finish(), name) }
}

/// A map of two drives, with half of its keyframes each.
fn two_drives() -> MapContents {
    let options = PlaceOptions { keyframes: 10, landmarks: 200, ..PlaceOptions::default() };
    let mut map = Place::new(&options).map;
    map.sort();
    let ids: Vec<u64> = map.keyframes.iter().map(|keyframe| keyframe.id).collect();
    map.info.sessions =
        vec![session("monday", 0..60, [ids[0], ids[4]]), session("tuesday", 100..160, [ids[5], ids[9]])];
    map
}

fn stored(map: &MapContents) -> MapContents {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.db");
    store::save_map(&path, map, false).unwrap();
    store::load_map(&path).unwrap().contents
}

#[test]
fn what_is_stored_is_true_also_after_an_edit() {
    let map = stored(&two_drives());
    assert!(map.audit_sessions().is_empty());
    let [monday, tuesday] = [0, 1].map(|at| map.info.sessions[at].clone());
    assert_eq!((monday.keyframes, tuesday.keyframes), (5, 5));
    assert_eq!((monday.observations + tuesday.observations) as usize, map.observation_count());
    assert!(monday.added_unix_s.is_some() && monday.seen_again + tuesday.seen_again > 0);
    let mut edited = map.clone();
    let of_tuesday = |keyframe: &Keyframe| tuesday.ids().contains(&keyframe.id);
    let removed = edit::keyframes_where(&edited, of_tuesday);
    edit::remove_keyframes(&mut edited, &removed);
    assert!(!edited.audit_sessions().is_empty(), "the counts are those from before");
    let mut part = edited.clone();
    part.take_sessions_of(&map.info);
    assert_eq!((part.info.sessions.len(), part.info.sessions[0].id), (1, monday.id));
    assert!(part.audit_sessions().is_empty());
    let edited = stored(&edited);
    assert!(edited.audit_sessions().is_empty());
    // What was learned of it is in the poses of the others, and its ids do not come again.
    let kept = &edited.info.sessions[1];
    assert_eq!((kept.id, kept.keyframes, kept.added_unix_s), (tuesday.id, 0, tuesday.added_unix_s));
    assert_eq!(edited.info.last_session_keyframe(), Some(tuesday.keyframe_ids[1]));
    assert!(SessionDifference::between(&map.info.sessions, &edited.info.sessions).is_empty());
    let difference = SessionDifference::between(&map.info.sessions, &map.info.sessions[..1]);
    assert_eq!((difference.added.len(), difference.removed[0].name.as_str()), (0, "tuesday"));
}

/// A map whose ten keyframes are of sessions that begin at some of them.
fn drives(
    seed: u64,
    begins: &std::collections::BTreeSet<usize>,
    name: &str,
    robot: Option<&str>,
) -> MapContents {
    let options = PlaceOptions { seed, keyframes: 10, landmarks: 60, ..PlaceOptions::default() };
    let mut map = Place::new(&options).map;
    map.sort();
    let ids: Vec<u64> = map.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let begins: Vec<usize> = [0].into_iter().chain(begins.iter().copied()).chain([10]).collect();
    let sessions = begins.windows(2).zip(0..).map(|(range, at)| {
        session(name, 100 * at..100 * at + 3, [ids[range[0]], ids[range[1] - 1]]).by_robot(robot)
    });
    map.info.sessions = sessions.collect();
    map
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn every_ledger_is_read_as_it_was_written_and_true_whatever_is_removed(
        seed in 0..1000_u64,
        begins in prop::collection::btree_set(1..10_usize, 0..9),
        name in any::<String>(),
        robot in prop::option::of(any::<String>()),
        removed in prop::collection::btree_set(0..10_usize, 0..9),
    ) {
        let map = drives(seed, &begins, &name, robot.as_deref());
        map.validate().unwrap();
        let text = serde_json::to_string(&map.info.sessions).unwrap();
        prop_assert_eq!(&serde_json::from_str::<Vec<Session>>(&text).unwrap(), &map.info.sessions);
        let mut map = stored(&map);
        prop_assert_eq!(map.audit_sessions(), Vec::new());
        let ids: Vec<u64> = map.keyframes.iter().map(|keyframe| keyframe.id).collect();
        edit::remove_keyframes(&mut map, &removed.iter().map(|at| ids[*at]).collect());
        let map = stored(&map);
        prop_assert_eq!(map.audit_sessions(), Vec::new());
        prop_assert_eq!(map.info.sessions.len(), begins.len() + 1);
        let counted: u64 = map.info.sessions.iter().map(|session| session.observations).sum();
        prop_assert_eq!(counted as usize, map.observation_count());
    }

    #[test]
    fn a_damaged_ledger_is_an_error(at in any::<prop::sample::Index>(), character in any::<char>()) {
        let map = drives(1, &[4].into(), "monday", Some("ada"));
        let mut text: Vec<char> = serde_json::to_string(&map.info.sessions).unwrap().chars().collect();
        let at = at.index(text.len());
        text[at] = character;
        let text: String = text.into_iter().collect();
        // Whatever can still be read is checked: ids, order of the samples, control characters.
        if let Ok(sessions) = serde_json::from_str::<Vec<Session>>(&text) {
            let mut map = map;
            map.info.sessions = sessions;
            if map.validate().is_ok() {
                prop_assert!(map.info.sessions.iter().all(|session| !session.name.contains(char::is_control)));
                stored(&map);
            }
        }
    }
}

#[test]
fn a_recording_a_piece_of_it_and_one_with_another_name_are_found_and_others_are_not() {
    let info = two_drives().info;
    let again = info.check_new_session(&session("wednesday", 100..160, [0; 2])).unwrap_err();
    assert_eq!((again.known.name.as_str(), again.shared), ("tuesday", SharedReadings::All));
    for seconds in [100..103, 120..140, 157..200, 90..110, 50..300] {
        let piece = info.check_new_session(&session("piece", seconds.clone(), [0; 2]));
        let piece = piece.unwrap_err().to_string();
        let known = if seconds.start == 50 { "monday" } else { "tuesday" };
        assert!(piece.contains("\"piece\"") && piece.contains(known), "{seconds:?}: {piece}");
    }
    // Time alone does not make two recordings the same: robots drive at the same time.
    let mut other = RecordedDigest::default();
    (20_000..32_000).for_each(|at| other.add_reading(at * 5_000_000, [0.5, 0.0, 0.0, 0.0, 0.0, 9.8]));
    (100..160).for_each(|second| other.add_image(second * 1_000_000_000));
    info.check_new_session(&Session::new(other.finish(), "another robot")).unwrap();
    info.check_new_session(&session("between", 60..100, [0; 2])).unwrap();
}

#[test]
fn a_ledger_that_is_not_true_is_named() {
    let good = stored(&two_drives());
    let first = |change: &dyn Fn(&mut MapContents)| {
        let mut map = good.clone();
        change(&mut map);
        map.audit_sessions().into_iter().next().unwrap()
    };
    let problem = first(&|map| map.info.sessions[1].keyframes += 1);
    assert!(matches!(problem, LedgerProblem::Keyframes { stated: 6, found: 5, .. }), "{problem}");
    let problem = first(&|map| map.info.sessions[1].observations -= 1);
    assert!(matches!(problem, LedgerProblem::Observations { .. }), "{problem}");
    let problem = first(&|map| map.info.sessions[0].seen_again += 1);
    assert!(matches!(problem, LedgerProblem::SeenAgain { .. }), "{problem}");
    let problem = first(&|map| {
        map.landmarks[0].observations.truncate(1);
        map.info.sessions.clear();
    });
    assert!(matches!(problem, LedgerProblem::NoSessions { keyframes: 10 }), "{problem}");
    let problem = first(&|map| {
        let [first, second] = &mut map.info.sessions[..] else { panic!("two sessions") };
        second.samples = first.samples.clone();
        second.begin_ns = first.begin_ns;
    });
    assert!(matches!(problem, LedgerProblem::Overlap(_)), "{problem}");
    let refused = |change: &dyn Fn(&mut MapContents)| {
        let mut map = good.clone();
        change(&mut map);
        map.validate().unwrap_err().to_string()
    };
    let said = refused(&|map| map.info.sessions.truncate(1));
    assert!(said.contains("belongs to no session"), "{said}");
    let said = refused(&|map| map.info.sessions[1].keyframe_ids[0] = map.info.sessions[0].keyframe_ids[1]);
    assert!(said.contains("do not follow"), "{said}");
    let said = refused(&|map| map.info.sessions[1].id = map.info.sessions[0].id);
    assert!(said.contains("listed twice"), "{said}");
    let said = refused(&|map| map.info.sessions[0].name = "a\u{1b}[2J".to_owned());
    assert!(said.contains("control characters"), "{said}");
    let said = refused(&|map| map.info.sessions[0].sigma_px = Some(0.0));
    assert!(said.contains("pixel sigma"), "{said}");
}

#[test]
fn the_noise_of_a_map_is_that_of_the_noisiest_session_that_it_has_keyframes_of() {
    let mut map = two_drives();
    map.info.sigma_px = 2.5;
    map.count_sessions();
    // Of sessions of which it is not known, it is at most that of the map.
    assert_eq!((map.info.covering_sigma_px(), map.info.first_sigma_px()), (2.5, 2.5));
    map.info.sessions[0].sigma_px = Some(0.8);
    assert_eq!((map.info.covering_sigma_px(), map.info.first_sigma_px()), (2.5, 0.8));
    map.info.sessions = map.info.sessions_with_noise();
    assert_eq!(map.info.sessions[1].sigma_px, Some(2.5));
    let tuesday = map.info.sessions[1].ids();
    let removed = edit::keyframes_where(&map, |keyframe: &Keyframe| tuesday.contains(&keyframe.id));
    edit::remove_keyframes(&mut map, &removed);
    map.count_sessions();
    assert_eq!((map.info.covering_sigma_px(), map.info.first_sigma_px()), (0.8, 0.8));
    // It is stored with the ledger.
    assert_eq!(stored(&map).info.sessions[1].sigma_px, Some(2.5));
}

#[test]
fn a_ledger_whose_ids_leave_no_room_for_others_is_refused() {
    let mut map = two_drives();
    map.info.sessions[1].keyframe_ids[1] = MAX_ID;
    map.validate().unwrap();
    map.info.sessions[1].keyframe_ids[1] = u64::MAX;
    let problem = map.audit_sessions().remove(0);
    assert!(matches!(problem, LedgerProblem::LargeIds { last: u64::MAX, .. }), "{problem}");
}

#[test]
fn a_map_without_a_ledger_is_one_session_whatever_its_ids() {
    let mut map = two_drives();
    map.info.sessions.clear();
    map.validate().unwrap();
    let mut renamed = map.clone();
    map.ensure_sessions("import");
    for keyframe in &mut renamed.keyframes {
        keyframe.id += 100;
    }
    for landmark in &mut renamed.landmarks {
        landmark.anchor += 100;
        landmark.observations.iter_mut().for_each(|observation| observation.keyframe += 100);
    }
    renamed.ensure_sessions("the same under another name");
    assert_eq!(map.info.sessions[0].id, renamed.info.sessions[0].id);
    assert!(map.audit_sessions().is_empty());
    map.landmarks[0].observations[0].pixel[0] += 1.0;
    map.info.sessions.clear();
    map.ensure_sessions("import");
    assert_ne!(map.info.sessions[0].id, renamed.info.sessions[0].id);
}
