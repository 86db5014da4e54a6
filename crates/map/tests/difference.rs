//! The difference of two maps counts what is new, gone and moved, says where, and does not depend on what both have.

use geometry::Pose;
use map::difference::{Compared, MapDifference, PLACE_SIZE_M};
use map::edit::{keyframes_where, remove_keyframes};
use map::{Keyframe, MapContents};
use nalgebra::Vector3;
use testing::{Place, PlaceOptions};

fn place() -> MapContents {
    let mut map = Place::new(&PlaceOptions { landmarks: 300, ..PlaceOptions::default() }).map;
    map.sort();
    map
}

fn between(before: &MapContents, now: &MapContents) -> MapDifference {
    MapDifference::between(&Compared::of(before), &Compared::of(now))
}

fn position(keyframe: &Keyframe) -> Vector3<f64> {
    keyframe.global_from_keyframe.pose.translation
}

#[test]
fn a_map_and_itself_differ_in_nothing() {
    let map = place();
    assert!(between(&map, &map).is_empty());
    let mut rounded = map.clone();
    rounded.keyframes[3].global_from_keyframe.pose.translation.x += 1e-9;
    assert!(between(&map, &rounded).is_empty());
}

#[test]
fn what_is_taken_out_is_gone_one_way_and_new_the_other() {
    let map = place();
    let mut less = map.clone();
    let ids: Vec<u64> = map.keyframes[..4].iter().map(|keyframe| keyframe.id).collect();
    let chosen = keyframes_where(&less, |keyframe| ids.contains(&keyframe.id));
    remove_keyframes(&mut less, &chosen);
    less.sort();
    let (gone, new) = (between(&map, &less), between(&less, &map));
    assert_eq!((gone.keyframes.removed, gone.keyframes.added, gone.keyframes.moved), (4, 0, 0));
    assert_eq!((new.keyframes.added, new.keyframes.removed), (4, 0));
    assert_eq!(gone.landmarks.removed, map.landmarks.len() - less.landmarks.len());
    assert_eq!(new.landmarks.added, gone.landmarks.removed);
    let by_place: usize = gone.places.iter().map(|place| place.keyframes.removed).sum();
    assert_eq!(by_place, 4);
}

#[test]
fn a_corner_that_moved_is_named_with_the_size_of_its_motion() {
    let map = place();
    let corner = position(&map.keyframes[0]);
    let shift = Vector3::new(0.2, -0.2, 0.1);
    let mut moved = map.clone();
    let mut ids = Vec::new();
    for keyframe in &mut moved.keyframes {
        let pose = keyframe.global_from_keyframe.pose;
        if (pose.translation - corner).norm() < 3.0 {
            keyframe.global_from_keyframe.pose = Pose::new(pose.rotation, pose.translation + shift);
            ids.push(keyframe.id);
        }
    }
    let anchored = map.landmarks.iter().filter(|landmark| ids.contains(&landmark.anchor)).count();
    let difference = between(&map, &moved);
    assert_eq!((difference.keyframes.moved, difference.landmarks.moved), (ids.len(), anchored));
    assert!(!ids.is_empty() && ids.len() < map.keyframes.len() && anchored > 0);
    for motion in [difference.keyframes.motion, difference.landmarks.motion] {
        let motion = motion.unwrap();
        assert!((motion.median_m - 0.3).abs() < 1e-9 && (motion.largest_m - 0.3).abs() < 1e-9, "{motion:?}");
    }
    let with_keyframes = difference.places.iter().filter(|place| place.keyframes.moved > 0);
    for place in with_keyframes {
        let distance = (Vector3::from(place.centre_m) - corner).norm();
        assert!(distance < 3.0 + 2.0 * PLACE_SIZE_M, "{place:?}");
    }
}

#[test]
fn a_keyframe_that_only_turned_has_moved() {
    let map = place();
    let mut turned = map.clone();
    let pose = &mut turned.keyframes[5].global_from_keyframe.pose;
    pose.rotation *= nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, 0.01);
    let difference = between(&map, &turned);
    assert_eq!(difference.keyframes.moved, 1);
    assert!(difference.keyframes.motion.unwrap().largest_m < 1e-12);
}
