//! Parts of maps.

use std::collections::BTreeSet;

use map::edit::{part_of, remove_keyframes};
use protocol::KeyframeId;
use testing::{Place, PlaceOptions, add_aliases, add_common_errors, add_existence};

#[test]
fn a_part_is_what_is_left_when_the_other_keyframes_are_taken_out() {
    let mut map = Place::new(&PlaceOptions::default()).map;
    add_common_errors(&mut map, 6);
    add_aliases(&mut map);
    add_existence(&mut map);
    for (first, last) in [(12, 20), (10, 39), (30, 31)] {
        let kept: BTreeSet<KeyframeId> = (first..=last).collect();
        let part = part_of(&map, &kept);
        part.validate().unwrap();
        let mut others = map.keyframes.iter().map(|keyframe| keyframe.id).collect::<BTreeSet<_>>();
        others.retain(|id| !kept.contains(id));
        let mut left = map.clone();
        remove_keyframes(&mut left, &others);
        assert_eq!(part, left);
    }
}
