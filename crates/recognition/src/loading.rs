//! Loading a map: its landmarks are taken one at a time into arrays that have room for all of them.
//!
//! So of the landmarks, by far most of a map, no second copy is made, and none of the arrays is ever copied to grow.

use std::sync::OnceLock;

use map::contents::{MapContents, validate_landmark};
use map::model::{Keyframe, KeyframeAliases, Landmark, MapMetadata};
use nalgebra::Vector3;
use protocol::MapIdentity;
use vision::DescriptorError;

use super::cross_covariances::CrossCovariances;
use super::elements::{Landmarks, Observations, Viewpoint, point_in_keyframe};
use super::index::{LandmarkIndex, LandmarkIndexBuilder};
use super::loaded_map::{LoadError, LoadedMap};

/// Builds a [`LoadedMap`].
pub(crate) struct MapLoader {
    /// Without its index.
    map: LoadedMap,
    /// Observations so far, by keyframe.
    filled: Vec<u32>,
    /// Distances between keyframes and the landmarks that they observe (m).
    distances: Vec<f32>,
    index: LandmarkIndexBuilder,
    aliases: Vec<KeyframeAliases>,
}

impl MapLoader {
    /// Makes room for a map.
    ///
    /// # Arguments
    /// * `contents`: a valid map, sorted, without its landmarks.
    /// * `identity`: that of the map.
    /// * `landmark_count`: how many landmarks it has.
    /// * `observation_counts`: how many observations each keyframe has, in the order of the keyframes.
    ///
    /// # Errors
    /// [`LoadError::Descriptors`] where they are too many.
    pub(crate) fn new(
        contents: MapContents,
        identity: MapIdentity,
        landmark_count: usize,
        observation_counts: &[u32],
    ) -> Result<MapLoader, LoadError> {
        u32::try_from(landmark_count).map_err(|_| DescriptorError::Full)?;
        let MapContents { info, mut keyframes, cross_covariances, mut common_errors, aliases, .. } = contents;
        for keyframe in &mut keyframes {
            keyframe.features = None;
        }
        keyframes.shrink_to_fit();
        common_errors.shrink_to_fit();
        let (kind, width) = (info.descriptor_kind, usize::from(info.descriptor_width));
        let observations = Observations::with_counts(observation_counts.iter().copied(), width)?;
        let viewpoint = |keyframe: &Keyframe| Viewpoint::of(&keyframe.global_from_keyframe.pose);
        let map = LoadedMap {
            index: LandmarkIndex::empty(kind, width)?,
            info: MapMetadata { identity: Some(identity), ..info },
            identity,
            landmarks: Landmarks::with_capacity(landmark_count, observations.len()),
            viewpoints: keyframes.iter().map(viewpoint).collect(),
            keyframes,
            cross_covariances: CrossCovariances::new(cross_covariances),
            common_errors,
            viewing_distance: 0.0,
            aliases: Vec::new(),
            aliasing: OnceLock::new(),
            observations,
        };
        Ok(MapLoader {
            filled: vec![0; observation_counts.len()],
            distances: Vec::with_capacity(map.observations.len()),
            index: LandmarkIndexBuilder::new(kind, width, landmark_count),
            map,
            aliases,
        })
    }

    /// Adds a landmark: by id, its observations by keyframe.
    ///
    /// # Errors
    /// [`LoadError::Invalid`], [`LoadError::Descriptors`].
    pub(crate) fn add(&mut self, landmark: &Landmark) -> Result<(), LoadError> {
        validate_landmark(&self.map.info, landmark, |id| self.map.keyframe(id))?;
        Ok(self.add_valid(landmark)?)
    }

    /// Adds a landmark of a map that was validated as a whole.
    pub(crate) fn add_valid(&mut self, landmark: &Landmark) -> Result<(), DescriptorError> {
        let map = &mut self.map;
        let Some(anchor) = map.index_of(landmark.anchor) else { return Ok(()) };
        let number = map.landmarks.len() as u32;
        let global_from_anchor = &map.keyframes[anchor].global_from_keyframe.pose;
        let position_in_global = global_from_anchor.transform(&landmark.position_in_anchor);
        let mut observers = Vec::with_capacity(landmark.observations.len());
        for observation in &landmark.observations {
            let Some(at) = map.index_of(observation.keyframe) else { continue };
            let Keyframe { global_from_keyframe, camera, .. } = &map.keyframes[at];
            let point = if at == anchor {
                landmark.position_in_anchor
            } else {
                point_in_keyframe(camera, &global_from_keyframe.pose, &position_in_global, observation.pixel)
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
    /// # Errors
    /// [`LoadError::Descriptors`].
    pub(crate) fn finish(mut self) -> Result<LoadedMap, LoadError> {
        self.map.viewing_distance = median(self.distances);
        self.map.index = self.index.build()?;
        self.map.set_aliases(self.aliases);
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
