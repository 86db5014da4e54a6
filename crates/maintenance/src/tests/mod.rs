//! The laws of existence and of detection rates.

mod coverage;
mod halls;
mod parts;

use std::collections::{BTreeMap, BTreeSet};

use map::MapContents;
use nalgebra::Vector3;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use testing::{Place, PlaceOptions, add_second_kind};

use crate::drive::Drive;
use crate::existence::{ExistenceModel, log_odds, probability, updated};
use crate::gone::{FALSE_SIGHTING, remove_gone, remove_gone_of_added_kinds, update_existence};
use crate::position_grid::PositionGrid;
use crate::rates::{DetectionRates, Shown};
use crate::settings::Settings;
use crate::sightings::Sighting;

const DAY_NS: i64 = 86_400_000_000_000;
const FIRST_NS: i64 = 1_700_000_000_000_000_000;

/// The probability of all paths that a landmark can take through its two states, summed up where it is there in the end.
fn brute_force(first: f64, steps: &[(f64, bool, f64)]) -> f64 {
    let mut ends = [0.0; 2];
    for path in 0..1_u32 << (steps.len() + 1) {
        let is_there = |at: usize| path & (1 << at) != 0;
        let mut weight = if is_there(0) { first } else { 1.0 - first };
        for (at, &(half_lives, seen, detection)) in steps.iter().enumerate() {
            // A state changes in a time with half of what the half-life leaves of a doubt.
            let change = 0.5 * (1.0 - (-half_lives).exp2());
            weight *= if is_there(at) == is_there(at + 1) { 1.0 - change } else { change };
            let rate = if is_there(at + 1) { detection } else { FALSE_SIGHTING };
            weight *= if seen { rate } else { 1.0 - rate };
        }
        ends[usize::from(is_there(steps.len()))] += weight;
    }
    ends[1] / (ends[0] + ends[1])
}

#[test]
fn log_odds_are_those_of_a_bayes_filter_over_all_paths() {
    let mut rng = StdRng::seed_from_u64(1);
    let half_life_ns = 90.0 * DAY_NS as f64;
    let model = ExistenceModel::new(half_life_ns);
    for _ in 0..200 {
        let first = rng.random_range(0.05..0.95);
        let steps: Vec<(f64, bool, f64)> = (0..rng.random_range(1..9))
            .map(|_| (rng.random_range(0.0..1.5), rng.random_bool(0.6), rng.random_range(0.2..0.9)))
            .collect();
        let filtered = steps.iter().fold(log_odds(first), |before, &(half_lives, seen, detection)| {
            let elapsed_ns = (half_lives * half_life_ns) as i64;
            updated(model.predicted(before, elapsed_ns), seen, detection, FALSE_SIGHTING)
        });
        let expected = brute_force(first, &steps);
        assert!((probability(filtered) - expected).abs() < 1e-9, "{filtered} {expected}");
    }
}

/// Copies of what is gone go with it, those of what is left stay.
#[test]
fn landmarks_of_added_kinds_go_with_those_that_are_nearest() {
    let mut map = Place::new(&PlaceOptions { keyframes: 8, landmarks: 200, ..PlaceOptions::default() }).map;
    add_second_kind(&mut map, "other-1");
    // Copies are of every second landmark.
    let is_gone = |at: usize| at.is_multiple_of(6);
    let mut gone_m: Vec<[f64; 3]> = Vec::new();
    for (at, (_, position)) in map.landmarks_in_global().enumerate() {
        if is_gone(at) {
            gone_m.push(position.into());
        }
    }
    let mut at = 0;
    map.landmarks.retain(|_| {
        at += 1;
        !is_gone(at - 1)
    });
    let copies: Vec<u64> = map.added_features[0].landmarks.iter().map(|copy| copy.id).collect();
    let expected: Vec<u64> =
        copies.iter().enumerate().filter(|(at, _)| !is_gone(2 * at)).map(|(_, id)| *id).collect();
    remove_gone_of_added_kinds(&mut map, &gone_m);
    let left: Vec<u64> = map.added_features[0].landmarks.iter().map(|copy| copy.id).collect();
    assert_eq!(left, expected);
}

#[test]
fn the_nearest_of_a_grid_is_the_nearest_of_all_within_the_side_of_a_cube() {
    let mut rng = StdRng::seed_from_u64(3);
    let mut positions = |count: usize| -> Vec<Vector3<f64>> {
        (0..count).map(|_| Vector3::from_fn(|_, _| rng.random_range(-2.0..2.0))).collect()
    };
    let (all, side_m) = (positions(80), 0.6);
    let grid = PositionGrid::of_positions(all.iter().copied(), side_m);
    let mut near = 0;
    for position in positions(1000) {
        let nearest = all.iter().map(|of| (of - position).norm()).fold(f64::INFINITY, f64::min);
        let found = grid.nearest(&position);
        if nearest <= side_m {
            near += 1;
            assert!((found - nearest).abs() < 1e-12, "{found} {nearest}");
        } else {
            assert!(found > side_m, "{found} {nearest}");
        }
    }
    assert!((200..900).contains(&near), "{near}");
}

#[test]
fn a_landmark_that_nobody_passes_is_never_taken_out() {
    let model = ExistenceModel::new(90.0 * DAY_NS as f64);
    let mut before = log_odds(0.8);
    for _ in 0..1000 {
        before = model.predicted(before, 30 * DAY_NS);
    }
    assert!((probability(before) - 0.5).abs() < 1e-9);
}

/// Of landmarks that are there, so many are taken out within a time, at most: `(O + ln 2 / 2 τ / T) p / (1 - p)` with the odds `O` against
/// one that is new (derivation: `docs/src/derivations/existence.md`).
#[test]
fn an_unchanged_place_loses_no_more_than_is_stated() {
    let settings = Settings::default();
    let model = ExistenceModel::new(settings.half_life_ns());
    let (sessions, every_ns, landmarks) = (100, 365 * DAY_NS / 100, 20_000);
    for detection in [0.3, 0.5, 0.7, 0.9] {
        let mut rng = StdRng::seed_from_u64(2);
        let mut lost = 0;
        for _ in 0..landmarks {
            let mut of_landmark = log_odds(settings.new_existence);
            lost += usize::from((0..sessions).any(|_| {
                let seen = rng.random_bool(detection);
                of_landmark =
                    updated(model.predicted(of_landmark, every_ns), seen, detection, FALSE_SIGHTING);
                probability(of_landmark) < settings.min_existence
            }));
        }
        let half_lives = (sessions * every_ns) as f64 / settings.half_life_ns();
        let against = (1.0 - settings.new_existence) / settings.new_existence;
        let stated = (against + 0.5 * std::f64::consts::LN_2 * half_lives) * settings.min_existence
            / (1.0 - settings.min_existence);
        let share = lost as f64 / f64::from(landmarks);
        println!("seen with {detection}: {share:.4} lost in a year, at most {stated:.4} stated");
        assert!(share <= stated, "{share} of {stated}");
    }
}

#[test]
fn what_was_moved_is_taken_out_after_few_sessions() {
    let settings = Settings::default();
    let model = ExistenceModel::new(settings.half_life_ns());
    for (detection, most) in [(0.9, 4), (0.7, 7), (0.5, 12)] {
        let mut of_landmark = log_odds(settings.new_existence);
        for _ in 0..50 {
            of_landmark = updated(model.predicted(of_landmark, 4 * DAY_NS), true, detection, FALSE_SIGHTING);
        }
        let missed = (1..100).find(|_| {
            of_landmark = updated(model.predicted(of_landmark, 4 * DAY_NS), false, detection, FALSE_SIGHTING);
            probability(of_landmark) < settings.min_existence
        });
        assert!(missed.is_some_and(|missed| missed <= most), "{detection}: {missed:?}");
    }
}

#[test]
fn the_detection_rate_is_learned_in_spite_of_what_is_gone() {
    let mut rng = StdRng::seed_from_u64(5);
    for (truth, gone) in [(0.4, 0.05), (0.7, 0.05), (0.7, 0.2), (0.85, 0.3)] {
        let shown: Vec<Shown> = (0..2000)
            .map(|_| {
                let is_there = rng.random_bool(1.0 - gone);
                let seen = rng.random_bool(if is_there { truth } else { FALSE_SIGHTING });
                Shown { exposures: rng.random_range(1..6), seen, log_odds: log_odds(1.0 - gone) }
            })
            .collect();
        let rates = DetectionRates::learned(&shown, FALSE_SIGHTING);
        for exposures in 1..6 {
            let rate = rates.of(exposures);
            assert!((rate - truth).abs() < 0.06, "{rate} for {truth}, {gone} gone");
        }
    }
    let nothing = DetectionRates::learned(&[], FALSE_SIGHTING);
    assert!((nothing.of(1) - 0.5).abs() < 1e-12);
}

fn place() -> MapContents {
    let options = PlaceOptions { keyframes: 12, landmarks: 600, ..PlaceOptions::default() };
    let mut map = Place::new(&options).map;
    map.keyframes.iter_mut().for_each(|keyframe| keyframe.stamp_ns += 1_700_000_000_000_000_000);
    map
}

#[test]
fn what_sessions_miss_is_taken_out_and_what_they_see_stays() {
    let mut map = place();
    let settings = Settings::default();
    let missed: BTreeSet<u64> = map.landmarks.iter().map(|landmark| landmark.id).step_by(4).collect();
    let all: BTreeSet<u64> = map.landmarks.iter().map(|landmark| landmark.id).collect();
    let mut removed = 0;
    for session in 1..=6 {
        let sighting = |(landmark, of): (usize, &map::Landmark)| Sighting {
            landmark,
            exposures: 3,
            seen: !missed.contains(&of.id),
        };
        let sightings: Vec<Sighting> = map.landmarks.iter().enumerate().map(sighting).collect();
        let end_ns = FIRST_NS + session * 4 * DAY_NS;
        let rates = update_existence(&mut map, &sightings, &(0..=0), end_ns, &Drive::default(), &settings);
        assert!(rates.of(3) >= 0.7, "{rates:?}");
        removed += remove_gone(&mut map, &settings).landmarks.len();
        map.sort();
        map.validate().unwrap();
    }
    let left: BTreeSet<u64> = map.landmarks.iter().map(|landmark| landmark.id).collect();
    assert!(
        left.is_disjoint(&missed),
        "{} of {} missed ones are left",
        left.intersection(&missed).count(),
        missed.len()
    );
    assert_eq!(left.len() + removed, all.len());
    assert!(map.existence.iter().all(|of| probability(of.log_odds) > 0.9));
}

/// Until a robot begins a new session (ns).
const PIECE_NS: i64 = 600_000_000_000;

/// Updates the existence of all landmarks by a session that passed them three times.
///
/// # Arguments
/// * `drive`: and when the session ended (ns).
fn pass(
    map: &mut MapContents,
    (drive, end_ns): &(Drive, i64),
    is_seen: impl Fn(u64) -> bool,
    settings: &Settings,
) {
    let sighting =
        |(landmark, of): (usize, &map::Landmark)| Sighting { landmark, exposures: 3, seen: is_seen(of.id) };
    let sightings: Vec<Sighting> = map.landmarks.iter().enumerate().map(sighting).collect();
    update_existence(map, &sightings, &(0..=0), *end_ns, drive, settings);
}

#[test]
fn pieces_of_one_drive_count_as_one_session() {
    let settings = Settings::default();
    let missed: BTreeSet<u64> = place().landmarks.iter().map(|landmark| landmark.id).step_by(4).collect();
    let missed_by = |sessions: &[(Drive, i64)]| {
        let mut map = place();
        for session in sessions {
            pass(&mut map, session, |id| !missed.contains(&id), &settings);
        }
        let existence = map.existence.clone();
        (existence, remove_gone(&mut map, &settings).landmarks.len())
    };
    let first_ns = FIRST_NS + 4 * DAY_NS;
    let piece = |piece: i64| (Drive::new(first_ns, piece > 0), first_ns + piece * PIECE_NS);
    let (of_one, _) = missed_by(&[piece(0)]);
    let pieces: Vec<(Drive, i64)> = (0..48).map(piece).collect();
    let (of_pieces, gone) = missed_by(&pieces);
    assert_eq!(gone, 0);
    for (one, pieces) in of_one.iter().zip(&of_pieces) {
        assert_eq!((one.log_odds.to_bits(), one.stamp_ns), (pieces.log_odds.to_bits(), pieces.stamp_ns));
        // When it was seen last is known to the piece.
        let seen_ns = if missed.contains(&one.landmark) { one.seen_ns } else { first_ns + 47 * PIECE_NS };
        assert_eq!(pieces.seen_ns, seen_ns);
    }
    // As many drives take all of them out.
    let drive = |drive: i64| (Drive::new(first_ns + drive * PIECE_NS, false), first_ns + drive * PIECE_NS);
    let drives: Vec<(Drive, i64)> = (0..48).map(drive).collect();
    assert_eq!(missed_by(&drives).1, missed.len());
    // A drive that is handed in after those of later days counts once, too.
    let late = |piece: i64| (Drive::new(FIRST_NS - DAY_NS, piece > 0), FIRST_NS - DAY_NS + piece * PIECE_NS);
    let (of_late, gone) = missed_by(&(0..48).map(late).collect::<Vec<_>>());
    assert_eq!((gone, of_late.len()), (0, of_one.len()));
}

/// A session that is handed in after those of later weeks.
#[test]
fn a_late_session_says_nothing_of_what_was_seen_since_and_little_of_what_was_missed_since() {
    let settings = Settings::default();
    let week = |week: i64| (Drive::new(FIRST_NS + 7 * week * DAY_NS, false), FIRST_NS + 7 * week * DAY_NS);
    let odds = |map: &MapContents| -> BTreeMap<u64, f64> {
        map.existence.iter().map(|of| (of.landmark, of.log_odds)).collect()
    };
    // Landmarks that robots see since the third week are new then: a session of the first week cannot have seen them.
    let mut map = place();
    map.keyframes.iter_mut().for_each(|keyframe| keyframe.stamp_ns = week(3).1);
    map.existence.clear();
    pass(&mut map, &week(4), |_| true, &settings);
    let before = odds(&map);
    for late in [0, 1, 2] {
        pass(&mut map, &week(late), |_| false, &settings);
    }
    assert_eq!(odds(&map), before);
    assert!(map.existence.iter().all(|of| of.stamp_ns == week(4).1 && of.seen_ns == week(4).1));
    assert!(remove_gone(&mut map, &settings).landmarks.is_empty());

    // Others are gone since the sixth week. A session of the second one saw them as did that of the first.
    let mut map = place();
    let gone: BTreeSet<u64> = map.landmarks.iter().map(|landmark| landmark.id).step_by(4).collect();
    for of in [1, 6, 7] {
        pass(&mut map, &week(of), |id| of < 6 || !gone.contains(&id), &settings);
    }
    let mut in_time = map.clone();
    pass(&mut map, &week(2), |_| true, &settings);
    pass(&mut in_time, &week(8), |_| true, &settings);
    for of in map.existence.iter().filter(|of| gone.contains(&of.landmark)) {
        let new = in_time.existence.iter().find(|other| other.landmark == of.landmark).unwrap();
        assert!(probability(of.log_odds) < 0.3, "{}", probability(of.log_odds));
        assert!(probability(new.log_odds) > 0.6, "{}", probability(new.log_odds));
        assert_eq!((of.stamp_ns, of.seen_ns), (week(7).1, week(2).1));
    }
}

/// What a session shows of a landmark of which nothing is stated yet is evidence for it, as what it misses is evidence against others.
#[test]
fn the_first_session_counts_what_it_sees() {
    let settings = Settings::default();
    let mut map = place();
    map.existence.clear();
    let session = map.keyframes[0].id;
    let stamp_ns = FIRST_NS + 4 * DAY_NS;
    map.keyframes[0].stamp_ns = stamp_ns;
    let sighting = |(landmark, of): (usize, &map::Landmark)| Sighting {
        landmark,
        exposures: 3,
        seen: of.observations.iter().any(|seen| seen.keyframe == session),
    };
    let sightings: Vec<Sighting> = map.landmarks.iter().enumerate().map(sighting).collect();
    let drive = Drive::new(stamp_ns - PIECE_NS, true);
    update_existence(&mut map, &sightings, &(session..=session), stamp_ns, &drive, &settings);
    let odds: BTreeMap<u64, f64> = map.existence.iter().map(|of| (of.landmark, of.log_odds)).collect();
    let of_new = log_odds(settings.new_existence);
    for sighting in &sightings {
        let landmark = &map.landmarks[sighting.landmark];
        if landmark.observations.iter().any(|seen| seen.keyframe != session) {
            assert_eq!(odds[&landmark.id] > of_new, sighting.seen, "{}", landmark.id);
        }
    }
    assert!(
        sightings.iter().any(|sighting| sighting.seen) && sightings.iter().any(|sighting| !sighting.seen)
    );
}

/// The law of an unchanged place, where all pieces of a drive see and miss the same.
#[test]
fn drives_in_pieces_take_out_no_more_of_an_unchanged_place_than_is_stated() {
    let settings = Settings::default();
    let (drives, every_ns) = (50, 365 * DAY_NS / 100);
    let half_lives = (drives * every_ns) as f64 / settings.half_life_ns();
    let against = (1.0 - settings.new_existence) / settings.new_existence;
    let stated = (against + 0.5 * std::f64::consts::LN_2 * half_lives) * settings.min_existence
        / (1.0 - settings.min_existence);
    for detection in [0.5, 0.7, 0.9] {
        let mut rng = StdRng::seed_from_u64(3);
        let mut map = place();
        let (all, mut lost) = (map.landmarks.len(), 0);
        for drive in 1..=drives {
            let seen: BTreeSet<u64> = map.landmarks.iter().map(|landmark| landmark.id).collect();
            let seen: BTreeSet<u64> = seen.into_iter().filter(|_| rng.random_bool(detection)).collect();
            for piece in 0..6 {
                let begin_ns = FIRST_NS + drive * every_ns;
                let session = (Drive::new(begin_ns, piece > 0), begin_ns + piece * PIECE_NS);
                pass(&mut map, &session, |id| seen.contains(&id), &settings);
                lost += remove_gone(&mut map, &settings).landmarks.len();
            }
        }
        let share = lost as f64 / all as f64;
        println!("seen with {detection}: {share:.4} lost in half a year, at most {stated:.4} stated");
        assert!(share <= stated, "{share} of {stated}");
    }
}
