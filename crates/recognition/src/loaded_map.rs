//! A map in memory, arranged for queries.

use std::collections::HashMap;

use geometry::{Camera, Pose};
use nalgebra::{Matrix6, Vector2, Vector3};
use protocol::{KeyframeId, LandmarkId};
use vision::{DescriptorError, DescriptorView, Metric};

use super::index::{Index, IndexBuilder};
use map::contents::{ContentsError, MapContents};
use map::model::{Keyframe, Landmark, MapInfo};
use map::store::{MapStore, StoreError};

/// Smallest depth (m) at which a point counts as in front of a camera.
const MIN_DEPTH: f64 = 1e-3;

/// A map in memory, arranged for queries. It never changes: a new version of the map is a new `LoadedMap`.
pub struct LoadedMap {
    pub(crate) info: MapInfo,
    pub(crate) keyframes: Vec<LoadedKeyframe>,
    pub(crate) landmarks: Vec<LoadedLandmark>,
    positions: HashMap<KeyframeId, usize>,
    /// By (a, b), `a < b`.
    cross_covariances: HashMap<(KeyframeId, KeyframeId), Matrix6<f64>>,
    pub(crate) index: Index,
    viewing_distance: f64,
    damaged: usize,
}

/// A keyframe with what it sees.
pub(crate) struct LoadedKeyframe {
    /// Without its features.
    pub(crate) keyframe: Keyframe,
    pub(crate) seen: Vec<SeenLandmark>,
    /// Of each of `seen`, one after the other.
    pub(crate) descriptors: Vec<u8>,
}

/// A landmark as a keyframe saw it.
pub(crate) struct SeenLandmark {
    /// Index into [`LoadedMap::landmarks`].
    pub(crate) landmark: usize,
    pub(crate) pixel: [f32; 2],
    /// In the camera frame of the keyframe, see [`point_in_keyframe`].
    pub(crate) point: Vector3<f64>,
}

/// A landmark without its descriptors.
pub(crate) struct LoadedLandmark {
    pub(crate) id: LandmarkId,
    /// Index into [`LoadedMap::keyframes`].
    pub(crate) anchor: usize,
    pub(crate) position_in_anchor: Vector3<f64>,
    /// Index of the keyframe and pixel.
    pub(crate) observations: Vec<(usize, [f32; 2])>,
}

/// Why a map cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum LoadError {
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The map breaks a law of maps.
    #[error("the map is invalid: {0}")]
    Invalid(#[from] ContentsError),
    /// The descriptors cannot be indexed.
    #[error("the map's descriptors cannot be indexed: {0}")]
    Descriptors(#[from] DescriptorError),
}

impl LoadedMap {
    /// Reads and indexes a map. Damaged records are logged and left out: a robot is better off with the rest.
    ///
    /// # Errors
    /// [`LoadError`] where the info of the map is unreadable or what can be read is not a map.
    pub fn load(store: &dyn MapStore) -> Result<LoadedMap, LoadError> {
        let (contents, errors) = store.read_readable()?;
        for error in &errors {
            tracing::error!("{error}; it is left out");
        }
        let mut map = LoadedMap::from_contents(contents)?;
        map.damaged = errors.len();
        Ok(map)
    }

    /// Indexes a map that is in memory already.
    ///
    /// # Errors
    /// [`LoadError::Invalid`], [`LoadError::Descriptors`].
    pub fn from_contents(mut contents: MapContents) -> Result<LoadedMap, LoadError> {
        contents.validate()?;
        contents.sort();
        let MapContents { info, keyframes, landmarks, cross_covariances } = contents;
        let positions: HashMap<_, _> =
            keyframes.iter().enumerate().map(|(at, keyframe)| (keyframe.id, at)).collect();
        let light = |keyframe| Keyframe { features: None, ..keyframe };
        let keyframes = keyframes.into_iter().map(|keyframe| LoadedKeyframe {
            keyframe: light(keyframe),
            seen: Vec::new(),
            descriptors: Vec::new(),
        });
        let mut builder = IndexBuilder::new(info.descriptor_kind, usize::from(info.descriptor_width));
        let mut map = LoadedMap {
            index: IndexBuilder::new(info.descriptor_kind, usize::from(info.descriptor_width)).build()?,
            info,
            keyframes: keyframes.collect(),
            landmarks: Vec::with_capacity(landmarks.len()),
            positions,
            cross_covariances: cross_covariances
                .into_iter()
                .map(|cross| ((cross.a, cross.b), cross.block))
                .collect(),
            viewing_distance: 0.0,
            damaged: 0,
        };
        // By value, so that the memory of the descriptors is given back while they are copied.
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
        builder: &mut IndexBuilder,
    ) -> Result<(), DescriptorError> {
        // The laws of maps, checked before, say that every keyframe named here is there.
        let Some(&anchor) = self.positions.get(&landmark.anchor) else { return Ok(()) };
        let number = self.landmarks.len();
        let global_from_anchor = self.keyframes[anchor].keyframe.global_from_keyframe.pose;
        let position_in_global = global_from_anchor.transform(&landmark.position_in_anchor);
        let mut observations = Vec::with_capacity(landmark.observations.len());
        for observation in &landmark.observations {
            let Some(&at) = self.positions.get(&observation.keyframe) else { continue };
            let loaded = &mut self.keyframes[at];
            let point = if at == anchor {
                landmark.position_in_anchor
            } else {
                let pose = &loaded.keyframe.global_from_keyframe.pose;
                point_in_keyframe(&loaded.keyframe.camera, pose, &position_in_global, observation.pixel)
            };
            loaded.seen.push(SeenLandmark { landmark: number, pixel: observation.pixel, point });
            loaded.descriptors.extend_from_slice(&observation.descriptor);
            observations.push((at, observation.pixel));
        }
        let seen: Vec<u8> = landmark.observations.iter().flat_map(|seen| &seen.descriptor).copied().collect();
        builder.add(number, &seen)?;
        let position_in_anchor = landmark.position_in_anchor;
        self.landmarks.push(LoadedLandmark { id: landmark.id, anchor, position_in_anchor, observations });
        Ok(())
    }

    /// The map as a whole.
    pub fn info(&self) -> &MapInfo {
        &self.info
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
        self.position_of(id).map(|at| &self.keyframes[at].keyframe)
    }

    /// Number of landmarks.
    pub fn landmark_count(&self) -> usize {
        self.landmarks.len()
    }

    /// Number of records that were damaged and left out on loading.
    pub fn damaged_records(&self) -> usize {
        self.damaged
    }

    /// How far the map's keyframes see: the median distance of what they observe (m).
    pub fn viewing_distance(&self) -> f64 {
        self.viewing_distance
    }

    pub(crate) fn observation_count(&self) -> usize {
        self.keyframes.iter().map(|loaded| loaded.seen.len()).sum()
    }

    pub(crate) fn cross_covariance_count(&self) -> usize {
        self.cross_covariances.len()
    }

    /// The pairs of keyframes that depend on each other, (a, b) with `a < b`.
    pub fn correlated_pairs(&self) -> impl Iterator<Item = (KeyframeId, KeyframeId)> {
        self.cross_covariances.keys().copied()
    }

    /// Where a keyframe is in [`LoadedMap::keyframes`].
    pub(crate) fn position_of(&self, id: KeyframeId) -> Option<usize> {
        self.positions.get(&id).copied()
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

    /// The descriptors of what a keyframe sees, in the order of [`LoadedKeyframe::seen`].
    pub(crate) fn descriptors_of(&self, keyframe: usize) -> Result<DescriptorView<'_>, DescriptorError> {
        let bytes = &self.keyframes[keyframe].descriptors;
        DescriptorView::new(self.metric(), usize::from(self.info.descriptor_width), bytes)
    }

    fn median_distance(&self) -> f64 {
        let seen = self.keyframes.iter().flat_map(|loaded| &loaded.seen);
        let mut distances: Vec<f64> = seen.map(|seen| seen.point.norm()).collect();
        if distances.is_empty() {
            return 0.0;
        }
        let middle = distances.len() / 2;
        *distances.select_nth_unstable_by(middle, f64::total_cmp).1
    }
}

/// A landmark in the camera frame of a keyframe that is not its anchor: on the ray of the keyframe's own pixel, at
/// the depth that the map gives.
///
/// Both keyframe poses are uncertain (0.1 m and 0.9 deg in recorded maps), so the transformed position alone would
/// miss the pixel that the keyframe really saw by tens of pixels. Its direction is known from that pixel, and only
/// its depth must come through the poses.
fn point_in_keyframe(
    camera: &Camera,
    global_from_keyframe: &Pose,
    position_in_global: &Vector3<f64>,
    pixel: [f32; 2],
) -> Vector3<f64> {
    let transformed = global_from_keyframe.inverse_transform(position_in_global);
    match camera.unproject(&Vector2::from(pixel.map(f64::from))) {
        Ok(ray) if transformed.z > MIN_DEPTH => ray.push(1.0) * transformed.z,
        _ => transformed,
    }
}
