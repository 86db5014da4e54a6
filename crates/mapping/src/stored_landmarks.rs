//! The landmarks of a stored map by their ids, and the keyframes that observe them.

use std::collections::{BTreeMap, BTreeSet};

use adjustment::{InverseDepthLandmark, LandmarkPrior, StoredObserver};
use map::AddedFeatures;
use map::contents::MapContents;
use map::model::Landmark;
use nalgebra::{Vector2, Vector3};
use protocol::{KeyframeId, LandmarkId};

/// The landmarks of a map.
pub(super) struct StoredLandmarks<'a> {
    map: &'a MapContents,
    sigma_px: f64,
    by_id: BTreeMap<LandmarkId, &'a Landmark>,
    /// Position of each keyframe in the map.
    keyframes: BTreeMap<KeyframeId, usize>,
}

impl<'a> StoredLandmarks<'a> {
    /// Those of the primary kind of a map.
    pub(super) fn of_map(map: &'a MapContents) -> StoredLandmarks<'a> {
        StoredLandmarks::new(map, &map.landmarks, map.info.sigma_px)
    }

    /// Those of another kind, in the keyframes of a map.
    pub(super) fn of_added(map: &'a MapContents, added: &'a AddedFeatures) -> StoredLandmarks<'a> {
        StoredLandmarks::new(map, &added.landmarks, added.kind.sigma_px)
    }

    fn new(map: &'a MapContents, landmarks: &'a [Landmark], sigma_px: f64) -> StoredLandmarks<'a> {
        let by_id = landmarks.iter().map(|landmark| (landmark.id, landmark)).collect();
        let keyframes = map.keyframes.iter().map(|keyframe| keyframe.id).zip(0..).collect();
        StoredLandmarks { map, sigma_px, by_id, keyframes }
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
        LandmarkPrior::landmark(id, &landmark.position_in_anchor, &observers, self.sigma_px)
    }

    /// Where its pixels show a landmark from the poses of the map, in the camera of its anchor (m).
    pub(super) fn placed(&self, id: LandmarkId) -> Option<Vector3<f64>> {
        let landmark = self.with_prior(id, 0)?;
        Some(landmark.ray.push(1.0) / landmark.inverse_depth)
    }
}
