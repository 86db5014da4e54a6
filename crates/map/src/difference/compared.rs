//! What is compared of one version of a map.

use std::collections::BTreeMap;
use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash as _, Hasher as _};

use nalgebra::{Matrix6, Vector3};
use protocol::{KeyframeId, LandmarkId};

use crate::contents::MapContents;
use crate::file::Segment;
use crate::model::{CommonError, Keyframe, KeyframeCrossCovariance, Landmark};

/// What is compared of one version of a map: all of it, or what is left when the parts that both versions have are left out.
///
/// A landmark comes with its anchor; cross-covariances may be with keyframes of the parts that are left out.
///
/// # Example
/// ```
/// use map::difference::{Compared, MapDifference};
/// use map::{MapContents, MapMetadata};
/// use protocol::DescriptorKind;
///
/// let map = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
/// let difference = MapDifference::between(&Compared::of(&map), &Compared::of(&map));
/// assert!(difference.is_empty());
/// ```
#[derive(Clone, Debug, Default)]
pub struct Compared<'a> {
    pub(super) keyframes: BTreeMap<KeyframeId, &'a Keyframe>,
    pub(super) landmarks: BTreeMap<LandmarkId, (KeyframeId, Vector3<f64>)>,
    pub(super) common_errors: BTreeMap<KeyframeId, &'a CommonError>,
    /// By (a, b), `a <= b`.
    blocks: BTreeMap<(KeyframeId, KeyframeId), &'a KeyframeCrossCovariance>,
    /// A digest of what each keyframe observes, whatever the order.
    pub(super) observed: BTreeMap<KeyframeId, u64>,
}

impl<'a> Compared<'a> {
    /// A whole map, with all kinds of features.
    pub fn of(contents: &'a MapContents) -> Self {
        let mut compared = Self::default();
        contents.keyframes.iter().for_each(|keyframe| compared.add_keyframe(keyframe));
        for (_, landmarks) in contents.landmarks_of_kinds() {
            for landmark in landmarks {
                compared.add_landmark(landmark);
            }
        }
        contents.cross_covariances.iter().for_each(|cross| compared.add_cross_covariance(cross));
        contents.common_errors.iter().for_each(|common| compared.add_common_error(common));
        compared
    }

    /// Some segments of a map.
    pub fn of_segments(segments: &'a [Segment]) -> Self {
        let mut compared = Self::default();
        for segment in segments {
            segment.keyframes.iter().for_each(|keyframe| compared.add_keyframe(keyframe));
            segment.landmarks.iter().for_each(|landmark| compared.add_landmark(landmark));
            segment.cross_covariances.iter().for_each(|cross| compared.add_cross_covariance(cross));
            segment.common_errors.iter().for_each(|common| compared.add_common_error(common));
        }
        compared
    }

    /// Adds a keyframe.
    pub fn add_keyframe(&mut self, keyframe: &'a Keyframe) {
        self.keyframes.insert(keyframe.id, keyframe);
    }

    /// Adds a landmark.
    pub fn add_landmark(&mut self, landmark: &Landmark) {
        let seen = landmark.observations.iter().map(|seen| (seen.keyframe, seen.pixel));
        self.add_observed(landmark.id, landmark.anchor, landmark.position_in_anchor, seen);
    }

    /// Adds a landmark by its parts.
    ///
    /// # Arguments
    /// * `position_in_anchor`: in the camera frame of `anchor` (m).
    /// * `observations`: the observing keyframes, each with its pixel.
    pub fn add_observed(
        &mut self,
        id: LandmarkId,
        anchor: KeyframeId,
        position_in_anchor: Vector3<f64>,
        observations: impl Iterator<Item = (KeyframeId, [f32; 2])>,
    ) {
        self.landmarks.insert(id, (anchor, position_in_anchor));
        for (keyframe, pixel) in observations {
            let mut hasher = DefaultHasher::new();
            (id, anchor).hash(&mut hasher);
            position_in_anchor.iter().for_each(|value| value.to_bits().hash(&mut hasher));
            pixel.map(f32::to_bits).hash(&mut hasher);
            let digest = self.observed.entry(keyframe).or_default();
            *digest = digest.wrapping_add(hasher.finish());
        }
    }

    /// Adds a cross-covariance, in either order of its keyframes.
    pub fn add_cross_covariance(&mut self, cross: &'a KeyframeCrossCovariance) {
        self.blocks.insert((cross.a.min(cross.b), cross.a.max(cross.b)), cross);
    }

    /// Adds a keyframe's part of the common error.
    pub fn add_common_error(&mut self, common: &'a CommonError) {
        self.common_errors.insert(common.keyframe, common);
    }

    pub(super) fn pairs(&self) -> impl Iterator<Item = &(KeyframeId, KeyframeId)> {
        self.blocks.keys()
    }

    /// The cross-covariance of a pair, rows of the smaller id; zero where none is listed.
    pub(super) fn block(&self, pair: &(KeyframeId, KeyframeId)) -> Matrix6<f64> {
        self.blocks.get(pair).map_or_else(Matrix6::zeros, |cross| cross.ordered().block)
    }

    /// The position of a landmark in G (m); `None` where it or its anchor is not there.
    pub(super) fn landmark_in_global(&self, id: LandmarkId) -> Option<Vector3<f64>> {
        let (anchor, position) = self.landmarks.get(&id)?;
        let anchor = self.keyframes.get(anchor)?;
        Some(anchor.global_from_keyframe.pose.transform(position))
    }
}
