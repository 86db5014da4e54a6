//! The laws of coverage: places, appearances, and what is kept of them.

use std::collections::BTreeSet;
use std::ops::RangeInclusive;

use map::{Keyframe, Landmark, LandmarkExistence, MapContents, edit};
use nalgebra::{UnitQuaternion, Vector3};
use protocol::KeyframeId;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::{DAY_NS, FIRST_NS, place};
use crate::appearance::Shown;
use crate::coverage::surplus;
use crate::existence::log_odds;
use crate::gone::remove_gone;
use crate::places::places;
use crate::settings::Settings;

const ALL: RangeInclusive<KeyframeId> = 0..=KeyframeId::MAX;

/// Settings with which all keyframes are of one place.
fn one_place() -> Settings {
    let mut settings = Settings::default();
    (settings.place_m, settings.place_rad) = (100.0, 7.0);
    settings
}

/// States that all landmarks are there, seen at the time that a condition says.
fn stated(map: &MapContents, seen_ns: impl Fn(&Landmark) -> i64) -> Vec<LandmarkExistence> {
    let existence = |landmark: &Landmark| {
        let seen_ns = seen_ns(landmark);
        LandmarkExistence { landmark: landmark.id, log_odds: 2.0, stamp_ns: seen_ns, seen_ns }
    };
    map.landmarks.iter().map(existence).collect()
}

/// Keyframes at random in a hall of so many metres.
fn keyframes(hall: [f64; 3], count: usize, rng: &mut StdRng) -> Vec<Keyframe> {
    let template = place().keyframes.remove(0);
    (0..count)
        .map(|_| {
            let mut keyframe = template.clone();
            let pose = &mut keyframe.global_from_keyframe.pose;
            pose.translation = Vector3::from(hall).map(|side| rng.random_range(0.0..side));
            let axis = Vector3::from_fn(|_, _| rng.random_range(-2.0..2.0));
            pose.rotation = UnitQuaternion::from_scaled_axis(axis);
            keyframe
        })
        .collect()
}

/// Distance of two keyframes in radii of a place.
fn radii(a: &Keyframe, b: &Keyframe, settings: &Settings) -> f64 {
    let [a, b] = [a, b].map(|keyframe| keyframe.global_from_keyframe.pose);
    let angle = (a.rotation * Vector3::z()).angle(&(b.rotation * Vector3::z()));
    ((a.translation - b.translation).norm() / settings.place_m).max(angle / settings.place_rad)
}

#[test]
fn every_keyframe_is_within_the_radius_of_the_middle_of_its_place_and_no_two_middles_are() {
    let settings = Settings::default();
    for seed in 0..3 {
        let keyframes = keyframes([20.0, 20.0, 2.0], 600, &mut StdRng::seed_from_u64(seed));
        let places = places(&keyframes, &settings);
        let members = || places.iter().flat_map(|place| &place.keyframes);
        assert_eq!((members().collect::<BTreeSet<_>>().len(), members().count()), (600, 600));
        for (at, place) in places.iter().enumerate() {
            let middle = &keyframes[place.middle];
            let is_within = |member: &usize| radii(middle, &keyframes[*member], &settings) <= 1.0;
            assert!(place.keyframes.contains(&place.middle) && place.keyframes.iter().all(is_within));
            let others = places[..at].iter().map(|other| &keyframes[other.middle]);
            others.for_each(|other| assert!(radii(middle, other, &settings) > 1.0));
        }
    }
}

#[test]
fn the_number_of_places_is_that_of_what_was_visited_not_that_of_visits() {
    let settings = Settings::default();
    let mut rng = StdRng::seed_from_u64(4);
    let mut all = keyframes([4.0, 4.0, 2.0], 8000, &mut rng);
    let first = places(&all, &settings).len();
    all.extend(keyframes([4.0, 4.0, 2.0], 8000, &mut rng));
    let then = places(&all, &settings).len();
    // In five dimensions the last gaps are found late.
    assert!(first < 200 && then as f64 <= 1.15 * first as f64, "{first} then {then}");
}

#[test]
fn a_place_keeps_so_many_keyframes_and_they_show_what_it_showed() {
    let map = place();
    let mut settings = one_place();
    settings.min_added = 0.0;
    for most in 1..=4 {
        settings.keyframes_a_place = most;
        let surplus_of = |map: &MapContents| surplus(map, &ALL, &BTreeSet::new(), FIRST_NS, &settings);
        let first = surplus_of(&map);
        assert!(first.unused.is_empty());
        let kept = map.keyframes.len() - first.replaced.len();
        let appearances =
            Shown::of(&map, FIRST_NS, &settings).appearances(&(0..map.keyframes.len()).collect::<Vec<_>>());
        assert_eq!(kept, appearances.iter().map(|of| of.len().min(most)).sum::<usize>());
        // Nothing changes where no more than these are there.
        let mut thinned = map.clone();
        edit::remove_keyframes(&mut thinned, &first.replaced);
        thinned.validate().unwrap();
        assert_eq!(surplus_of(&thinned).replaced, BTreeSet::new());
        // Nor where nobody has come.
        assert_eq!(
            surplus(&map, &(0..=0), &BTreeSet::new(), FIRST_NS, &settings),
            crate::coverage::Surplus::default()
        );
    }
}

#[test]
fn a_keyframe_that_adds_little_to_the_others_of_its_place_is_not_kept() {
    let map = place();
    let mut settings = one_place();
    settings.keyframes_a_place = map.keyframes.len();
    let kept_with = |min_added: f64, map: &MapContents| -> BTreeSet<KeyframeId> {
        let settings = Settings { min_added, ..settings.clone() };
        let replaced = surplus(map, &ALL, &BTreeSet::new(), FIRST_NS, &settings).replaced;
        map.keyframes.iter().map(|keyframe| keyframe.id).filter(|id| !replaced.contains(id)).collect()
    };
    assert_eq!(kept_with(0.0, &map).len(), map.keyframes.len());
    let mut last = map.keyframes.len();
    for min_added in [0.3, 0.5, 0.7, 0.9] {
        let kept = kept_with(min_added, &map);
        assert!(!kept.is_empty() && kept.len() <= last, "{min_added}: {kept:?}");
        last = kept.len();
        // All that stays is needed, and it stays.
        let mut thinned = map.clone();
        let others =
            map.keyframes.iter().map(|keyframe| keyframe.id).filter(|id| !kept.contains(id)).collect();
        edit::remove_keyframes(&mut thinned, &others);
        assert_eq!(kept_with(min_added, &thinned), kept, "{min_added}");
        // What goes adds too little to what stays.
        let shown = Shown::of(&map, FIRST_NS, &settings);
        for (at, _) in map.keyframes.iter().enumerate().filter(|(_, keyframe)| !kept.contains(&keyframe.id)) {
            let landmarks = &shown.index.observed[at];
            let added: f64 = landmarks
                .iter()
                .map(|landmark| {
                    let observers = &shown.index.observers[*landmark];
                    let already =
                        observers.iter().filter(|of| kept.contains(&map.keyframes[**of].id)).count();
                    0.5_f64.powi(already as i32)
                })
                .sum();
            assert!(added <= min_added * landmarks.len() as f64 + 1e-9, "{min_added}: {at}, {added}");
        }
    }
    assert!(last < map.keyframes.len() / 2, "{last}");
}

#[test]
fn views_that_have_little_in_common_are_no_other_appearance_and_another_texture_is() {
    let mut map = place();
    let settings = one_place();
    let all: Vec<usize> = (0..map.keyframes.len()).collect();
    // The ends of the path share nothing, and do not contradict each other.
    assert_eq!(Shown::of(&map, FIRST_NS, &settings).appearances(&all).len(), 1);
    let count = map.keyframes.len();
    add_night(&mut map, count);
    let all: Vec<usize> = (0..map.keyframes.len()).collect();
    let appearances = Shown::of(&map, FIRST_NS, &settings).appearances(&all);
    let of_each: BTreeSet<Vec<usize>> = appearances.into_iter().collect();
    assert_eq!(of_each, BTreeSet::from([(0..count).collect(), (count..2 * count).collect()]));
}

#[test]
fn what_is_gone_makes_no_other_appearance() {
    let mut map = place();
    let settings = one_place();
    let count = map.keyframes.len();
    add_night(&mut map, count);
    let last = map.landmarks.iter().map(|landmark| landmark.id).max().unwrap();
    // Nine tenths of what there was are gone, all of what is new is there, and a tenth of both are the same.
    let mut at = 0;
    map.existence = stated(&map, |_| FIRST_NS);
    for (existence, landmark) in map.existence.iter_mut().zip(&mut map.landmarks) {
        if landmark.id < last / 2 {
            at += 1;
            if at % 2 == 0 {
                existence.log_odds = log_odds(0.01);
            } else {
                let again = landmark.observations.clone();
                let again = again.into_iter().map(|mut seen| {
                    seen.keyframe += NIGHT;
                    seen
                });
                landmark.observations.extend(again);
            }
        }
    }
    let night = map.keyframes.iter().position(|keyframe| keyframe.id > NIGHT).unwrap();
    let all: Vec<usize> = (0..map.keyframes.len()).collect();
    let shown = Shown::of(&map, FIRST_NS, &settings);
    let appearances = shown.appearances(&all);
    assert_eq!(appearances.len(), 1, "{appearances:?} from {night}");
}

/// What is added to the ids of keyframes by night.
const NIGHT: u64 = 1000;

/// Adds the first keyframes again, as they look at night: with landmarks of their own.
fn add_night(map: &mut MapContents, count: usize) {
    let of_day: BTreeSet<u64> = map.keyframes[..count].iter().map(|keyframe| keyframe.id).collect();
    let night = |of: &Keyframe| Keyframe { id: of.id + NIGHT, ..of.clone() };
    map.keyframes.extend(map.keyframes[..count].iter().map(night).collect::<Vec<_>>());
    for landmark in map.landmarks.clone() {
        let mut at_night = Landmark { id: landmark.id + 1_000_000, ..landmark };
        at_night.observations.retain(|seen| of_day.contains(&seen.keyframe));
        at_night.observations.iter_mut().for_each(|seen| seen.keyframe += NIGHT);
        if let Some(seen) = at_night.observations.first() {
            at_night.anchor = seen.keyframe;
            map.landmarks.push(at_night);
        }
    }
    map.sort();
    map.validate().unwrap();
}

#[test]
fn an_appearance_that_nobody_sees_goes_and_one_of_a_place_that_nobody_visits_stays() {
    let mut map = place();
    let settings = Settings::default();
    let now_ns = 1_800_000_000_000_000_000;
    let of_old: BTreeSet<u64> = map.keyframes[..4].iter().map(|keyframe| keyframe.id).collect();
    let old_ns = now_ns - 400 * DAY_NS;
    map.existence = stated(&map, |_| old_ns);
    assert_eq!(surplus(&map, &ALL, &BTreeSet::new(), now_ns, &settings).unused, BTreeSet::new());
    // By night the first four keyframes are seen again.
    add_night(&mut map, 4);
    map.existence = stated(&map, |landmark| if landmark.id < 1_000_000 { old_ns } else { now_ns });
    let unused = surplus(&map, &(NIGHT..=2 * NIGHT), &BTreeSet::new(), now_ns, &settings).unused;
    assert_eq!(unused, of_old);
}

#[test]
fn a_place_keeps_so_many_landmarks_and_each_keyframe_its_share() {
    let map = place();
    let mut settings = one_place();
    (settings.keyframes_a_place, settings.min_added) = (4, 0.0);
    let before = surplus(&map, &ALL, &BTreeSet::new(), FIRST_NS, &settings);
    assert_eq!(before.landmarks, BTreeSet::new());
    let mut thinned = map.clone();
    edit::remove_keyframes(&mut thinned, &before.replaced);
    for most in [100, 40] {
        settings.landmarks_a_place = most;
        let beyond = surplus(&thinned, &ALL, &BTreeSet::new(), FIRST_NS, &settings).landmarks;
        let mut left = thinned.clone();
        left.landmarks.retain(|landmark| !beyond.contains(&landmark.id));
        left.validate().unwrap();
        assert_eq!(left.landmarks.len(), most);
        for keyframe in &left.keyframes {
            let is_seen =
                |landmark: &&Landmark| landmark.observations.iter().any(|seen| seen.keyframe == keyframe.id);
            let count = left.landmarks.iter().filter(is_seen).count();
            assert!(count >= most / 4, "{count} of {most} in keyframe {}", keyframe.id);
        }
        assert_eq!(surplus(&left, &ALL, &BTreeSet::new(), FIRST_NS, &settings).landmarks, BTreeSet::new());
    }
}

#[test]
fn a_keyframe_whose_landmarks_are_hardly_there_goes_and_one_that_nobody_passed_stays() {
    let settings = Settings::default();
    let mut map = place();
    let poor = map.keyframes[0].id;
    let of_poor = |landmark: &Landmark| landmark.observations.iter().any(|seen| seen.keyframe == poor);
    for (existence, stays) in [(0.5, true), (0.25, true), (0.15, false)] {
        let landmarks = map.landmarks.clone();
        map.existence = stated(&map, |_| FIRST_NS);
        for (of, _) in map.existence.iter_mut().zip(&landmarks).filter(|(_, landmark)| of_poor(landmark)) {
            of.log_odds = log_odds(existence);
        }
        let mut left = map.clone();
        let gone = remove_gone(&mut left, &settings);
        left.sort();
        left.validate().unwrap();
        assert_eq!(gone.landmarks.len(), 0);
        assert_eq!(!gone.keyframes.contains(&poor), stays, "{existence}: {gone:?}");
    }
}
