//! A map in memory, indexed for queries.

use std::collections::HashMap;

use nalgebra::Matrix6;
use protocol::{KeyframeId, MapIdentity};
use vision::{DescriptorError, DescriptorView, Metric};

use super::elements::{LoadedKeyframe, LoadedLandmark, ObservedLandmark, point_in_keyframe};
use super::index::{LandmarkIndex, LandmarkIndexBuilder};
use map::contents::{ContentsError, MapContents};
use map::model::{Keyframe, Landmark, MapMetadata};
use map::store::StoredMap;

/// A map in memory, indexed for queries. It is immutable: a new version of the map is a new `LoadedMap`.
///
/// # Example
/// ```
/// use map::{MapContents, MapMetadata};
/// use protocol::DescriptorKind;
/// use recognition::LoadedMap;
///
/// let contents = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
/// let map = LoadedMap::from_contents(contents)?;
/// assert_eq!((map.keyframe_count(), map.landmark_count()), (0, 0));
/// # Ok::<(), recognition::LoadError>(())
/// ```
pub struct LoadedMap {
    pub(crate) info: MapMetadata,
    pub(crate) identity: MapIdentity,
    pub(crate) keyframes: Vec<LoadedKeyframe>,
    pub(crate) landmarks: Vec<LoadedLandmark>,
    indices: HashMap<KeyframeId, usize>,
    /// By (a, b), `a < b`.
    cross_covariances: HashMap<(KeyframeId, KeyframeId), Matrix6<f64>>,
    pub(crate) index: LandmarkIndex,
    viewing_distance: f64,
    damaged: usize,
}

/// Why a map cannot be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// The map violates an invariant of maps.
    #[error("the map is invalid: {0}")]
    Invalid(#[from] ContentsError),
    /// The descriptors cannot be indexed.
    #[error("the map's descriptors cannot be indexed: {0}")]
    Descriptors(#[from] DescriptorError),
}

impl LoadedMap {
    /// Indexes a map that was read from a database. Damaged records are logged and left out: a robot can still localize
    /// with the rest.
    ///
    /// # Errors
    /// [`LoadError`] where what could be read is not a map.
    pub fn load(stored: StoredMap) -> Result<LoadedMap, LoadError> {
        for error in &stored.damaged {
            tracing::error!("{error}; it is left out");
        }
        let mut map = LoadedMap::from_contents(stored.contents)?;
        map.damaged = stored.damaged.len();
        Ok(map)
    }

    /// Indexes a map that is in memory already.
    ///
    /// # Errors
    /// [`LoadError::Invalid`], [`LoadError::Descriptors`].
    pub fn from_contents(mut contents: MapContents) -> Result<LoadedMap, LoadError> {
        contents.validate()?;
        contents.sort();
        let identity = contents.info.identity.unwrap_or_else(|| contents.digest());
        let MapContents { info, keyframes, landmarks, cross_covariances } = contents;
        let indices: HashMap<_, _> =
            keyframes.iter().enumerate().map(|(at, keyframe)| (keyframe.id, at)).collect();
        let light = |keyframe| Keyframe { features: None, ..keyframe };
        let keyframes = keyframes.into_iter().map(|keyframe| LoadedKeyframe {
            keyframe: light(keyframe),
            observed: Vec::new(),
            descriptors: Vec::new(),
        });
        let mut builder = LandmarkIndexBuilder::new(info.descriptor_kind, usize::from(info.descriptor_width));
        let mut map = LoadedMap {
            index: LandmarkIndexBuilder::new(info.descriptor_kind, usize::from(info.descriptor_width))
                .build()?,
            info: MapMetadata { identity: Some(identity), ..info },
            identity,
            keyframes: keyframes.collect(),
            landmarks: Vec::with_capacity(landmarks.len()),
            indices,
            cross_covariances: cross_covariances
                .into_iter()
                .map(|cross| ((cross.a, cross.b), cross.block))
                .collect(),
            viewing_distance: 0.0,
            damaged: 0,
        };
        // By value, so that the memory of the descriptors is freed while they are copied.
        for landmark in landmarks {
            map.add_landmark(&landmark, &mut builder)?;
        }
        map.index = builder.build()?;
        map.viewing_distance = map.median_distance();
        Ok(map)
    }

    fn add_landmark(
        &mut self,
        landmark: &Landmark,
        builder: &mut LandmarkIndexBuilder,
    ) -> Result<(), DescriptorError> {
        // The map is valid, so every keyframe named here exists.
        let Some(&anchor) = self.indices.get(&landmark.anchor) else { return Ok(()) };
        let index = self.landmarks.len();
        let global_from_anchor = self.keyframes[anchor].keyframe.global_from_keyframe.pose;
        let position_in_global = global_from_anchor.transform(&landmark.position_in_anchor);
        let mut observations = Vec::with_capacity(landmark.observations.len());
        for observation in &landmark.observations {
            let Some(&at) = self.indices.get(&observation.keyframe) else { continue };
            let loaded = &mut self.keyframes[at];
            let point = if at == anchor {
                landmark.position_in_anchor
            } else {
                let pose = &loaded.keyframe.global_from_keyframe.pose;
                point_in_keyframe(&loaded.keyframe.camera, pose, &position_in_global, observation.pixel)
            };
            loaded.observed.push(ObservedLandmark { landmark: index, pixel: observation.pixel, point });
            loaded.descriptors.extend_from_slice(&observation.descriptor);
            observations.push((at, observation.pixel));
        }
        let descriptors: Vec<u8> =
            landmark.observations.iter().flat_map(|observation| &observation.descriptor).copied().collect();
        builder.add(index, &descriptors)?;
        let position_in_anchor = landmark.position_in_anchor;
        self.landmarks.push(LoadedLandmark { id: landmark.id, anchor, position_in_anchor, observations });
        Ok(())
    }

    /// The map as a whole.
    pub fn info(&self) -> &MapMetadata {
        &self.info
    }

    /// The identity of the map, the same for all its versions: that of its info, or where that has none the
    /// [digest](MapContents::digest) of the map.
    pub fn identity(&self) -> MapIdentity {
        self.identity
    }

    /// Number of keyframes.
    pub fn keyframe_count(&self) -> usize {
        self.keyframes.len()
    }

    /// The keyframes in the order of the store, without their features.
    pub fn keyframes(&self) -> impl Iterator<Item = &Keyframe> {
        self.keyframes.iter().map(|loaded| &loaded.keyframe)
    }

    /// The keyframe of this id, without its features.
    pub fn keyframe(&self, id: KeyframeId) -> Option<&Keyframe> {
        self.index_of(id).map(|at| &self.keyframes[at].keyframe)
    }

    /// Number of landmarks.
    pub fn landmark_count(&self) -> usize {
        self.landmarks.len()
    }

    /// Number of records that were damaged and left out on loading.
    pub fn damaged_records(&self) -> usize {
        self.damaged
    }

    /// Median distance between keyframes and the landmarks that they observe (m).
    pub fn viewing_distance(&self) -> f64 {
        self.viewing_distance
    }

    pub(crate) fn observation_count(&self) -> usize {
        self.keyframes.iter().map(|loaded| loaded.observed.len()).sum()
    }

    pub(crate) fn cross_covariance_count(&self) -> usize {
        self.cross_covariances.len()
    }

    /// The pairs of keyframes with a cross-covariance, (a, b) with `a < b`.
    pub fn correlated_pairs(&self) -> impl Iterator<Item = (KeyframeId, KeyframeId)> {
        self.cross_covariances.keys().copied()
    }

    /// Index of a keyframe in [`LoadedMap::keyframes`].
    pub(crate) fn index_of(&self, id: KeyframeId) -> Option<usize> {
        self.indices.get(&id).copied()
    }

    /// Covariance of two keyframes' pose errors, rows of `a`; `None` where they are independent.
    pub fn cross_covariance(&self, a: KeyframeId, b: KeyframeId) -> Option<Matrix6<f64>> {
        if a < b {
            self.cross_covariances.get(&(a, b)).copied()
        } else {
            self.cross_covariances.get(&(b, a)).map(Matrix6::transpose)
        }
    }

    /// How the map's descriptors are compared.
    pub(crate) fn metric(&self) -> Metric {
        sensors::metric_of(self.info.descriptor_kind)
    }

    /// The descriptors of the landmarks that a keyframe observes, in the order of [`LoadedKeyframe::seen`].
    pub(crate) fn descriptors_of(&self, keyframe: usize) -> Result<DescriptorView<'_>, DescriptorError> {
        let bytes = &self.keyframes[keyframe].descriptors;
        DescriptorView::new(self.metric(), usize::from(self.info.descriptor_width), bytes)
    }

    fn median_distance(&self) -> f64 {
        let observed = self.keyframes.iter().flat_map(|loaded| &loaded.observed);
        let mut distances: Vec<f64> = observed.map(|landmark| landmark.point.norm()).collect();
        if distances.is_empty() {
            return 0.0;
        }
        let middle = distances.len() / 2;
        *distances.select_nth_unstable_by(middle, f64::total_cmp).1
    }
}
