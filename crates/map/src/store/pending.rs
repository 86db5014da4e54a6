//! A batch before it is written: its net effect on the map, checked against the laws of maps.

use std::collections::{BTreeMap, BTreeSet};

use protocol::{KeyframeId, LandmarkId};

use super::{Change, SledStore, StoreError};
use crate::contents::{self, ContentsError};
use crate::model::{CrossCovariance, Keyframe, Landmark, MapInfo};

/// Net effect of a batch: for each id that it touches, what is there afterwards (`None`: nothing).
#[derive(Default)]
pub(super) struct Pending<'a> {
    pub(super) info: Option<&'a MapInfo>,
    pub(super) keyframes: BTreeMap<KeyframeId, Option<&'a Keyframe>>,
    pub(super) landmarks: BTreeMap<LandmarkId, Option<&'a Landmark>>,
    /// By (a, b) with `a < b`.
    pub(super) cross_covariances: BTreeMap<(KeyframeId, KeyframeId), Option<CrossCovariance>>,
}

impl<'a> Pending<'a> {
    /// Collects the changes in their order, so that a later one wins.
    pub(super) fn collect(batch: &'a [Change], store: &SledStore) -> Result<Pending<'a>, StoreError> {
        let mut pending = Pending::default();
        for change in batch {
            match change {
                Change::PutInfo(info) => pending.info = Some(info),
                Change::PutKeyframe(keyframe) => {
                    pending.keyframes.insert(keyframe.id, Some(keyframe));
                }
                Change::RemoveKeyframe(id) => {
                    pending.keyframes.insert(*id, None);
                    pending.remove_cross_covariances_of(*id, store)?;
                }
                Change::PutLandmark(landmark) => {
                    pending.landmarks.insert(landmark.id, Some(landmark));
                }
                Change::RemoveLandmark(id) => {
                    pending.landmarks.insert(*id, None);
                }
                Change::PutCrossCovariance(cross) => {
                    let ordered = cross.ordered();
                    pending.cross_covariances.insert((ordered.a, ordered.b), Some(ordered));
                }
                Change::RemoveCrossCovariance(a, b) => {
                    pending.cross_covariances.insert(((*a).min(*b), (*a).max(*b)), None);
                }
            }
        }
        Ok(pending)
    }

    fn remove_cross_covariances_of(&mut self, id: KeyframeId, store: &SledStore) -> Result<(), StoreError> {
        self.cross_covariances.retain(|&(a, b), _| a != id && b != id);
        for other in store.correlated_keyframes(id)? {
            self.cross_covariances.insert((id.min(other), id.max(other)), None);
        }
        Ok(())
    }

    /// Checks every record that the batch writes, and every stored one that depends on a keyframe it writes.
    pub(super) fn check(&self, store: &SledStore, stored_info: &MapInfo) -> Result<(), StoreError> {
        let info = self.info.unwrap_or(stored_info);
        contents::check_info(info)?;
        let same_descriptors = info.descriptor_kind == stored_info.descriptor_kind
            && info.descriptor_width == stored_info.descriptor_width;
        if !same_descriptors && !store.holds_nothing() {
            let problem = "a map that holds something keeps its descriptor kind and width".to_owned();
            return Err(ContentsError::Info(problem).into());
        }
        for keyframe in self.keyframes.values().flatten() {
            contents::check_keyframe(info, keyframe)?;
        }

        let mut known = KnownKeyframes { pending: &self.keyframes, loaded: BTreeMap::new() };
        for landmark in self.landmarks.values().flatten() {
            known.check_landmark(store, info, landmark)?;
        }
        for id in self.dependent_landmarks(store)? {
            if let Some(landmark) = super::MapStore::landmark(store, id)? {
                known.check_landmark(store, info, &landmark)?;
            }
        }
        for cross in self.cross_covariances.values().flatten() {
            known.load(store, [cross.a, cross.b])?;
            contents::check_cross_covariance(cross, |id| known.get(id))?;
        }
        for (a, b) in self.dependent_cross_covariances(store)? {
            if let Some(cross) = super::MapStore::cross_covariance(store, a, b)? {
                known.load(store, [a, b])?;
                contents::check_cross_covariance(&cross, |id| known.get(id))?;
            }
        }
        Ok(())
    }

    /// Stored landmarks that this batch does not write, but whose keyframes it does.
    fn dependent_landmarks(&self, store: &SledStore) -> Result<BTreeSet<LandmarkId>, StoreError> {
        let mut dependent = BTreeSet::new();
        for &keyframe in self.keyframes.keys() {
            for landmark in store.observed_landmarks(keyframe)? {
                if !self.landmarks.contains_key(&landmark) {
                    dependent.insert(landmark);
                }
            }
        }
        Ok(dependent)
    }

    /// Stored cross-covariances that this batch does not write, but whose keyframes it does.
    fn dependent_cross_covariances(
        &self,
        store: &SledStore,
    ) -> Result<BTreeSet<(KeyframeId, KeyframeId)>, StoreError> {
        let mut dependent = BTreeSet::new();
        for &keyframe in self.keyframes.keys() {
            for other in store.correlated_keyframes(keyframe)? {
                let pair = (keyframe.min(other), keyframe.max(other));
                if !self.cross_covariances.contains_key(&pair) {
                    dependent.insert(pair);
                }
            }
        }
        Ok(dependent)
    }
}

/// The keyframes as they will be after the batch, read from the store as they are asked for.
struct KnownKeyframes<'a> {
    pending: &'a BTreeMap<KeyframeId, Option<&'a Keyframe>>,
    loaded: BTreeMap<KeyframeId, Option<Keyframe>>,
}

impl KnownKeyframes<'_> {
    fn load(
        &mut self,
        store: &SledStore,
        ids: impl IntoIterator<Item = KeyframeId>,
    ) -> Result<(), StoreError> {
        for id in ids {
            if !self.pending.contains_key(&id) && !self.loaded.contains_key(&id) {
                let keyframe = super::MapStore::keyframe(store, id)?;
                // The checks need pose and camera only; features are most of the memory.
                let light = keyframe.map(|keyframe| Keyframe { features: None, ..keyframe });
                self.loaded.insert(id, light);
            }
        }
        Ok(())
    }

    fn check_landmark(
        &mut self,
        store: &SledStore,
        info: &MapInfo,
        landmark: &Landmark,
    ) -> Result<(), StoreError> {
        self.load(store, landmark.observations.iter().map(|observation| observation.keyframe))?;
        contents::check_landmark(info, landmark, |id| self.get(id))?;
        Ok(())
    }

    fn get(&self, id: KeyframeId) -> Option<&Keyframe> {
        match self.pending.get(&id) {
            Some(pending) => *pending,
            None => self.loaded.get(&id).and_then(Option::as_ref),
        }
    }
}
