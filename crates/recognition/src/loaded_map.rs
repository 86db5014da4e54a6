//! A map in memory, indexed for queries.

use nalgebra::{Matrix6, Vector3};
use protocol::{KeyframeId, MapIdentity};
use vision::{DescriptorError, DescriptorView, Metric};

use super::elements::{Landmarks, Observations, point_in_keyframe};
use super::index::{LandmarkIndex, LandmarkIndexBuilder};
use map::contents::{ContentsError, MapContents};
use map::model::{Keyframe, KeyframeCrossCovariance, Landmark, MapMetadata};
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
    /// By id, without their features.
    pub(crate) keyframes: Vec<Keyframe>,
    pub(crate) landmarks: Landmarks,
    pub(crate) observations: Observations,
    /// By (a, b), `a < b`. Of a part of a map also those with keyframes of other parts.
    cross_covariances: Vec<KeyframeCrossCovariance>,
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
    pub fn from_contents(contents: MapContents) -> Result<LoadedMap, LoadError> {
        LoadedMap::from_part(contents, Vec::new())
    }

    /// Indexes a part of a map, which also answers about correlations with the keyframes of other parts.
    ///
    /// # Arguments
    /// * `far_cross_covariances`: of its keyframes with those of other parts, each pair once.
    ///
    /// # Errors
    /// [`LoadError::Invalid`], [`LoadError::Descriptors`].
    pub fn from_part(
        mut contents: MapContents,
        far_cross_covariances: Vec<KeyframeCrossCovariance>,
    ) -> Result<LoadedMap, LoadError> {
        contents.validate()?;
        contents.cross_covariances.extend(far_cross_covariances);
        contents.sort();
        let identity = contents.info.identity.unwrap_or_else(|| contents.digest());
        let MapContents { info, mut keyframes, landmarks, mut cross_covariances } = contents;
        for keyframe in &mut keyframes {
            keyframe.features = None;
        }
        keyframes.shrink_to_fit();
        cross_covariances.shrink_to_fit();
        let (kind, width) = (info.descriptor_kind, usize::from(info.descriptor_width));
        let observation_count = landmarks.iter().map(|landmark| landmark.observations.len()).sum();
        let mut map = LoadedMap {
            index: LandmarkIndexBuilder::new(kind, width, 0).build()?,
            info: MapMetadata { identity: Some(identity), ..info },
            identity,
            landmarks: Landmarks::with_capacity(landmarks.len(), observation_count),
            observations: Observations::default(),
            keyframes,
            cross_covariances,
            viewing_distance: 0.0,
            damaged: 0,
        };
        map.add_landmarks(&landmarks)?;
        let mut builder = LandmarkIndexBuilder::new(kind, width, landmarks.len());
        for (at, landmark) in landmarks.into_iter().enumerate() {
            builder.add(at, &landmark.observations)?;
        }
        map.index = builder.build()?;
        map.viewing_distance = map.median_distance();
        Ok(map)
    }

    /// Adds all landmarks and their observations. The map is valid, so that every keyframe that they name exists.
    fn add_landmarks(&mut self, landmarks: &[Landmark]) -> Result<(), DescriptorError> {
        u32::try_from(landmarks.len()).map_err(|_| DescriptorError::Full)?;
        let mut counts = vec![0_u32; self.keyframes.len()];
        for observation in landmarks.iter().flat_map(|landmark| &landmark.observations) {
            if let Some(keyframe) = self.index_of(observation.keyframe) {
                counts[keyframe] += 1;
            }
        }
        let width = usize::from(self.info.descriptor_width);
        self.observations = Observations::with_counts(counts.iter().copied(), width)?;
        counts.fill(0);
        for landmark in landmarks {
            let Some(anchor) = self.index_of(landmark.anchor) else { continue };
            let global_from_anchor = &self.keyframes[anchor].global_from_keyframe.pose;
            let position_in_global = global_from_anchor.transform(&landmark.position_in_anchor);
            let mut observers = Vec::with_capacity(landmark.observations.len());
            for observation in &landmark.observations {
                let Some(at) = self.index_of(observation.keyframe) else { continue };
                let Keyframe { global_from_keyframe, camera, .. } = &self.keyframes[at];
                let (pixel, descriptor) = (observation.pixel, &observation.descriptor);
                let point = if at == anchor {
                    landmark.position_in_anchor
                } else {
                    point_in_keyframe(camera, &global_from_keyframe.pose, &position_in_global, pixel)
                };
                let number = self.landmarks.len() as u32;
                self.observations.set(at, counts[at] as usize, number, pixel, &point, descriptor);
                counts[at] += 1;
                observers.push(at as u32);
            }
            self.landmarks.push(landmark, anchor as u32, observers.into_iter());
        }
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
        self.keyframes.iter()
    }

    /// The keyframe of this id, without its features.
    pub fn keyframe(&self, id: KeyframeId) -> Option<&Keyframe> {
        self.index_of(id).map(|at| &self.keyframes[at])
    }

    /// Number of landmarks.
    pub fn landmark_count(&self) -> usize {
        self.landmarks.len()
    }

    /// Positions of all landmarks in G (m), by id.
    pub fn landmark_positions(&self) -> impl Iterator<Item = Vector3<f64>> {
        let landmarks = self.landmarks.anchors.iter().zip(&self.landmarks.positions_in_anchor);
        landmarks.map(|(&anchor, position)| {
            self.keyframes[anchor as usize].global_from_keyframe.pose.transform(position)
        })
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
        self.observations.len()
    }

    pub(crate) fn cross_covariance_count(&self) -> usize {
        self.cross_covariances.len()
    }

    /// The pairs of keyframes with a cross-covariance, (a, b) with `a < b`.
    pub fn correlated_pairs(&self) -> impl Iterator<Item = (KeyframeId, KeyframeId)> {
        self.cross_covariances.iter().map(|cross| (cross.a, cross.b))
    }

    /// Index of a keyframe in [`LoadedMap::keyframes`].
    pub(crate) fn index_of(&self, id: KeyframeId) -> Option<usize> {
        self.keyframes.binary_search_by_key(&id, |keyframe| keyframe.id).ok()
    }

    /// Covariance of two keyframes' pose errors, rows of `a`; `None` where they are independent.
    pub fn cross_covariance(&self, a: KeyframeId, b: KeyframeId) -> Option<Matrix6<f64>> {
        let pair = (a.min(b), a.max(b));
        let at = self.cross_covariances.binary_search_by_key(&pair, |cross| (cross.a, cross.b)).ok()?;
        let block = &self.cross_covariances[at].block;
        Some(if a < b { *block } else { block.transpose() })
    }

    /// How the map's descriptors are compared.
    pub(crate) fn metric(&self) -> Metric {
        sensors::metric_of(self.info.descriptor_kind)
    }

    /// The descriptors of the landmarks that a keyframe observes, in the order of [`Observations::of`].
    pub(crate) fn descriptors_of(&self, keyframe: usize) -> Result<DescriptorView<'_>, DescriptorError> {
        let bytes = self.observations.of(keyframe).descriptors;
        DescriptorView::new(self.metric(), usize::from(self.info.descriptor_width), bytes)
    }

    fn median_distance(&self) -> f64 {
        let mut distances: Vec<f32> = self.observations.distances().collect();
        if distances.is_empty() {
            return 0.0;
        }
        let middle = distances.len() / 2;
        f64::from(*distances.select_nth_unstable_by(middle, f32::total_cmp).1)
    }

    /// The landmark of observation `at` of a keyframe, in the keyframe's camera frame (m): as the map gives it where the
    /// keyframe is its anchor.
    pub(crate) fn observed_point(&self, keyframe: usize, at: usize) -> Vector3<f64> {
        let observed = self.observations.of(keyframe);
        let landmark = observed.landmark(at);
        if self.landmarks.anchors[landmark] as usize == keyframe {
            self.landmarks.positions_in_anchor[landmark]
        } else {
            observed.point(at)
        }
    }
}
