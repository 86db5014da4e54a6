//! Maps that state which places look alike.

use std::collections::BTreeSet;

use map::contents::AliasProblem;
use map::{Alias, ContentsError, KeyframeAliases, MapContents, edit, store};
use nalgebra::Vector3;
use testing::{Place, PlaceOptions, add_aliases, add_copy_beside};

fn place(is_searched: bool) -> MapContents {
    let options = PlaceOptions { keyframes: 8, landmarks: 80, ..PlaceOptions::default() };
    let mut contents = Place::new(&options).map;
    contents.sort();
    if is_searched {
        add_aliases(&mut contents);
    }
    contents
}

#[test]
fn what_is_stored_is_read_back() {
    for is_searched in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map");
        let contents = place(is_searched);
        store::save_map(&path, &contents, false).unwrap();
        let read = store::load_map(&path).unwrap().contents;
        assert_eq!((&read.aliases, read.digest()), (&contents.aliases, contents.digest()));
        let (opened, _) = store::open_map(&path).unwrap();
        assert_eq!(opened.contents.aliases, contents.aliases);
    }
}

#[test]
fn the_digest_is_that_of_the_aliases_too() {
    let (without, with) = (place(false), place(true));
    assert_ne!(without.digest(), with.digest());
    let mut other = with.clone();
    other.aliases[3].places[0].log_odds += 0.1;
    assert_ne!(other.digest(), with.digest());
    other = with.clone();
    other.aliases.reverse();
    assert_eq!(other.digest(), with.digest());
}

#[test]
fn impossible_aliases_are_refused() {
    let problem = |change: &dyn Fn(&mut MapContents)| {
        let mut contents = place(true);
        change(&mut contents);
        match contents.validate().unwrap_err() {
            ContentsError::Aliases { problem, .. } => problem,
            error => panic!("{error}"),
        }
    };
    place(true).validate().unwrap();
    assert_eq!(problem(&|map| map.aliases[1].keyframe = map.aliases[0].keyframe), AliasProblem::Duplicate);
    let unknown = AliasProblem::UnknownKeyframe { keyframe: 999 };
    assert_eq!(problem(&|map| map.aliases[1].keyframe = 999), unknown);
    assert_eq!(problem(&|map| map.aliases[0].places[0].keyframe = 999), unknown);
    assert_eq!(
        problem(&|map| map.aliases[0].places[0].keyframe = map.aliases[0].keyframe),
        AliasProblem::Itself
    );
    let odds = problem(&|map| map.aliases[3].places[0].log_odds = f64::INFINITY);
    assert!(matches!(odds, AliasProblem::LogOdds { .. }), "{odds}");
}

#[test]
fn those_of_keyframes_that_are_taken_out_go_with_them() {
    let mut contents = place(true);
    let ids: Vec<u64> = contents.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let Alias { keyframe: other, .. } = contents.aliases[0].places[0];
    edit::remove_keyframes(&mut contents, &BTreeSet::from([other, ids[3]]));
    contents.validate().unwrap();
    assert_eq!(contents.aliases.len(), ids.len() - 2);
    assert!(contents.aliases[0].places.is_empty());
}

/// Two copies of a place side by side, of each of which each keyframe looks like that of the other.
fn repeated_place() -> MapContents {
    let place = Place::new(&PlaceOptions { keyframes: 6, landmarks: 3000, ..PlaceOptions::default() });
    let mut map = place.map;
    add_copy_beside(&mut map, Vector3::new(0.0, 50.0, 0.0), [100, 1_000_000]);
    let ids: Vec<u64> = map.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let alias = |id: u64| KeyframeAliases {
        keyframe: id,
        places: vec![Alias { keyframe: if id < 100 { id + 100 } else { id - 100 }, log_odds: id as f64 }],
    };
    map.aliases = ids.into_iter().map(alias).collect();
    map.sort();
    map.validate().unwrap();
    map
}

#[test]
fn a_thinned_map_knows_as_well_as_before_which_of_its_places_look_alike() {
    let mut map = repeated_place();
    let ids: Vec<u64> = map.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let removed: BTreeSet<u64> = ids.iter().copied().step_by(2).collect();
    edit::remove_keyframes(&mut map, &removed);
    map.validate().unwrap();
    assert_eq!(map.aliases.len(), ids.len() - removed.len());
    for aliases in &map.aliases {
        let [place] = aliases.places.as_slice() else { panic!("{aliases:?}") };
        assert!(!removed.contains(&place.keyframe), "{aliases:?}");
        assert_ne!(place.keyframe < 100, aliases.keyframe < 100, "{aliases:?}");
        assert!((place.log_odds - aliases.keyframe as f64).abs() < 1e-12);
    }
}

#[test]
fn an_alias_goes_with_the_last_keyframe_of_its_place() {
    let mut map = repeated_place();
    let removed: BTreeSet<u64> = (100..200).collect();
    edit::remove_keyframes(&mut map, &removed);
    assert!(!map.aliases.is_empty() && map.aliases.iter().all(|aliases| aliases.places.is_empty()));
}
