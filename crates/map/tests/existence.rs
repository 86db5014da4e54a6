//! Maps that state whether their landmarks are still there.

use std::collections::BTreeSet;

use map::contents::ExistenceProblem;
use map::{ContentsError, MapContents, edit, store};
use testing::{Place, PlaceOptions, add_existence};

fn place() -> MapContents {
    let options = PlaceOptions { keyframes: 8, landmarks: 80, ..PlaceOptions::default() };
    let mut contents = Place::new(&options).map;
    add_existence(&mut contents);
    contents
}

#[test]
fn what_is_stored_is_read_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map");
    let contents = place();
    assert!(contents.existence.len() > 10);
    store::save_map(&path, &contents, false).unwrap();
    let read = store::load_map(&path).unwrap().contents;
    assert_eq!((&read.existence, read.digest()), (&contents.existence, contents.digest()));
    let mut other = contents.clone();
    other.existence[2].log_odds -= 0.1;
    assert_ne!(other.digest(), contents.digest());
    other.existence.clear();
    store::save_map(&path, &other, true).unwrap();
    assert_eq!(store::load_map(&path).unwrap().contents.existence, Vec::new());
}

#[test]
fn impossible_existence_is_refused() {
    let problem = |change: &dyn Fn(&mut MapContents)| {
        let mut contents = place();
        change(&mut contents);
        match contents.validate().unwrap_err() {
            ContentsError::Existence { problem, .. } => problem,
            error => panic!("{error}"),
        }
    };
    place().validate().unwrap();
    assert_eq!(problem(&|map| map.existence[1] = map.existence[0]), ExistenceProblem::Duplicate);
    assert_eq!(problem(&|map| map.existence[1].landmark = 999_999), ExistenceProblem::UnknownLandmark);
    let odds = problem(&|map| map.existence[3].log_odds = f64::NAN);
    assert!(matches!(odds, ExistenceProblem::LogOdds { .. }), "{odds}");
}

#[test]
fn that_of_landmarks_that_are_taken_out_goes_with_them() {
    let mut contents = place();
    let first: BTreeSet<u64> = contents.keyframes[..5].iter().map(|keyframe| keyframe.id).collect();
    let before = contents.existence.len();
    edit::remove_keyframes(&mut contents, &first);
    contents.validate().unwrap();
    assert!((1..before).contains(&contents.existence.len()));
    edit::retain_landmarks(&mut contents, |_| false);
    contents.validate().unwrap();
    assert!(contents.existence.is_empty());
}
