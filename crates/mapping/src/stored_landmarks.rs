//! The landmarks of a stored map by their ids, and the keyframes that observe them.

use std::collections::{BTreeMap, BTreeSet};

use adjustment::{InverseDepthLandmark, LandmarkPrior, StoredObserver};
use map::contents::MapContents;
use map::model::Landmark;
use nalgebra::Vector2;
use protocol::{KeyframeId, LandmarkId};

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

    /// A landmark with its prior. Its anchor stays.
    ///
    /// # Arguments
    /// * `first`: view of the first keyframe.
    pub(super) fn with_prior(&self, id: LandmarkId, first: usize) -> Option<InverseDepthLandmark> {
        let landmark = self.by_id.get(&id)?;
        let mut observers: Vec<StoredObserver<'_>> = Vec::with_capacity(landmark.observations.len());
        for observation in &landmark.observations {
            let at = *self.keyframes.get(&observation.keyframe)?;
            let keyframe = &self.map.keyframes[at];
            observers.push(StoredObserver {
                view: first + at,
                pose: keyframe.global_from_keyframe.pose,
                camera: &keyframe.camera,
                pixel: Vector2::from(observation.pixel.map(f64::from)),
            });
        }
        let anchor = landmark.observations.iter().position(|seen| seen.keyframe == landmark.anchor)?;
        observers.swap(0, anchor);
        LandmarkPrior::landmark(id, &landmark.position_in_anchor, &observers, self.map.info.sigma_px)
    }
}
