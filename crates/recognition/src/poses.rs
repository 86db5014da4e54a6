//! The keyframes of a map and how their errors are correlated: what all kinds of its features have in common.

use geometry::Viewpoint;
use map::contents::MapContents;
use map::model::{CommonError, Keyframe};
use serde::{Deserialize, Serialize};

use super::cross_covariances::CrossCovariances;

/// The keyframes of a map with the joint covariance of their poses.
#[derive(Default, Serialize, Deserialize)]
pub(crate) struct MapPoses {
    /// By id, without their features.
    #[serde(deserialize_with = "vision::exact")]
    pub(crate) keyframes: Vec<Keyframe>,
    /// Of the keyframes, in the same order.
    #[serde(deserialize_with = "vision::exact")]
    pub(crate) viewpoints: Vec<Viewpoint>,
    /// Of a part of a map also those with keyframes of other parts.
    pub(crate) cross_covariances: CrossCovariances,
    /// By keyframe.
    #[serde(deserialize_with = "vision::exact")]
    pub(crate) common_errors: Vec<CommonError>,
}

impl MapPoses {
    /// Takes the poses out of a sorted map.
    pub(crate) fn take(contents: &mut MapContents) -> MapPoses {
        let mut keyframes = std::mem::take(&mut contents.keyframes);
        let mut common_errors = std::mem::take(&mut contents.common_errors);
        for keyframe in &mut keyframes {
            keyframe.features = None;
        }
        keyframes.shrink_to_fit();
        common_errors.shrink_to_fit();
        MapPoses {
            viewpoints: keyframes.iter().map(Keyframe::viewpoint).collect(),
            keyframes,
            cross_covariances: CrossCovariances::new(std::mem::take(&mut contents.cross_covariances)),
            common_errors,
        }
    }
}
