//! Changing a map by hand: keyframes and landmarks are taken out, what stays keeps its ids and poses.

mod alias_neighbours;
mod part;
mod redundancy;

pub use part::part_of;
pub use redundancy::{MIN_OTHERS, redundant_keyframes};

use std::collections::{BTreeMap, BTreeSet};

use geometry::Pose;
use nalgebra::Vector3;
use protocol::KeyframeId;

use crate::contents::MapContents;
use crate::model::{Keyframe, Landmark, Observation};

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
/// A landmark whose anchor is taken out is anchored in the next keyframe that observes it, at the depth that the poses give on the ray
/// of that keyframe's own pixel; one that no keyframe observes any more is taken out, too. Poses and covariances of the others stay:
/// they say what was learned from all. An alias of a place that other keyframes show, too, names one of these.
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
    alias_neighbours::name_neighbours(contents, removed);
    let stays = |keyframe: KeyframeId| !removed.contains(&keyframe);
    let mut keyframes = std::mem::take(&mut contents.keyframes);
    let observers = by_id(&keyframes);
    for landmarks in contents.landmarks_of_kinds_mut() {
        landmarks.retain_mut(|landmark| keep_observations(landmark, &observers, stays));
    }
    keyframes.retain(|keyframe| stays(keyframe.id));
    contents.keyframes = keyframes;
    contents.drop_dangling();
}

fn by_id(keyframes: &[Keyframe]) -> BTreeMap<KeyframeId, &Keyframe> {
    keyframes.iter().map(|keyframe| (keyframe.id, keyframe)).collect()
}

/// Leaves a landmark the observations of some keyframes, anchored in one of them where its anchor was another one.
///
/// # Arguments
/// * `keyframes`: all that observe it.
///
/// # Returns
/// Whether there are any.
fn keep_observations(
    landmark: &mut Landmark,
    keyframes: &BTreeMap<KeyframeId, &Keyframe>,
    stays: impl Fn(KeyframeId) -> bool,
) -> bool {
    landmark.observations.retain(|observation| stays(observation.keyframe));
    if landmark.observations.is_empty() {
        return false;
    }
    if stays(landmark.anchor) {
        return true;
    }
    let Some(before) = keyframes.get(&landmark.anchor) else { return false };
    let in_global = before.global_from_keyframe.pose.transform(&landmark.position_in_anchor);
    let Some((anchor, position)) = anchored(&landmark.observations, keyframes, &in_global) else {
        return false;
    };
    landmark.anchor = anchor;
    landmark.position_in_anchor = position;
    true
}

/// The first observer that has a landmark in front of its camera, and the position there, see [`Keyframe::point_on_ray`]; where none
/// has, the first one and the position that the poses give.
///
/// # Arguments
/// * `in_global`: position of the landmark in G (m).
fn anchored(
    observations: &[Observation],
    keyframes: &BTreeMap<KeyframeId, &Keyframe>,
    in_global: &Vector3<f64>,
) -> Option<(KeyframeId, Vector3<f64>)> {
    let in_front = observations.iter().find_map(|seen| {
        let position = keyframes.get(&seen.keyframe)?.point_on_ray(seen.pixel, in_global)?;
        Some((seen.keyframe, position))
    });
    in_front.or_else(|| {
        let first = keyframes.get(&observations.first()?.keyframe)?;
        Some((first.id, first.global_from_keyframe.pose.inverse_transform(in_global)))
    })
}

/// Takes out the landmarks, of all kinds of features, for whose position in G (m) a condition does not hold.
pub fn retain_landmarks(contents: &mut MapContents, holds: impl Fn(&Vector3<f64>) -> bool) {
    let poses = contents.keyframe_poses();
    for landmarks in contents.landmarks_of_kinds_mut() {
        retain_where(landmarks, &poses, &holds);
    }
    contents.drop_existence_of_others();
}

/// As [`retain_landmarks`], those of added kinds of features only.
pub fn retain_added_landmarks(contents: &mut MapContents, holds: impl Fn(&Vector3<f64>) -> bool) {
    let poses = contents.keyframe_poses();
    for added in &mut contents.added_features {
        retain_where(&mut added.landmarks, &poses, &holds);
    }
}

fn retain_where(
    landmarks: &mut Vec<Landmark>,
    poses: &BTreeMap<KeyframeId, Pose>,
    holds: impl Fn(&Vector3<f64>) -> bool,
) {
    landmarks.retain(|landmark| holds(&poses[&landmark.anchor].transform(&landmark.position_in_anchor)));
}
