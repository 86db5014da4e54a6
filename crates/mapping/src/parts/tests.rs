//! Laws of parts of maps.

use std::collections::BTreeSet;

use adjustment::POSE;
use map::contents::MapContents;
use map::edit;
use map::model::{Keyframe, KeyframeCrossCovariance, Landmark, LandmarkExistence, Observation};
use map::{AddedFeatures, Alias, KeptImage, KeyframeAliases};
use nalgebra::{DMatrix, Vector3};
use protocol::KeyframeId;
use testing::{Place, PlaceOptions, add_common_errors, add_existence};

use super::{Former, LocatedErrors, located_errors, put_back};
use crate::stored_poses::MapCovariance;

/// Ids of the new keyframes.
const NEW: [KeyframeId; 3] = [101, 102, 105];

fn map(has_common: bool) -> MapContents {
    let mut map = Place::new(&PlaceOptions { keyframes: 24, landmarks: 900, ..PlaceOptions::default() }).map;
    if has_common {
        add_common_errors(&mut map, 12);
    }
    add_existence(&mut map);
    map
}

fn part() -> BTreeSet<KeyframeId> {
    (14..=24).collect()
}

/// How the errors of the new keyframes depend on those of the part, and what remains.
fn dependence() -> [DMatrix<f64>; 2] {
    let size = POSE * NEW.len();
    let gain = DMatrix::from_fn(size, POSE * part().len(), |row, column| {
        let near = (row / POSE * 3 + 2).abs_diff(column / POSE);
        if near < 3 { 0.4 * ((row * 5 + column * 11) as f64).sin() } else { 0.0 }
    });
    let root = DMatrix::from_fn(size, size, |row, column| 0.004 * ((row * 7 + column * 13) as f64).cos());
    let rest = &root * root.transpose() + DMatrix::identity(size, size) * 1e-5;
    [gain, rest]
}

fn dense(map: &MapContents) -> DMatrix<f64> {
    MapCovariance::of_map(map).unwrap().of_all()
}

/// The part of a map with the new keyframes, all covariances of pairs stated.
fn extended(map: &MapContents) -> MapContents {
    let mut extended = edit::part_of(map, &part());
    let of_part = dense(&extended);
    let [gain, rest] = dependence();
    let cross = &gain * &of_part;
    let own = &cross * gain.transpose() + rest;
    let (first, count) = (of_part.nrows(), own.nrows());
    let mut all = DMatrix::zeros(first + count, first + count);
    all.view_mut((0, 0), (first, first)).copy_from(&of_part);
    all.view_mut((first, 0), (count, first)).copy_from(&cross);
    all.view_mut((0, first), (first, count)).copy_from(&cross.transpose());
    all.view_mut((first, first), (count, count)).copy_from(&own);
    for id in NEW {
        let mut keyframe = Keyframe { id, ..extended.keyframes[4].clone() };
        keyframe.global_from_keyframe.pose.translation.x += 0.3;
        extended.keyframes.push(keyframe);
    }
    (extended.common_errors, extended.cross_covariances) = (Vec::new(), Vec::new());
    let block = |a: usize, b: usize| all.fixed_view::<POSE, POSE>(POSE * a, POSE * b).into_owned();
    for at in 0..extended.keyframes.len() {
        extended.keyframes[at].global_from_keyframe.covariance = block(at, at);
        let id = |at: usize| extended.keyframes[at].id;
        let pairs =
            (0..at).map(|other| KeyframeCrossCovariance { a: id(other), b: id(at), block: block(other, at) });
        extended.cross_covariances.extend(pairs.collect::<Vec<_>>());
    }
    extended.sort();
    extended
}

/// What is stated of the new keyframes with all others is what follows from the part that they were located in.
#[test]
fn errors_of_new_keyframes_depend_on_all_of_the_map_as_on_the_part() {
    for has_common in [false, true] {
        let before = map(has_common);
        let extended = extended(&before);
        let errors = located_errors(&before, &part(), &extended).unwrap();
        let mut after = before.clone();
        put_back(&mut after, &edit::part_of(&before, &part()), extended, &BTreeSet::new(), errors);
        after.validate().unwrap();
        assert_eq!(after.common_errors.len(), if has_common { 27 } else { 0 });

        let (stated, of_map) = (dense(&after), dense(&before));
        let [gain, rest] = dependence();
        let rows: Vec<usize> = (0..before.keyframes.len())
            .filter(|at| part().contains(&before.keyframes[*at].id))
            .flat_map(|at| POSE * at..POSE * at + POSE)
            .collect();
        let cross = &gain * of_map.select_rows(&rows);
        let own = &cross.select_columns(&rows) * gain.transpose() + rest;
        let first = of_map.nrows();
        let scale = |row: usize, column: usize| (stated[(row, row)] * stated[(column, column)]).sqrt();
        for row in 0..stated.nrows() {
            for column in 0..=row {
                let expected = match (row >= first, column >= first) {
                    (false, _) => of_map[(row, column)],
                    (true, false) => cross[(row - first, column)],
                    (true, true) => own[(row - first, column - first)],
                };
                // Small correlations with keyframes outside of the part are left out.
                let error = (stated[(row, column)] - expected).abs() / scale(row, column);
                assert!(error < 1.1e-3, "{row} {column}: {} {expected}", stated[(row, column)]);
            }
        }
        // Those of the map with each other are as they were, and the whole is a covariance.
        assert_eq!(stated.view((0, 0), (first, first)), of_map);
        assert!(stated.cholesky().is_some());
    }
}

#[test]
fn a_part_that_is_put_back_as_it_was_changes_nothing() {
    let before = map(true);
    let part = edit::part_of(&before, &part());
    let mut after = before.clone();
    put_back(&mut after, &part, part.clone(), &BTreeSet::new(), LocatedErrors::default());
    assert_eq!(after, before);
}

/// Whatever became of a part, the map can be as it was.
#[test]
fn a_map_is_restored_to_the_bit() {
    for has_common in [false, true] {
        let mut before = map(has_common);
        before.ensure_sessions("first");
        let keyframes: Vec<KeyframeId> = before.keyframes.iter().map(|keyframe| keyframe.id).collect();
        before.aliases = keyframes
            .iter()
            .map(|id| KeyframeAliases {
                keyframe: *id,
                places: keyframes.iter().filter(|other| *other != id).copied().map(alias).collect(),
            })
            .collect();
        before.images =
            keyframes.iter().map(|id| KeptImage { keyframe: *id, jpeg: vec![*id as u8] }).collect();
        // Landmarks of an added kind, whose ids come right after those of the map: they are renumbered.
        let last = before.landmarks.last().unwrap().id;
        let mut kind = before.info.feature_kind();
        kind.extractor = "another".to_owned();
        let added = before.landmarks.iter().take(300).zip(1..);
        let landmarks = added.map(|(of, at)| Landmark { id: last + at, ..of.clone() }).collect();
        before.added_features = vec![AddedFeatures { kind, landmarks }];
        before.sort();

        let mut extended = extended(&before);
        let errors = located_errors(&before, &part(), &extended).unwrap();
        let removed: BTreeSet<KeyframeId> = part().into_iter().take(3).collect();
        edit::remove_keyframes(&mut extended, &removed);
        let last_of_part = extended.landmarks.last().unwrap().clone();
        extended.landmarks.push(Landmark { id: last_of_part.id + 7, ..last_of_part });
        extended.sort();
        let gone: BTreeSet<u64> = extended.landmarks.iter().map(|of| of.id).step_by(5).collect();
        let part = edit::part_of(&before, &part());
        let former = Former::of(&before, &part, &extended);
        let mut after = before.clone();
        put_back(&mut after, &part, extended, &gone, errors);
        assert!(after.landmarks.len() != before.landmarks.len() && after.aliases != before.aliases);
        assert!(after.cross_covariances != before.cross_covariances && after.images != before.images);
        assert_ne!(after.added_features, before.added_features);
        former.restore(&mut after);
        assert!(after == before);
    }
}

fn alias(keyframe: KeyframeId) -> Alias {
    Alias { keyframe, log_odds: 1.5 }
}

#[test]
fn what_became_of_a_part_becomes_of_the_map() {
    let before = map(true);
    let part = edit::part_of(&before, &part());
    let mut after = part.clone();
    let removed = after.keyframes[0].id;
    // Those that it anchors are where the next keyframe sees them.
    let of_removed: BTreeSet<u64> =
        part.landmarks.iter().filter(|of| of.anchor == removed).map(|of| of.id).collect();
    let of_map = |id| before.landmarks.iter().find(|landmark| landmark.id == id).unwrap();
    let stays =
        |landmark: &Landmark| landmark.anchor != removed && landmark.anchor == of_map(landmark.id).anchor;
    let at = after.landmarks.iter().position(stays).unwrap();
    let moved = after.landmarks[at].id;
    let gone = after.landmarks[at + 1].id;
    after.landmarks[at].position_in_anchor += Vector3::new(0.0, 0.2, 0.0);
    let moved_to = after.landmarks_in_global().nth(at).unwrap().1;
    after.keyframes.push(Keyframe { id: NEW[0], ..after.keyframes[3].clone() });
    let mut seen = after.landmarks[at].observations[0].clone();
    seen.keyframe = NEW[0];
    after.landmarks[at].observations.push(seen.clone());
    let last = after.landmarks.iter().map(|landmark| landmark.id).max().unwrap();
    let observations = vec![Observation { keyframe: NEW[0], ..seen }];
    let new = Landmark { id: last + 1, anchor: NEW[0], position_in_anchor: Vector3::z(), observations };
    after.landmarks.push(new);
    after.landmarks.remove(at + 1);
    after.existence = [moved, last + 1]
        .map(|landmark| LandmarkExistence { landmark, log_odds: 1.5, stamp_ns: 9, seen_ns: 8 })
        .to_vec();
    edit::remove_keyframes(&mut after, &BTreeSet::from([removed]));
    after.sort();
    after.validate().unwrap();

    let mut map = before.clone();
    put_back(&mut map, &part, after, &BTreeSet::from([gone]), LocatedErrors::default());
    map.validate().unwrap();
    let ids = |map: &MapContents| map.keyframes.iter().map(|keyframe| keyframe.id).collect::<BTreeSet<_>>();
    let mut expected = ids(&before);
    expected.remove(&removed);
    expected.insert(NEW[0]);
    assert_eq!(ids(&map), expected);
    let position =
        |id| map.landmarks_in_global().find(|(landmark, _)| landmark.id == id).map(|(_, position)| position);
    assert!((position(moved).unwrap() - moved_to).norm() < 1e-9);
    assert_eq!(position(gone), None);
    // The new landmark is beyond all of the map.
    let last = before.landmarks.iter().map(|landmark| landmark.id).max().unwrap();
    assert_eq!(map.landmarks.last().unwrap().anchor, NEW[0]);
    assert_eq!(map.landmarks.last().unwrap().id, last + 1);
    let stated = |id| map.existence.iter().find(|of| of.landmark == id).map(|of| of.seen_ns);
    assert_eq!((stated(moved), stated(last + 1)), (Some(8), Some(8)));
    // Whoever observes others of the map, they are where they were.
    for (landmark, was) in before.landmarks_in_global().filter(|(landmark, _)| landmark.id != moved) {
        if let Some(is) = position(landmark.id).filter(|_| !of_removed.contains(&landmark.id)) {
            assert!((is - was).norm() < 1e-9);
        }
    }
}

/// New landmarks of a part have the ids that follow those of the part, which the map has elsewhere.
#[test]
fn a_new_landmark_that_is_taken_out_takes_no_other_one_of_the_map_with_it() {
    let mut before = map(false);
    let keyframes: BTreeSet<KeyframeId> = before.keyframes[..8].iter().map(|keyframe| keyframe.id).collect();
    // The part has the lower half of the ids.
    let middle = before.landmarks[before.landmarks.len() / 2].id;
    before.landmarks.retain(|landmark| {
        let is_of_part = landmark.observations.iter().any(|seen| keyframes.contains(&seen.keyframe));
        is_of_part == (landmark.id <= middle)
    });
    before.drop_existence_of_others();
    let part = edit::part_of(&before, &keyframes);
    let last = part.landmarks.last().unwrap().id;
    let elsewhere: BTreeSet<u64> = before.landmarks.iter().map(|landmark| landmark.id).collect();
    let new: BTreeSet<u64> = (last + 1..=last + 400).collect();
    assert!(elsewhere.intersection(&new).count() > 40);
    let mut after = before.clone();
    put_back(&mut after, &part, part.clone(), &new, LocatedErrors::default());
    assert_eq!(after.landmarks.len(), before.landmarks.len());
    assert_eq!(after, before);
}
