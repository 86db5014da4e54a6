//! The landmarks of a stored map by their ids, and the keyframes that observe them.

use std::collections::{BTreeMap, BTreeSet};

use map::contents::MapContents;
use map::model::Landmark;
use protocol::{KeyframeId, LandmarkId};

use super::landmark::InverseDepthLandmark;
use super::landmark_prior::LandmarkPrior;

/// The landmarks of a map.
pub(super) struct StoredLandmarks<'a> {
    map: &'a MapContents,
    by_id: BTreeMap<LandmarkId, &'a Landmark>,
    /// Position of each keyframe in the map.
    keyframes: BTreeMap<KeyframeId, usize>,
}

impl<'a> StoredLandmarks<'a> {
    /// Of a map.
    pub(super) fn of_map(map: &'a MapContents) -> StoredLandmarks<'a> {
        let by_id = map.landmarks.iter().map(|landmark| (landmark.id, landmark)).collect();
        let keyframes = map.keyframes.iter().map(|keyframe| keyframe.id).zip(0..).collect();
        StoredLandmarks { map, by_id, keyframes }
    }

    /// Positions in the map of the keyframes that observe some landmarks.
    pub(super) fn observers(&self, landmarks: impl Iterator<Item = LandmarkId>) -> BTreeSet<usize> {
        let observations = landmarks.filter_map(|id| self.by_id.get(&id));
        let keyframes = observations.flat_map(|landmark| &landmark.observations).map(|seen| seen.keyframe);
        keyframes.filter_map(|id| self.keyframes.get(&id).copied()).collect()
    }

    /// A landmark with its prior, see [`LandmarkPrior::of_map`].
    ///
    /// # Arguments
    /// * `first`: view of the first keyframe.
    pub(super) fn with_prior(&self, id: LandmarkId, first: usize) -> Option<InverseDepthLandmark> {
        LandmarkPrior::of_map(self.map, &self.keyframes, first, self.by_id.get(&id)?)
    }
}
