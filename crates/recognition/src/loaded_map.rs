//! A map in memory, indexed for queries.

use std::path::Path;
use std::sync::{Arc, OnceLock};

use nalgebra::{Matrix6, Vector3};
use protocol::{KeyframeId, MapIdentity};
use serde::{Deserialize, Serialize};
use vision::{DescriptorError, DescriptorView, MatchOptions, Metric};

use super::elements::{Landmarks, Observations, point_in_keyframe};
use super::evidence::AliasingRate;
use super::extractor_statistics::ExtractorStatistics;
use super::index::LandmarkIndex;
use super::loading::{LandmarkPlace, LoadedParts, MapLoader, joined};
use super::poses::MapPoses;
use map::contents::{ContentsError, MapContents, ObservationCounts};
use map::difference::Compared;
use map::model::{CommonError, Keyframe, KeyframeAliases, KeyframeCrossCovariance, MapMetadata};
use map::store::{self, StoreError, StoredLandmarks, StoredMap};

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
#[derive(Serialize, Deserialize)]
pub struct LoadedMap {
    /// With the kind of the features that the landmarks and the index are of.
    pub(crate) info: MapMetadata,
    pub(crate) identity: MapIdentity,
    /// See [`LoadedMap::digest`].
    #[serde(skip)]
    pub(crate) digest: Option<MapIdentity>,
    /// Layout of its files.
    pub(crate) store_schema: u16,
    /// Shared by all kinds of features; written beside, see [`LoadedMap::freeze`].
    #[serde(skip)]
    pub(crate) poses: Arc<MapPoses>,
    pub(crate) landmarks: Landmarks,
    pub(crate) observations: Observations,
    pub(crate) index: LandmarkIndex,
    /// Median distance between keyframes and the landmarks that they observe (m).
    pub(crate) viewing_distance: f64,
    /// What the map states, of keyframes that could be taken for another place; by keyframe.
    pub(crate) aliases: Vec<KeyframeAliases>,
    /// Measured when it is asked for, if the map does not state it.
    #[serde(with = "super::evidence::aliasing")]
    pub(crate) aliasing: OnceLock<AliasingRate>,
    /// The same map with its other kinds of features.
    pub(crate) added: Vec<LoadedMap>,
}

/// Why a map cannot be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// The map cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The map violates an invariant of maps.
    #[error("the map is invalid: {0}")]
    Invalid(#[from] ContentsError),
    /// The descriptors cannot be indexed.
    #[error("the map's descriptors cannot be indexed: {0}")]
    Descriptors(#[from] DescriptorError),
}

impl LoadedMap {
    /// Reads the map in a folder and indexes it.
    ///
    /// The landmarks are read one at a time, so that the map is never in memory twice.
    ///
    /// # Errors
    /// [`LoadError::Store`] where it cannot be read, and those of [`LoadedMap::from_contents`] where what could be read is not
    /// a map.
    pub fn read(path: impl AsRef<Path>) -> Result<LoadedMap, LoadError> {
        let (stored, landmarks) = store::open_map(path)?;
        LoadedMap::load(stored, landmarks)
    }

    /// Indexes a map whose landmarks are still to be read, see [`LoadedMap::read`].
    ///
    /// # Errors
    /// As [`LoadedMap::read`].
    pub fn load(stored: StoredMap, mut landmarks: StoredLandmarks) -> Result<LoadedMap, LoadError> {
        let digest = stored.digest;
        let mut contents = stored.contents;
        // Of use to who changes a map only.
        contents.existence = Vec::new();
        contents.validate()?;
        // A stored map has one.
        let identity = contents.info.identity.unwrap_or_else(|| contents.digest());
        let parts = LoadedParts::take(&mut contents, identity, stored.schema);
        let mut last = None;
        let mut loaded = parts.kinds.iter().enumerate().map(|(kind, info)| {
            let counts = landmarks.observation_counts(kind);
            let mut loader = MapLoader::new(info.clone(), &parts, landmarks.count(kind), counts)?;
            let mut added = Ok(());
            landmarks.read(kind, |landmark| {
                if added.is_ok() {
                    let place =
                        if kind == 0 { LandmarkPlace::Primary } else { LandmarkPlace::AddedAfter(last) };
                    added = loader.add(&landmark, place);
                    last = Some(landmark.id);
                }
            })?;
            added?;
            let aliases = if kind == 0 { std::mem::take(&mut contents.aliases) } else { Vec::new() };
            loader.finish(aliases)
        });
        Ok(joined(&mut loaded)?.with_digest(digest))
    }

    /// The map with the [digest](MapContents::digest) of its contents.
    #[must_use]
    pub fn with_digest(self, digest: MapIdentity) -> LoadedMap {
        LoadedMap { digest: Some(digest), ..self }
    }

    /// Indexes a map that is in memory already.
    ///
    /// # Errors
    /// [`LoadError::Invalid`], [`LoadError::Descriptors`].
    pub fn from_contents(contents: MapContents) -> Result<LoadedMap, LoadError> {
        LoadedMap::from_part(contents, Vec::new(), &[])
    }

    /// Indexes a part of a map, which also answers about correlations with the keyframes of other parts.
    ///
    /// # Arguments
    /// * `far_cross_covariances`: of its keyframes with those of other parts, each pair once.
    /// * `aliases`: what its keyframes could be taken for in this and in other parts, besides those of the contents.
    ///
    /// # Errors
    /// [`LoadError::Invalid`], [`LoadError::Descriptors`].
    pub fn from_part(
        mut contents: MapContents,
        far_cross_covariances: Vec<KeyframeCrossCovariance>,
        aliases: &[KeyframeAliases],
    ) -> Result<LoadedMap, LoadError> {
        contents.validate()?;
        contents.existence = Vec::new();
        contents.aliases.extend_from_slice(aliases);
        contents.cross_covariances.extend(far_cross_covariances);
        contents.sort();
        let identity = contents.info.identity.unwrap_or_else(|| contents.digest());
        let store_schema = contents.store_schema();
        let parts = LoadedParts::take(&mut contents, identity, store_schema);
        let added = contents.added_features.into_iter().map(|added| added.landmarks);
        let of_kinds = std::iter::once(contents.landmarks).chain(added);
        let mut aliases = contents.aliases;
        let mut loaded = parts.kinds.iter().zip(of_kinds).map(|(info, landmarks)| {
            let mut counts = ObservationCounts::of(&parts.poses.keyframes);
            for landmark in &landmarks {
                counts.add(landmark);
            }
            let mut loader = MapLoader::new(info.clone(), &parts, landmarks.len(), &counts.finish())?;
            for landmark in landmarks {
                loader.add_valid(&landmark)?;
            }
            // Those of the primary kind.
            loader.finish(std::mem::take(&mut aliases))
        });
        joined(&mut loaded)
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

    /// What is in this version, where that is known: of a map that was stored, and of one that was given it by [`LoadedMap::with_digest`].
    pub fn digest(&self) -> Option<MapIdentity> {
        self.digest
    }

    /// Number of keyframes.
    pub fn keyframe_count(&self) -> usize {
        self.poses.keyframes.len()
    }

    /// The keyframes in the order of the store, without their features.
    pub fn keyframes(&self) -> impl Iterator<Item = &Keyframe> {
        self.poses.keyframes.iter()
    }

    /// The keyframe of this id, without its features.
    pub fn keyframe(&self, id: KeyframeId) -> Option<&Keyframe> {
        self.index_of(id).map(|at| &self.poses.keyframes[at])
    }

    /// Number of landmarks of the primary kind.
    pub fn landmark_count(&self) -> usize {
        self.landmarks.len()
    }

    /// Positions of all landmarks of the primary kind in G (m), by id.
    pub fn landmark_positions(&self) -> impl Iterator<Item = Vector3<f64>> {
        (0..self.landmark_count()).map(|at| self.landmark_position(at))
    }

    /// Position of landmark `at` in G (m).
    pub(crate) fn landmark_position(&self, at: usize) -> Vector3<f64> {
        let anchor = self.landmarks.anchors[at] as usize;
        self.poses.keyframes[anchor]
            .global_from_keyframe
            .pose
            .transform(&self.landmarks.positions_in_anchor[at])
    }

    /// Median distance between keyframes and the landmarks that they observe (m).
    pub fn viewing_distance(&self) -> f64 {
        self.viewing_distance
    }

    pub(crate) fn observation_count(&self) -> usize {
        self.observations.len()
    }

    pub(crate) fn cross_covariance_count(&self) -> usize {
        self.poses.cross_covariances.blocks().len()
    }

    /// What is compared of this version of the map with another one.
    pub fn compared(&self) -> Compared<'_> {
        let mut compared = Compared::default();
        self.poses.keyframes.iter().for_each(|keyframe| compared.add_keyframe(keyframe));
        self.poses.cross_covariances.blocks().iter().for_each(|cross| compared.add_cross_covariance(cross));
        self.poses.common_errors.iter().for_each(|common| compared.add_common_error(common));
        self.kinds().for_each(|map| map.add_observed(&mut compared));
        compared
    }

    /// Adds the landmarks of this kind of features to what is compared.
    fn add_observed(&self, compared: &mut Compared<'_>) {
        for (at, id) in self.landmarks.ids.iter().enumerate() {
            let anchor = self.poses.keyframes[self.landmarks.anchors[at] as usize].id;
            let seen = self.landmarks.observers.of(at).iter().filter_map(|&keyframe| {
                let keyframe = keyframe as usize;
                Some((self.poses.keyframes[keyframe].id, self.observations.of(keyframe).pixel_of(at)?))
            });
            compared.add_observed(*id, anchor, self.landmarks.positions_in_anchor[at], seen);
        }
    }

    /// Index of a keyframe in [`LoadedMap::keyframes`].
    pub(crate) fn index_of(&self, id: KeyframeId) -> Option<usize> {
        self.poses.keyframes.binary_search_by_key(&id, |keyframe| keyframe.id).ok()
    }

    /// Covariance of two keyframes' pose errors beyond their common errors, rows of `a`; `None` where the map lists none.
    pub fn cross_covariance(&self, a: KeyframeId, b: KeyframeId) -> Option<Matrix6<f64>> {
        self.poses.cross_covariances.between(a, b)
    }

    /// A keyframe's part of the common error, where the map states it.
    pub fn common_error(&self, id: KeyframeId) -> Option<&CommonError> {
        let at = self.poses.common_errors.binary_search_by_key(&id, |common| common.keyframe).ok()?;
        Some(&self.poses.common_errors[at])
    }

    /// Covariance of two keyframes' pose errors, common errors included, rows of `a`; `None` where they are independent.
    pub(crate) fn joint_covariance(&self, a: KeyframeId, b: KeyframeId) -> Option<Matrix6<f64>> {
        let listed = self.cross_covariance(a, b);
        let common =
            self.common_error(a).zip(self.common_error(b)).map(|(one, other)| one.covariance_with(other));
        match (listed, common) {
            (Some(listed), Some(common)) => Some(listed + common),
            (one, other) => one.or(other),
        }
    }

    /// How the map's descriptors are compared.
    pub(crate) fn metric(&self) -> Metric {
        vision::metric_of(self.info.descriptor_kind)
    }

    /// Conditions on matches of an image with a keyframe.
    pub(crate) fn match_options(&self) -> MatchOptions {
        ExtractorStatistics::of(&self.info.extractor).match_options(MatchOptions::for_metric(self.metric()))
    }

    /// The descriptors of the landmarks that a keyframe observes, in the order of [`Observations::of`].
    pub(crate) fn descriptors_of(&self, keyframe: usize) -> Result<DescriptorView<'_>, DescriptorError> {
        let bytes = self.observations.of(keyframe).descriptors;
        DescriptorView::new(self.metric(), usize::from(self.info.descriptor_width), bytes)
    }

    /// The landmark of observation `at` of a keyframe, in the keyframe's camera frame (m): as the map gives it where the
    /// keyframe is its anchor, else see [`point_in_keyframe`].
    pub(crate) fn observed_point(&self, keyframe: usize, at: usize) -> Vector3<f64> {
        let observed = self.observations.of(keyframe);
        let landmark = observed.landmark(at);
        let anchor = self.landmarks.anchors[landmark] as usize;
        let position_in_anchor = &self.landmarks.positions_in_anchor[landmark];
        if anchor == keyframe {
            return *position_in_anchor;
        }
        let in_global = self.landmark_position(landmark);
        // Rounded to `f32`, 6e-8 of the distance.
        point_in_keyframe(&self.poses.keyframes[keyframe], &in_global, observed.pixels[at])
            .map(|number| f64::from(number as f32))
    }
}
