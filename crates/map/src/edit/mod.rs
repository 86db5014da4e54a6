//! Changing a map by hand: keyframes and landmarks are taken out, what stays keeps its ids and poses.

mod part;
mod redundancy;

pub use part::part_of;
pub use redundancy::{MIN_OTHERS, redundant_keyframes};

use std::collections::{BTreeMap, BTreeSet};

use geometry::Pose;
use nalgebra::Vector3;
use protocol::KeyframeId;

use crate::contents::MapContents;
use crate::model::{Keyframe, Landmark};

/// A box in G with sides along its axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    /// Smallest coordinates (m).
    pub min: Vector3<f64>,
    /// Largest coordinates (m).
    pub max: Vector3<f64>,
}

impl Region {
    /// Whether a position (m) is inside.
    pub fn contains(&self, position: &Vector3<f64>) -> bool {
        (0..3).all(|axis| (self.min[axis]..=self.max[axis]).contains(&position[axis]))
    }
}

/// The keyframes that a condition holds for.
pub fn keyframes_where(contents: &MapContents, holds: impl Fn(&Keyframe) -> bool) -> BTreeSet<KeyframeId> {
    contents.keyframes.iter().filter(|keyframe| holds(keyframe)).map(|keyframe| keyframe.id).collect()
}

/// Takes keyframes out of a map, with their observations, cross-covariances, common errors, aliases and images.
///
/// A landmark whose anchor is taken out is expressed in the frame of the next keyframe that observes it; one that no keyframe
/// observes any more is taken out, too. Poses and covariances of the others stay: they say what was learned from all.
///
/// # Example
/// ```
/// use map::{MapContents, MapMetadata, edit};
/// use protocol::DescriptorKind;
///
/// let mut map = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
/// let old = edit::keyframes_where(&map, |keyframe| keyframe.stamp_ns < 1_700_000_000_000_000_000);
/// edit::remove_keyframes(&mut map, &old);
/// map.validate()?;
/// # Ok::<(), map::ContentsError>(())
/// ```
pub fn remove_keyframes(contents: &mut MapContents, removed: &BTreeSet<KeyframeId>) {
    let poses: BTreeMap<KeyframeId, Pose> =
        contents.keyframes.iter().map(|keyframe| (keyframe.id, keyframe.global_from_keyframe.pose)).collect();
    contents.keyframes.retain(|keyframe| !removed.contains(&keyframe.id));
    for landmarks in contents.landmarks_of_kinds_mut() {
        for landmark in landmarks.iter_mut() {
            landmark.observations.retain(|observation| !removed.contains(&observation.keyframe));
            let Some(next) = landmark.observations.first() else { continue };
            if removed.contains(&landmark.anchor) {
                let in_global = poses[&landmark.anchor].transform(&landmark.position_in_anchor);
                landmark.anchor = next.keyframe;
                landmark.position_in_anchor = poses[&next.keyframe].inverse_transform(&in_global);
            }
        }
        landmarks.retain(|landmark| !landmark.observations.is_empty());
    }
    contents.drop_dangling();
}

/// Takes out the landmarks, of all kinds of features, for whose position in G (m) a condition does not hold.
pub fn retain_landmarks(contents: &mut MapContents, holds: impl Fn(&Vector3<f64>) -> bool) {
    let poses: BTreeMap<KeyframeId, Pose> =
        contents.keyframes.iter().map(|keyframe| (keyframe.id, keyframe.global_from_keyframe.pose)).collect();
    let position = |landmark: &Landmark| poses[&landmark.anchor].transform(&landmark.position_in_anchor);
    for landmarks in contents.landmarks_of_kinds_mut() {
        landmarks.retain(|landmark| holds(&position(landmark)));
    }
    contents.drop_existence_of_others();
}
