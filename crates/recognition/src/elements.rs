//! The landmarks of a loaded map and their observations, in flat arrays that refer to each other by index.
//!
//! A map has some five observations a landmark and hundreds a keyframe: one allocation each would take more memory than
//! what it holds.

use map::model::{Keyframe, Landmark, Observation};
use nalgebra::Vector3;
use protocol::LandmarkId;
use serde::{Deserialize, Serialize};
use vision::DescriptorError;

/// All landmarks of a map without their descriptors, and which keyframes observe each.
#[derive(Default, Serialize, Deserialize)]
pub(crate) struct Landmarks {
    #[serde(with = "vision::packed")]
    pub(crate) ids: Vec<LandmarkId>,
    /// Index of the keyframe in whose camera frame the position is given.
    #[serde(with = "vision::packed")]
    pub(crate) anchors: Vec<u32>,
    #[serde(with = "vision::packed")]
    pub(crate) positions_in_anchor: Vec<Vector3<f64>>,
    pub(crate) observers: Observers,
}

/// Which keyframes observe each landmark.
#[derive(Serialize, Deserialize)]
pub(crate) struct Observers {
    /// Indices of the keyframes that observe landmark `at`, ascending: `keyframes[starts[at]..starts[at + 1]]`.
    #[serde(with = "vision::packed")]
    keyframes: Vec<u32>,
    #[serde(with = "vision::packed")]
    starts: Vec<u32>,
}

impl Default for Observers {
    fn default() -> Self {
        Observers::with_capacity(0, 0)
    }
}

impl Observers {
    pub(crate) fn with_capacity(landmarks: usize, observations: usize) -> Observers {
        let mut starts = Vec::with_capacity(landmarks + 1);
        starts.push(0);
        Observers { keyframes: Vec::with_capacity(observations), starts }
    }

    /// Adds a landmark that these keyframes observe (indices, ascending).
    pub(crate) fn push(&mut self, observers: impl Iterator<Item = u32>) {
        self.keyframes.extend(observers);
        self.starts.push(self.keyframes.len() as u32);
    }

    /// Indices of the keyframes that observe a landmark, ascending.
    pub(crate) fn of(&self, landmark: usize) -> &[u32] {
        &self.keyframes[self.starts[landmark] as usize..self.starts[landmark + 1] as usize]
    }
}

/// The observations of a map by keyframe, of each by landmark.
#[derive(Default, Serialize, Deserialize)]
pub(crate) struct Observations {
    /// Those of keyframe `at` are `starts[at]..starts[at + 1]`.
    #[serde(with = "vision::packed")]
    starts: Vec<u32>,
    #[serde(with = "vision::packed")]
    landmarks: Vec<u32>,
    #[serde(with = "vision::packed")]
    pixels: Vec<[f32; 2]>,
    #[serde(with = "vision::packed")]
    descriptors: Vec<u8>,
    /// Bytes in a descriptor.
    width: usize,
}

/// The landmarks that one keyframe observes.
#[derive(Clone, Copy)]
pub(crate) struct Observed<'a> {
    /// Index of each landmark, ascending.
    pub(crate) landmarks: &'a [u32],
    pub(crate) pixels: &'a [[f32; 2]],
    /// Concatenated.
    pub(crate) descriptors: &'a [u8],
}

impl Landmarks {
    pub(crate) fn with_capacity(landmarks: usize, observations: usize) -> Landmarks {
        Landmarks {
            ids: Vec::with_capacity(landmarks),
            anchors: Vec::with_capacity(landmarks),
            positions_in_anchor: Vec::with_capacity(landmarks),
            observers: Observers::with_capacity(landmarks, observations),
        }
    }

    /// Adds a landmark.
    ///
    /// # Arguments
    /// * `observers`: indices of keyframes, ascending.
    pub(crate) fn push(&mut self, landmark: &Landmark, anchor: u32, observers: impl Iterator<Item = u32>) {
        self.ids.push(landmark.id);
        self.anchors.push(anchor);
        self.positions_in_anchor.push(landmark.position_in_anchor);
        self.observers.push(observers);
    }

    pub(crate) fn len(&self) -> usize {
        self.ids.len()
    }
}

impl Observations {
    /// Room for so many observations by each keyframe, to be filled by [`Observations::set`].
    ///
    /// # Errors
    /// [`DescriptorError::Full`] beyond 2^32 - 1 observations.
    pub(crate) fn with_counts(
        counts: impl Iterator<Item = u32>,
        width: usize,
    ) -> Result<Observations, DescriptorError> {
        let mut starts = vec![0_u32];
        let mut total = 0_u32;
        for count in counts {
            total = total.checked_add(count).ok_or(DescriptorError::Full)?;
            starts.push(total);
        }
        let count = total as usize;
        Ok(Observations {
            starts,
            landmarks: vec![0; count],
            pixels: vec![[0.0; 2]; count],
            descriptors: vec![0; count * width],
            width,
        })
    }

    /// Fills observation `at` of a keyframe.
    pub(crate) fn set(&mut self, keyframe: usize, at: usize, landmark: u32, observation: &Observation) {
        let at = self.starts[keyframe] as usize + at;
        self.landmarks[at] = landmark;
        self.pixels[at] = observation.pixel;
        self.descriptors[at * self.width..(at + 1) * self.width].copy_from_slice(&observation.descriptor);
    }

    pub(crate) fn len(&self) -> usize {
        self.landmarks.len()
    }

    /// What a keyframe observes.
    pub(crate) fn of(&self, keyframe: usize) -> Observed<'_> {
        let range = self.starts[keyframe] as usize..self.starts[keyframe + 1] as usize;
        Observed {
            landmarks: &self.landmarks[range.clone()],
            pixels: &self.pixels[range.clone()],
            descriptors: &self.descriptors[range.start * self.width..range.end * self.width],
        }
    }
}

impl Observed<'_> {
    /// Index of observation `at`'s landmark.
    pub(crate) fn landmark(&self, at: usize) -> usize {
        self.landmarks[at] as usize
    }

    /// Where the keyframe observes a landmark, if it does.
    pub(crate) fn pixel_of(&self, landmark: usize) -> Option<[f32; 2]> {
        self.landmarks.binary_search(&(landmark as u32)).ok().map(|at| self.pixels[at])
    }
}

/// A landmark in the camera frame of a keyframe that is not its anchor: on the ray of the keyframe's own pixel, at
/// the depth that the map gives, see [`Keyframe::point_on_ray`].
pub(crate) fn point_in_keyframe(
    keyframe: &Keyframe,
    position_in_global: &Vector3<f64>,
    pixel: [f32; 2],
) -> Vector3<f64> {
    let transformed = || keyframe.global_from_keyframe.pose.inverse_transform(position_in_global);
    keyframe.point_on_ray(pixel, position_in_global).unwrap_or_else(transformed)
}
