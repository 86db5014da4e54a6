//! A part of a map: some of its keyframes, and what they observe.

use std::collections::BTreeSet;

use protocol::{KeyframeId, LandmarkId};

use super::{by_id, keep_observations};
use crate::contents::MapContents;
use crate::model::{KeyframeAliases, Landmark};

/// Some keyframes of a map with the landmarks of the primary kind that they observe, as a map: observations and covariances are those
/// within the part. A landmark whose anchor is not in the part is anchored in one of its keyframes, as by [`super::remove_keyframes`].
/// Images are left out.
///
/// # Arguments
/// * `contents`: sorted.
///
/// # Example
/// ```
/// use map::{MapContents, MapMetadata, edit};
/// use protocol::DescriptorKind;
///
/// let map = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
/// let part = edit::part_of(&map, &[4, 5].into());
/// assert!(part.keyframes.is_empty());
/// ```
pub fn part_of(contents: &MapContents, keyframes: &BTreeSet<KeyframeId>) -> MapContents {
    let has = |id: &KeyframeId| keyframes.contains(id);
    let observers = by_id(&contents.keyframes);
    let is_seen = |landmark: &&Landmark| landmark.observations.iter().any(|seen| has(&seen.keyframe));
    let mut landmarks: Vec<Landmark> = contents.landmarks.iter().filter(is_seen).cloned().collect();
    landmarks.retain_mut(|landmark| keep_observations(landmark, &observers, |keyframe| has(&keyframe)));
    let landmark_ids: BTreeSet<LandmarkId> = landmarks.iter().map(|landmark| landmark.id).collect();
    let aliases = contents.aliases.iter().filter(|aliases| has(&aliases.keyframe));
    let within = |aliases: &KeyframeAliases| KeyframeAliases {
        keyframe: aliases.keyframe,
        places: aliases.places.iter().filter(|place| has(&place.keyframe)).copied().collect(),
    };
    MapContents {
        keyframes: contents.keyframes.iter().filter(|keyframe| has(&keyframe.id)).cloned().collect(),
        landmarks,
        cross_covariances: {
            let pairs = contents.cross_covariances.iter();
            pairs.filter(|cross| has(&cross.a) && has(&cross.b)).cloned().collect()
        },
        common_errors: {
            let common = contents.common_errors.iter();
            common.filter(|common| has(&common.keyframe)).cloned().collect()
        },
        aliases: aliases.map(within).collect(),
        existence: {
            let existence = contents.existence.iter();
            existence.filter(|existence| landmark_ids.contains(&existence.landmark)).copied().collect()
        },
        ..MapContents::empty(contents.info.clone())
    }
}
