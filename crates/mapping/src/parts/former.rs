//! What putting a part back can change of a map, as it was before.

use std::collections::BTreeSet;

use map::contents::MapContents;
use map::model::Landmark;
use protocol::{KeyframeId, LandmarkId};

/// What [`put_back`](super::put_back) can change of a map, as it was before: a copy of the part, and of the lists that are small.
///
/// Of a map with features of added kinds, all of these are copied.
#[derive(Clone, Debug)]
pub struct Former {
    part: BTreeSet<KeyframeId>,
    keyframes: BTreeSet<KeyframeId>,
    /// The largest id of its landmarks; those that a recording brings come after it.
    last_landmark: Option<LandmarkId>,
    landmarks: BTreeSet<LandmarkId>,
    /// What is or was there of these.
    copy: MapContents,
}

impl Former {
    /// # Arguments
    /// * `map`: sorted.
    /// * `before`: the part as [`part_of`](map::edit::part_of) gives it.
    /// * `after`: the same, as it is to be put back.
    pub fn of(map: &MapContents, before: &MapContents, after: &MapContents) -> Former {
        let ids = |contents: &MapContents| contents.keyframes.iter().map(|keyframe| keyframe.id).collect();
        let (part, left): (BTreeSet<KeyframeId>, BTreeSet<KeyframeId>) = (ids(before), ids(after));
        let landmarks: BTreeSet<LandmarkId> = before.landmarks.iter().map(|landmark| landmark.id).collect();
        let of_part = |id: &KeyframeId| part.contains(id);
        // Those of keyframes that stay are not touched.
        let is_lost = |id: &KeyframeId| part.contains(id) && !left.contains(id);
        let copy = MapContents {
            keyframes: map.keyframes.iter().filter(|of| of_part(&of.id)).cloned().collect(),
            landmarks: map.landmarks.iter().filter(|of| landmarks.contains(&of.id)).cloned().collect(),
            cross_covariances: {
                let lost = map.cross_covariances.iter().filter(|of| is_lost(&of.a) || is_lost(&of.b));
                lost.cloned().collect()
            },
            common_errors: map.common_errors.iter().filter(|of| of_part(&of.keyframe)).cloned().collect(),
            aliases: map.aliases.clone(),
            added_features: map.added_features.clone(),
            images: map.images.iter().filter(|of| is_lost(&of.keyframe)).cloned().collect(),
            existence: map.existence.clone(),
            ..MapContents::empty(map.info.clone())
        };
        let last_landmark = map.landmarks.iter().map(|landmark| landmark.id).max();
        Former { part, keyframes: ids(map), last_landmark, landmarks, copy }
    }

    /// Gives a map back what it was, to the bit.
    ///
    /// # Arguments
    /// * `map`: the one that this was made of, after [`put_back`](super::put_back), and after its aliases were found.
    pub fn restore(self, map: &mut MapContents) {
        let Former { part, keyframes, last_landmark, landmarks, copy } = self;
        let is_untouched = |of: &Landmark| Some(of.id) <= last_landmark && !landmarks.contains(&of.id);
        map.keyframes.retain(|of| keyframes.contains(&of.id) && !part.contains(&of.id));
        map.keyframes.extend(copy.keyframes);
        map.landmarks.retain(is_untouched);
        map.landmarks.extend(copy.landmarks);
        map.cross_covariances.retain(|of| keyframes.contains(&of.a) && keyframes.contains(&of.b));
        map.cross_covariances.extend(copy.cross_covariances);
        map.common_errors.retain(|of| keyframes.contains(&of.keyframe) && !part.contains(&of.keyframe));
        map.common_errors.extend(copy.common_errors);
        map.images.extend(copy.images);
        (map.info, map.aliases) = (copy.info, copy.aliases);
        (map.added_features, map.existence) = (copy.added_features, copy.existence);
        map.sort();
    }
}
