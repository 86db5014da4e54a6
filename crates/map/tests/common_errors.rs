//! Maps that state errors common to their keyframes.

use std::collections::BTreeSet;

use map::contents::CommonErrorProblem;
use map::difference::{Compared, VersionChange};
use map::{ContentsError, MapContents, edit, store};
use proptest::prelude::*;
use testing::{Place, PlaceOptions, add_common_errors};

fn place(seed: u64, columns: usize) -> MapContents {
    let options = PlaceOptions { seed, keyframes: 6, landmarks: 80, ..PlaceOptions::default() };
    let mut contents = Place::new(&options).map;
    if columns > 0 {
        add_common_errors(&mut contents, columns);
    }
    contents
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    #[test]
    fn what_is_stored_is_read_back(seed in 0_u64..1000, columns in 0_usize..9) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map");
        let mut contents = place(seed, columns);
        let saved = store::save_map(&path, &contents, false).unwrap();
        (contents.info.version, contents.info.identity) = (saved.version, Some(saved.identity));
        let read = store::load_map(&path).unwrap();
        prop_assert_eq!(read.contents.digest(), contents.digest());
        prop_assert_eq!(&read.contents, &contents);
        let (opened, _) = store::open_map(&path).unwrap();
        prop_assert_eq!(opened.contents.common_errors, contents.common_errors);
    }
}

#[test]
fn the_digest_is_that_of_the_common_errors_too() {
    let (without, with) = (place(1, 0), place(1, 3));
    assert_ne!(without.digest(), with.digest());
    let mut other = with.clone();
    other.common_errors[2].factor[(4, 1)] *= 1.01;
    assert_ne!(other.digest(), with.digest());
    other = with.clone();
    other.common_errors.reverse();
    assert_eq!(other.digest(), with.digest());
}

#[test]
fn impossible_common_errors_are_refused() {
    let problem = |change: &dyn Fn(&mut MapContents)| {
        let mut contents = place(2, 3);
        change(&mut contents);
        match contents.validate().unwrap_err() {
            ContentsError::CommonError { problem, .. } => problem,
            error => panic!("{error}"),
        }
    };
    place(2, 3).validate().unwrap();
    assert_eq!(problem(&|map| map.common_errors[1].keyframe = 999), CommonErrorProblem::UnknownKeyframe);
    assert_eq!(
        problem(&|map| map.common_errors[1].keyframe = map.common_errors[0].keyframe),
        CommonErrorProblem::Duplicate
    );
    let columns = CommonErrorProblem::Columns { found: 2, expected: 3 };
    let cut = |map: &mut MapContents| {
        map.common_errors[1].factor = map.common_errors[1].factor.clone().remove_column(0);
    };
    assert_eq!(problem(&cut), columns);
    for factor in [1e3, f64::NAN] {
        let remaining = problem(&|map| map.common_errors[3].factor *= factor);
        assert!(matches!(remaining, CommonErrorProblem::Remaining(_)), "{remaining}");
    }
    // The blocks of pairs add to the covariance of the common error.
    let mut contents = place(2, 3);
    contents.cross_covariances[0].block *= 2.4;
    let alone = MapContents { common_errors: Vec::new(), ..contents.clone() };
    alone.validate().unwrap();
    assert!(matches!(contents.validate(), Err(ContentsError::CrossCovariance { .. })));
}

#[test]
fn keyframes_that_are_taken_out_take_theirs_along() {
    let mut contents = place(3, 4);
    let before = contents.clone();
    let removed: BTreeSet<u64> = [before.keyframes[1].id, before.keyframes[4].id].into();
    edit::remove_keyframes(&mut contents, &removed);
    contents.validate().unwrap();
    let stayed = before.common_errors.iter().filter(|common| !removed.contains(&common.keyframe));
    assert!(contents.common_errors.iter().eq(stayed));
}

#[test]
fn a_change_beyond_rounding_is_one() {
    let contents = place(4, 3);
    let moved = |change: &dyn Fn(&mut MapContents)| {
        let mut now = contents.clone();
        change(&mut now);
        VersionChange::between(&Compared::of(&contents), &Compared::of(&now), 0).moved.len()
    };
    let shifted = |by: f64| {
        moved(&|now: &mut MapContents| now.common_errors[2].factor[(3, 1)] += by * testing::SIGMA_P)
    };
    // Where one has another common error, what all have in common is.
    let all = contents.keyframes.len();
    assert_eq!((moved(&|_| {}), shifted(1e-9), shifted(1e-3)), (0, 0, all));
    assert_eq!(moved(&|now| _ = now.common_errors.remove(2)), all);
    let narrowed = |now: &mut MapContents| {
        let factor = &mut now.common_errors[2].factor;
        *factor = factor.clone().remove_column(2);
    };
    assert_eq!(moved(&narrowed), all);
}
