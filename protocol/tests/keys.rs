//! Names that would change the meaning of a key never get into one.

use proptest::prelude::*;
use protocol::keys::{self, NameError};

type Builder = fn(&str) -> Result<String, NameError>;

const BUILDERS: [Builder; 10] = [
    keys::map_match,
    keys::map_localize,
    keys::map_info,
    keys::map_keyframes,
    keys::map_changes,
    keys::robot_pose,
    keys::robot_odometry,
    keys::robot_status,
    keys::robot,
    keys::map_server,
];

#[test]
fn keys_are_those_of_the_design() {
    let built: Vec<String> = BUILDERS.iter().map(|build| build("a").unwrap()).collect();
    let expected = [
        "map/a/match",
        "map/a/localize",
        "map/a/info",
        "map/a/keyframes/*",
        "map/a/changes",
        "robot/a/pose",
        "robot/a/odometry",
        "robot/a/status",
        "robot/a",
        "map_server/a",
    ];
    assert_eq!(built, expected);
    assert_eq!(keys::map_keyframe("a", 12).unwrap(), "map/a/keyframes/12");
}

#[test]
fn names_with_a_meaning_in_key_expressions_are_refused_everywhere() {
    for name in ["", "a/b", "*", "**", "a*", "$*", "a#", "a?b", "@a", "a b", "a\n", "a\u{0}", &"a".repeat(65)]
    {
        for build in BUILDERS {
            assert!(build(name).is_err(), "{name:?}");
        }
        assert!(keys::map_keyframe(name, 1).is_err());
    }
}

#[test]
fn the_error_says_what_is_wrong_and_what_to_use() {
    let said = keys::map_match("cellar/*").unwrap_err().to_string();
    assert!(said.contains("cellar/*") && said.contains("'/'") && said.contains("letters"), "{said}");
}

proptest! {
    #[test]
    fn an_accepted_name_is_exactly_one_chunk(name in ".{0,70}") {
        if let Ok(key) = keys::map_match(&name) {
            prop_assert_eq!(key.split('/').collect::<Vec<_>>(), vec!["map", name.as_str(), "match"]);
            prop_assert!(!key.contains(['*', '$', '#', '?']));
        }
    }

    #[test]
    fn a_keyframe_s_key_gives_its_id_back(id: u64, prefix in "([a-z]{1,5}/){0,2}") {
        let key = keys::map_keyframe("cellar", id).unwrap();
        prop_assert_eq!(keys::keyframe_of(&key), Some(id));
        prop_assert_eq!(keys::keyframe_of(&format!("{prefix}{key}")), Some(id));
    }
}

#[test]
fn what_is_no_keyframe_s_key_gives_no_id() {
    for key in ["", "17", "map/a/keyframes", "map/a/keyframes/", "map/a/keyframes/*", "map/a/keyframes/+1"] {
        assert_eq!(keys::keyframe_of(key), None, "{key}");
    }
    assert_eq!(keys::keyframe_of("map/a/keyframes/18446744073709551616"), None);
}
