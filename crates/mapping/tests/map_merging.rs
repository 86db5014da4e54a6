//! Two maps of one place made one: as accurate and as uncertain as it states.

use std::collections::BTreeMap;

use crate::common::map_errors::with_common_errors;
use crate::common::sessions::{ALL_TRACKS, FEW_TRACKS, build, nees, sessions, sessions_with};
use map::contents::MapContents;
use map::model::{Keyframe, Landmark};
use mapping::{MergeError, MergeReport, merge_maps};
use nalgebra::Vector2;
use testing::add_second_kind;

fn merge(first: &MapContents, second: &MapContents) -> Result<(MapContents, MergeReport), MergeError> {
    merge_maps(first, second, &mut |_, _, _| {})
}

/// Merges the maps of two rounds, each built by itself; with an even seed they state common errors, as large maps do.
///
/// # Returns
/// Mean square error of the first map's positions before and after (m^2).
fn errors_are_as_stated(max_tracks: usize, seeds: std::ops::RangeInclusive<u64>) -> [f64; 2] {
    let count = seeds.clone().count() as f64;
    let (mut sum, mut all, mut squares) = (0.0, 0.0, [0.0; 2]);
    for seed in seeds {
        let (mut parts, whole) = sessions_with(max_tracks, seed, 2, 1.2);
        let [mut first, mut second] = [0, 1].map(|at| build(&mut parts[at]));
        let stored = first.keyframes.len();
        let (of_first, freedom, before_m) = nees(&whole, &first, &first);
        if seed.is_multiple_of(2) {
            [first, second] = [first, second].map(|map| with_common_errors(&map));
        }
        let (merged, report) = merge(&first, &second).unwrap();
        assert_eq!((merged.info.sessions.len(), merged.audit_sessions()), (2, Vec::new()));
        let (of_both, freedom_of_both, after_m) = nees(&whole, &merged, &first);
        println!(
            "seed {seed}: NEES {:.2}, {before_m:.4} m -> {:.2}, {after_m:.4} m; {report:?}",
            of_first / freedom,
            of_both / freedom_of_both
        );
        assert!(report.sigma_after_m < report.sigma_before_m, "{report:?}");
        assert_eq!(merged.keyframes.len(), stored + second.keyframes.len());
        assert_eq!(
            merged.landmarks.len(),
            report.landmarks[0] + report.landmarks[1] - report.common_landmarks
        );
        sum += of_both;
        all += freedom_of_both;
        squares[0] += before_m.powi(2);
        squares[1] += after_m.powi(2);
    }
    let ratio = sum / all;
    println!("NEES {ratio:.2}");
    assert!((0.7..1.4).contains(&ratio), "NEES {ratio}");
    squares.map(|sum| sum / count)
}

#[test]
fn errors_of_two_merged_maps_are_as_stated() {
    errors_are_as_stated(FEW_TRACKS, 1..=1);
}

#[test]
#[ignore = "takes minutes"]
fn errors_of_twenty_merged_maps_are_as_stated() {
    let [before, after] = errors_are_as_stated(ALL_TRACKS, 1..=20);
    println!("{:.4} -> {:.4} m", before.sqrt(), after.sqrt());
    assert!(after < before);
}

#[test]
fn a_map_whose_ids_begin_with_zero_gets_others() {
    let (mut parts, _) = sessions(3, 2, 1.2);
    let [mut first, mut second] = [0, 1].map(|at| build(&mut parts[at]));
    assert_eq!((second.keyframes[0].id, second.info.sessions[0].keyframe_ids[0]), (1, 1));
    second.aliases.clear();
    second.info.sessions[0].keyframe_ids = second.info.sessions[0].keyframe_ids.map(|id| id - 1);
    second.keyframes.iter_mut().for_each(|keyframe| keyframe.id -= 1);
    second.common_errors.iter_mut().for_each(|common| common.keyframe -= 1);
    for cross in &mut second.cross_covariances {
        (cross.a, cross.b) = (cross.a - 1, cross.b - 1);
    }
    let smallest = second.landmarks.iter().map(|landmark| landmark.id).min().unwrap();
    for landmark in &mut second.landmarks {
        (landmark.id, landmark.anchor) = (landmark.id - smallest, landmark.anchor - 1);
        landmark.observations.iter_mut().for_each(|observation| observation.keyframe -= 1);
    }
    add_second_kind(&mut first, "of-both-1");
    add_second_kind(&mut second, "of-one-1");
    add_second_kind(&mut second, "of-both-1");
    second.validate().unwrap();
    let (merged, report) = merge(&first, &second).unwrap();
    check_added_kinds(&merged, &first, &second);
    assert_eq!(merged.keyframes.len(), first.keyframes.len() + second.keyframes.len());
    assert_eq!(
        merged.landmarks.len() + report.common_landmarks,
        first.landmarks.len() + second.landmarks.len()
    );
    assert_eq!((merged.info.sessions.len(), merged.audit_sessions()), (2, Vec::new()));
}

/// Features of added kinds are copies of the map's own: they are where these are.
fn check_added_kinds(merged: &MapContents, first: &MapContents, second: &MapContents) {
    let [of_both, of_one] = &merged.added_features[..] else {
        panic!("{} kinds", merged.added_features.len())
    };
    assert_eq!((&*of_both.kind.extractor, &*of_one.kind.extractor), ("of-both-1", "of-one-1"));
    let count = |map: &MapContents, at: usize| map.added_features[at].landmarks.len();
    assert_eq!(of_both.landmarks.len(), count(first, 0) + count(second, 1));
    assert_eq!(of_one.landmarks.len(), count(second, 0));
    let copies = merged.added_features.iter().flat_map(|added| &added.landmarks);
    let [own_px, of_copies_px] = [error_px(merged, merged.landmarks.iter()), error_px(merged, copies)];
    assert!(of_copies_px < 1.05 * own_px && own_px < 2.0, "{own_px} {of_copies_px}");
}

/// How far landmarks are from their pixels, root mean square per axis.
fn error_px<'a>(map: &MapContents, landmarks: impl Iterator<Item = &'a Landmark>) -> f64 {
    let keyframes: BTreeMap<u64, &Keyframe> =
        map.keyframes.iter().map(|keyframe| (keyframe.id, keyframe)).collect();
    let mut squares: Vec<f64> = Vec::new();
    for landmark in landmarks {
        let position =
            keyframes[&landmark.anchor].global_from_keyframe.pose.transform(&landmark.position_in_anchor);
        for seen in &landmark.observations {
            let Keyframe { camera, global_from_keyframe, .. } = keyframes[&seen.keyframe];
            let Ok(pixel) = camera.project(&global_from_keyframe.pose.inverse_transform(&position)) else {
                continue;
            };
            squares.push((pixel - Vector2::from(seen.pixel.map(f64::from))).norm_squared());
        }
    }
    (squares.iter().sum::<f64>() / (2 * squares.len()) as f64).sqrt()
}

#[test]
fn maps_that_cannot_be_merged_are_refused_in_words() {
    let (mut parts, _) = sessions(1, 2, 1.2);
    let first = build(&mut parts[0]);
    let said = merge(&first, &first).unwrap_err().to_string();
    assert!(said.contains("one recording") && said.contains("of session"), "{said}");
    let without_ledger = |map: &MapContents| {
        let mut map = map.clone();
        map.info.sessions.clear();
        map
    };
    let said = merge(&without_ledger(&first), &first).unwrap_err().to_string();
    assert!(said.contains("as one of the first"), "{said}");
    let timeless = |map: &MapContents| {
        let mut map = without_ledger(map);
        map.keyframes.iter_mut().for_each(|keyframe| keyframe.stamp_ns = 0);
        map
    };
    let said = merge(&timeless(&first), &timeless(&first)).unwrap_err().to_string();
    assert!(said.contains("both are made of one image"), "{said}");
    let second = build(&mut parts[1]);
    assert!(
        merge(&timeless(&first), &timeless(&second)).is_ok(),
        "times that are not known are not the same"
    );
    let (mut others, _) = sessions(7, 1, 1.2);
    let mut elsewhere = build(&mut others[0]);
    elsewhere.keyframes.iter_mut().for_each(|keyframe| keyframe.stamp_ns += 3_600_000_000_000);
    let said = merge(&first, &elsewhere).unwrap_err().to_string();
    assert!(said.contains("not connected") && said.contains("3 are needed"), "{said}");
    let mut tilted = elsewhere.clone();
    tilted.info.gravity_in_global = None;
    let said = merge(&first, &tilted).unwrap_err().to_string();
    assert!(said.contains("second map must have z up"), "{said}");
    elsewhere.info.extractor = "other-1".to_owned();
    let said = merge(&first, &elsewhere).unwrap_err().to_string();
    assert!(said.contains("different extractors"), "{said}");
}
