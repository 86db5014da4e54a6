//! Landmarks of added kinds in a map whose poses have moved.

use map::contents::MapContents;
use map::{AddedFeatures, Landmark};
use nalgebra::Vector3;

use crate::stored_landmarks::StoredLandmarks;

/// Moves the landmarks of added kinds to where their pixels show them from the poses of the map. One that a single keyframe sees, or that
/// the poses do not explain, stays where it is in its anchor.
pub(crate) fn place_added(contents: &mut MapContents) {
    let added = std::mem::take(&mut contents.added_features);
    contents.added_features = added.into_iter().map(|added| placed(contents, added)).collect();
}

fn placed(map: &MapContents, added: AddedFeatures) -> AddedFeatures {
    let known = StoredLandmarks::of_added(map, &added);
    let position = |landmark: &Landmark| {
        let has_parallax = landmark.observations.len() > 1;
        if has_parallax { known.placed(landmark.id) } else { None }
    };
    let positions: Vec<Option<Vector3<f64>>> = added.landmarks.iter().map(position).collect();
    let AddedFeatures { kind, mut landmarks } = added;
    for (landmark, position) in landmarks.iter_mut().zip(positions) {
        landmark.position_in_anchor = position.unwrap_or(landmark.position_in_anchor);
    }
    AddedFeatures { kind, landmarks }
}

#[cfg(test)]
mod tests {
    use testing::{Place, PlaceOptions, add_second_kind};

    use super::*;

    /// Where all poses are further apart by a factor, the same pixels show all landmarks further away by it.
    #[test]
    fn landmarks_follow_the_scale_of_the_poses() {
        let mut map =
            Place::new(&PlaceOptions { keyframes: 12, landmarks: 300, ..PlaceOptions::default() }).map;
        add_second_kind(&mut map, "other-1");
        place_added(&mut map);
        let before = map.added_features[0].landmarks.clone();
        let scale = 1.01;
        for keyframe in &mut map.keyframes {
            keyframe.global_from_keyframe.pose.translation *= scale;
        }
        place_added(&mut map);
        let mut moved = 0;
        for (before, after) in before.iter().zip(&map.added_features[0].landmarks) {
            if before.observations.len() < 2 {
                assert_eq!(before.position_in_anchor, after.position_in_anchor);
                continue;
            }
            let error = after.position_in_anchor - before.position_in_anchor * scale;
            assert!(error.norm() < 1e-6 * before.position_in_anchor.norm(), "{error}");
            moved += 1;
        }
        assert!(moved > 60, "{moved}");
        map.validate().unwrap();
    }
}
