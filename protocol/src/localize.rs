//! `map/{map}/localize`: features and a camera in, its global pose out, for clients without an estimator.

use crate::features::{FeatureSet, require_query};
use crate::identity::MapIdentity;
use crate::limits::KeyframeId;
use crate::matching::{MatchOutcome, PosePrior};
use crate::validate::{
    InvalidField, Validate, require, require_each, require_finite, require_not_negative, require_unit,
    require_valid,
};
use crate::wire;
use geometry::camera::Camera;
use geometry::uncertain_pose::PoseWithCovariance;
use serde::{Deserialize, Serialize};

/// Asks where an image was taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LocalizeRequest {
    /// The camera that took it.
    #[serde(with = "wire::CameraForm")]
    pub camera: Camera,
    /// Features of the image.
    pub features: FeatureSet,
    /// Prior of the camera pose; none searches the whole map.
    #[serde(default)]
    pub prior: Option<PosePrior>,
    /// Unit vector along gravity (down) in the camera frame, if known.
    #[serde(default)]
    pub gravity_in_camera: Option<[f64; 3]>,
}

impl Validate for LocalizeRequest {
    fn validate(&self) -> Result<(), InvalidField> {
        require_valid(&self.camera, "camera")?;
        require_query(&self.features)?;
        require_valid(self.prior.as_ref(), "prior")?;
        require_unit(self.gravity_in_camera.as_ref(), "gravity_in_camera")
    }
}

/// The answer to a [`LocalizeRequest`]: a pose exactly if the outcome is [`MatchOutcome::Matched`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LocalizeReply {
    /// Version of the searched map.
    pub map_version: u64,
    /// Identity of the map: other maps have versions of the same numbers.
    pub map_identity: MapIdentity,
    /// Result of the search.
    pub outcome: MatchOutcome,
    /// The pose found.
    #[serde(default)]
    pub fix: Option<LocalizedPose>,
    /// The places that explain the image, the one that explains most of it first: with more than one, or with small odds, the
    /// image is not distinctive. Of a map in cells those of the cell that answers.
    #[serde(default)]
    pub places: Vec<PossiblePlace>,
}

impl Validate for LocalizeReply {
    fn validate(&self) -> Result<(), InvalidField> {
        let consistent = self.fix.is_some() == (self.outcome == MatchOutcome::Matched);
        require(consistent, "fix", "must be present exactly when the outcome is `matched`")?;
        require_valid(self.fix.as_ref(), "fix")?;
        require_each(&self.places, "places", Validate::validate)
    }
}

/// A place that an image could be of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PossiblePlace {
    /// The camera in the map's frame, if the image is of this place.
    #[serde(with = "wire::PoseForm")]
    pub global_from_camera: PoseWithCovariance,
    /// Features of the image that landmarks of the place explain.
    pub features: u32,
    /// Natural logarithm of the odds that the image is of this place and not of another one that looks alike in part.
    pub log_odds: f64,
}

impl Validate for PossiblePlace {
    fn validate(&self) -> Result<(), InvalidField> {
        require_valid(&self.global_from_camera, "global_from_camera")?;
        require_finite(&[self.log_odds], "log_odds")
    }
}

/// A camera pose estimated from one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LocalizedPose {
    /// The camera in the map's frame; the covariance includes that of the map.
    #[serde(with = "wire::PoseForm")]
    pub global_from_camera: PoseWithCovariance,
    /// The keyframe that matched best.
    pub keyframe: KeyframeId,
    /// Query features that matched a landmark.
    pub matched_features: u32,
    /// Those of them that are consistent with the pose.
    pub inliers: u32,
    /// Mean reprojection error of the inliers, pixels.
    pub mean_error_px: f64,
}

impl Validate for LocalizedPose {
    fn validate(&self) -> Result<(), InvalidField> {
        require_valid(&self.global_from_camera, "global_from_camera")?;
        require(self.inliers <= self.matched_features, "inliers", "exceeds matched_features")?;
        require_not_negative(self.mean_error_px, "mean_error_px")
    }
}
