//! The elements of a map in the order in which they are stored, without a copy of the map.

use std::borrow::Cow;

use super::MapContents;
use crate::added::{FeatureKind, KeptImage};
use crate::model::{
    CommonError, Keyframe, KeyframeAliases, KeyframeCrossCovariance, Landmark, LandmarkExistence,
};

/// What [`MapContents::sort`] would make of a map: everything by its key, observations by keyframe, `a < b`.
pub(crate) struct Sorted<'a> {
    pub(crate) keyframes: Vec<&'a Keyframe>,
    pub(crate) landmarks: Vec<Cow<'a, Landmark>>,
    pub(crate) cross_covariances: Vec<Cow<'a, KeyframeCrossCovariance>>,
    pub(crate) common_errors: Vec<&'a CommonError>,
    pub(crate) aliases: Vec<&'a KeyframeAliases>,
    /// The added kinds with their landmarks.
    pub(crate) added_features: Vec<(&'a FeatureKind, Vec<Cow<'a, Landmark>>)>,
    pub(crate) images: Vec<&'a KeptImage>,
    pub(crate) existence: Vec<&'a LandmarkExistence>,
}

impl<'a> Sorted<'a> {
    pub(crate) fn of(contents: &'a MapContents) -> Self {
        let mut sorted = Sorted {
            keyframes: contents.keyframes.iter().collect(),
            landmarks: sorted_landmarks(&contents.landmarks),
            cross_covariances: contents.cross_covariances.iter().map(ordered).collect(),
            common_errors: contents.common_errors.iter().collect(),
            aliases: contents.aliases.iter().collect(),
            added_features: contents
                .added_features
                .iter()
                .map(|added| (&added.kind, sorted_landmarks(&added.landmarks)))
                .collect(),
            images: contents.images.iter().collect(),
            existence: contents.existence.iter().collect(),
        };
        sorted.keyframes.sort_by_key(|keyframe| keyframe.id);
        sorted.cross_covariances.sort_by_key(|cross| (cross.a, cross.b));
        sorted.common_errors.sort_by_key(|common| common.keyframe);
        sorted.aliases.sort_by_key(|aliases| aliases.keyframe);
        sorted.images.sort_by_key(|image| image.keyframe);
        sorted.existence.sort_by_key(|existence| existence.landmark);
        sorted
    }
}

fn sorted_landmarks(landmarks: &[Landmark]) -> Vec<Cow<'_, Landmark>> {
    let mut sorted: Vec<_> = landmarks.iter().map(with_sorted_observations).collect();
    sorted.sort_by_key(|landmark| landmark.id);
    sorted
}

fn with_sorted_observations(landmark: &Landmark) -> Cow<'_, Landmark> {
    if landmark.observations.is_sorted_by_key(|observation| observation.keyframe) {
        return Cow::Borrowed(landmark);
    }
    let mut landmark = landmark.clone();
    landmark.observations.sort_by_key(|observation| observation.keyframe);
    Cow::Owned(landmark)
}

fn ordered(cross: &KeyframeCrossCovariance) -> Cow<'_, KeyframeCrossCovariance> {
    if cross.a <= cross.b { Cow::Borrowed(cross) } else { Cow::Owned(cross.ordered()) }
}
