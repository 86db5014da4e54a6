//! Loading a map: its landmarks are taken one at a time into arrays that have room for all of them.
//!
//! So of the landmarks, by far most of a map, no second copy is made, and none of the arrays is ever copied to grow.

use std::sync::{Arc, OnceLock};

use map::contents::{MapContents, validate_added_landmark, validate_landmark};
use map::model::{KeyframeAliases, Landmark, MapMetadata};
use nalgebra::Vector3;
use protocol::{LandmarkId, MapIdentity};
use vision::DescriptorError;

use super::elements::{Landmarks, Observations, point_in_keyframe};
use super::index::{LandmarkIndex, LandmarkIndexBuilder};
use super::loaded_map::{LoadError, LoadedMap};
use super::poses::MapPoses;

/// Where a landmark is among those of all kinds of features.
#[derive(Clone, Copy)]
pub(crate) enum LandmarkPlace {
    /// Of the primary kind.
    Primary,
    /// Of an added kind, after a landmark of this or a former kind.
    AddedAfter(Option<LandmarkId>),
}

/// What all kinds of features of a map share.
pub(crate) struct LoadedParts {
    pub(crate) poses: Arc<MapPoses>,
    /// Of each kind, the primary one first.
    pub(crate) kinds: Vec<MapMetadata>,
    identity: MapIdentity,
    store_schema: u16,
}

impl LoadedParts {
    /// Takes the poses out of a valid, sorted map.
    pub(crate) fn take(contents: &mut MapContents, identity: MapIdentity, store_schema: u16) -> LoadedParts {
        let info = MapMetadata { identity: Some(identity), ..contents.info.clone() };
        let added = contents.added_features.iter().map(|added| info.with_kind(&added.kind));
        LoadedParts {
            kinds: std::iter::once(info.clone()).chain(added).collect(),
            identity,
            store_schema,
            poses: Arc::new(MapPoses::take(contents)),
        }
    }
}

/// The primary kind of a map with the others, of all in their order.
///
/// # Errors
/// The first one of a kind.
pub(crate) fn joined(
    kinds: &mut dyn Iterator<Item = Result<LoadedMap, LoadError>>,
) -> Result<LoadedMap, LoadError> {
    // There is always a primary one.
    let Some(primary) = kinds.next() else { return Err(DescriptorError::Full.into()) };
    let mut map = primary?;
    map.added = kinds.collect::<Result<_, _>>()?;
    Ok(map)
}

/// Builds a [`LoadedMap`].
pub(crate) struct MapLoader {
    /// Without its index.
    map: LoadedMap,
    /// Observations so far, by keyframe.
    filled: Vec<u32>,
    /// Distances between keyframes and the landmarks that they observe (m).
    distances: Vec<f32>,
    index: LandmarkIndexBuilder,
}

impl MapLoader {
    /// Makes room for the landmarks of one kind of features.
    ///
    /// # Arguments
    /// * `info`: the map with the kind.
    /// * `landmark_count`: how many landmarks it has.
    /// * `observation_counts`: how many observations each keyframe has, in the order of the keyframes.
    ///
    /// # Errors
    /// [`LoadError::Descriptors`] where they are too many.
    pub(crate) fn new(
        info: MapMetadata,
        parts: &LoadedParts,
        landmark_count: usize,
        observation_counts: &[u32],
    ) -> Result<MapLoader, LoadError> {
        u32::try_from(landmark_count).map_err(|_| DescriptorError::Full)?;
        let (kind, width) = (info.descriptor_kind, usize::from(info.descriptor_width));
        let observations = Observations::with_counts(observation_counts.iter().copied(), width)?;
        let map = LoadedMap {
            index: LandmarkIndex::empty(kind, width)?,
            info,
            identity: parts.identity,
            digest: None,
            store_schema: parts.store_schema,
            poses: Arc::clone(&parts.poses),
            landmarks: Landmarks::with_capacity(landmark_count, observations.len()),
            viewing_distance: 0.0,
            aliases: Vec::new(),
            aliasing: OnceLock::new(),
            added: Vec::new(),
            observations,
        };
        Ok(MapLoader {
            filled: vec![0; observation_counts.len()],
            distances: Vec::with_capacity(map.observations.len()),
            index: LandmarkIndexBuilder::new(kind, width, landmark_count),
            map,
        })
    }

    /// Adds a landmark: by id, its observations by keyframe.
    ///
    /// # Arguments
    /// * `place`: among the landmarks of the map.
    ///
    /// # Errors
    /// [`LoadError::Invalid`], [`LoadError::Descriptors`].
    pub(crate) fn add(&mut self, landmark: &Landmark, place: LandmarkPlace) -> Result<(), LoadError> {
        let map = &self.map;
        match place {
            LandmarkPlace::Primary => validate_landmark(&map.info, landmark, |id| map.keyframe(id))?,
            LandmarkPlace::AddedAfter(before) => {
                validate_added_landmark(&map.info, before, landmark, |id| map.keyframe(id))?;
            }
        }
        Ok(self.add_valid(landmark)?)
    }

    /// Adds a landmark of a map that was validated as a whole.
    pub(crate) fn add_valid(&mut self, landmark: &Landmark) -> Result<(), DescriptorError> {
        let map = &mut self.map;
        let Some(anchor) = map.index_of(landmark.anchor) else { return Ok(()) };
        let number = map.landmarks.len() as u32;
        let global_from_anchor = &map.poses.keyframes[anchor].global_from_keyframe.pose;
        let position_in_global = global_from_anchor.transform(&landmark.position_in_anchor);
        let mut observers = Vec::with_capacity(landmark.observations.len());
        for observation in &landmark.observations {
            let Some(at) = map.index_of(observation.keyframe) else { continue };
            let point = if at == anchor {
                landmark.position_in_anchor
            } else {
                point_in_keyframe(&map.poses.keyframes[at], &position_in_global, observation.pixel)
            };
            self.distances.push(length(&point));
            map.observations.set(at, self.filled[at] as usize, number, observation);
            self.filled[at] += 1;
            observers.push(at as u32);
        }
        map.landmarks.push(landmark, anchor as u32, observers.into_iter());
        self.index.add(number as usize, &landmark.observations)
    }

    /// Indexes the landmarks.
    ///
    /// # Arguments
    /// * `aliases`: what the map states of keyframes that could be taken for another place, by this kind of features.
    ///
    /// # Errors
    /// [`LoadError::Descriptors`].
    pub(crate) fn finish(mut self, aliases: Vec<KeyframeAliases>) -> Result<LoadedMap, LoadError> {
        self.map.viewing_distance = median(self.distances);
        self.map.index = self.index.build()?;
        self.map.set_aliases(aliases);
        Ok(self.map)
    }
}

/// The length of a vector (m).
fn length(vector: &Vector3<f64>) -> f32 {
    let [x, y, z] = [vector.x, vector.y, vector.z].map(|number| number as f32);
    (x * x + y * y + z * z).sqrt()
}

fn median(mut values: Vec<f32>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}
