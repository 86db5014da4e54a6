//! `map/{map}/match`: features of an image in, matched keyframes with their landmarks out.
//!
//! ```text
//! robot                                map server
//!   MatchRequest  ------------------->
//!                 <-------------------  MatchReply::Keyframe   rank 0, the best
//!                 <-------------------  MatchReply::Keyframe   rank 1, ..
//!                 <-------------------  MatchReply::Done       always, and always last
//! ```
//! Without `Done` the answer is incomplete: ask again. It never means "no match".

use crate::codec::{Message, malformed_json};
use crate::features::{FeatureSet, require_query};
use crate::identity::MapIdentity;
use crate::limits::{KeyframeId, LandmarkId, MAX_ANSWER_KEYFRAMES, MAX_COMMON_ERRORS, MAX_HELD_KEYFRAMES};
use crate::validate::{
    InvalidField, Validate, require, require_each, require_finite, require_name, require_not_negative,
    require_position, require_positive, require_unit, require_valid,
};
use crate::wire;
use geometry::camera::Camera;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::Matrix6;
use serde::{Deserialize, Serialize};

/// Prior of a camera pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PosePrior {
    /// Camera in the map's frame with its covariance; the search is restricted to it.
    #[serde(with = "wire::PoseForm")]
    pub global_from_camera: PoseWithCovariance,
}

impl Validate for PosePrior {
    fn validate(&self) -> Result<(), InvalidField> {
        require_valid(&self.global_from_camera, "global_from_camera")
    }
}

/// Asks which keyframes an image matches.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MatchRequest {
    /// Name of the robot, as in its keys.
    pub robot: String,
    /// Sensor time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// The camera that took it.
    #[serde(with = "wire::CameraForm")]
    pub camera: Camera,
    /// Features of the image. May be empty; the outcome is then [`MatchOutcome::TooFewFeatures`].
    pub features: FeatureSet,
    /// Prior of the camera pose; none searches the whole map.
    #[serde(default)]
    pub prior: Option<PosePrior>,
    /// Unit vector along gravity (down) in the camera frame, if known.
    #[serde(default)]
    pub gravity_in_camera: Option<[f64; 3]>,
    /// Keyframes of this map in the robot's state, in any order: the answer says how others are correlated with them. Decoded
    /// from bincode they are sorted and unique. At most [`MAX_HELD_KEYFRAMES`].
    #[serde(default, with = "wire::keyframe_set")]
    pub held: Vec<KeyframeId>,
    /// Version of the map when the held keyframes were fetched. Where it is the version of the answer, what correlates the
    /// held keyframes with each other is not sent again.
    #[serde(default)]
    pub map_version_held: Option<u64>,
    /// Maximum number of keyframes in the answer: 1 for single matching.
    pub max_keyframes: u16,
}

impl Validate for MatchRequest {
    fn validate(&self) -> Result<(), InvalidField> {
        require_name(&self.robot, "robot")?;
        require_valid(&self.camera, "camera")?;
        require_query(&self.features)?;
        require_valid(self.prior.as_ref(), "prior")?;
        require_unit(self.gravity_in_camera.as_ref(), "gravity_in_camera")?;
        let held = self.held.len() <= MAX_HELD_KEYFRAMES;
        require(held, "held", &format!("names more than {MAX_HELD_KEYFRAMES} keyframes"))?;
        require(self.max_keyframes > 0, "max_keyframes", "is zero")?;
        let few = self.max_keyframes <= MAX_ANSWER_KEYFRAMES;
        require(few, "max_keyframes", &format!("is more than {MAX_ANSWER_KEYFRAMES}"))
    }
}

/// One part of the answer to a [`MatchRequest`].
///
/// In JSON `{"schema": 10, "type": "match_reply", "keyframe": {..}}` or `{.., "done": {..}}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(clippy::large_enum_variant)] // one value at a time, moved once
pub enum MatchReply {
    /// A keyframe of the answer.
    Keyframe(MatchedKeyframe),
    /// The end of the answer.
    Done(MatchStatus),
}

impl Validate for MatchReply {
    fn validate(&self) -> Result<(), InvalidField> {
        match self {
            Self::Keyframe(keyframe) => require_valid(keyframe, "keyframe"),
            Self::Done(status) => require_valid(status, "done"),
        }
    }
}

impl Message for MatchReply {
    const TAG: u16 = 2;
    const NAME: &'static str = "match_reply";

    /// The flat object has more keys than serde's form of an enumeration allows, so the variants are distinguished here.
    fn from_json(bytes: &[u8]) -> Result<Self, serde_json::Error> {
        #[derive(Deserialize)]
        struct Parts {
            keyframe: Option<MatchedKeyframe>,
            done: Option<MatchStatus>,
        }
        match serde_json::from_slice(bytes)? {
            Parts { keyframe: Some(keyframe), done: None } => Ok(Self::Keyframe(keyframe)),
            Parts { keyframe: None, done: Some(status) } => Ok(Self::Done(status)),
            _ => Err(malformed_json("a match_reply holds either `keyframe` or `done`")),
        }
    }
}

/// A keyframe without its features.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyframeRecord {
    /// Its number in the map.
    pub id: KeyframeId,
    /// Sensor time of its image, nanoseconds.
    pub stamp_ns: i64,
    /// Its camera in the map's frame with the covariance in the map.
    #[serde(with = "wire::PoseForm")]
    pub global_from_keyframe: PoseWithCovariance,
    /// The camera that took it.
    #[serde(with = "wire::CameraForm")]
    pub camera: Camera,
}

impl Validate for KeyframeRecord {
    fn validate(&self) -> Result<(), InvalidField> {
        require_valid(&self.global_from_keyframe, "global_from_keyframe")?;
        require_valid(&self.camera, "camera")
    }
}

/// Cross-covariance of the pose errors of two keyframes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CrossCovarianceBlock {
    /// The other keyframe.
    pub other: KeyframeId,
    /// `E[error(this keyframe) error(other)^T]`, 6x6, each error `[dtheta, dp]` in the map's frame.
    #[serde(with = "wire::matrix6")]
    pub block: Matrix6<f64>,
}

impl Validate for CrossCovarianceBlock {
    fn validate(&self) -> Result<(), InvalidField> {
        require_finite(self.block.as_slice(), "block")
    }
}

/// A keyframe of the answer with the landmarks that match features of the query.
///
/// The anchor of every landmark is a keyframe of the same answer that observes it: if the map's own anchor is not sent,
/// the server re-anchors the landmark in the keyframe that matched it. Observations are from keyframes of the
/// same answer or of the request's `held`. A keyframe without `matches` is covisible: it observes landmarks that
/// keyframes of smaller rank matched.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MatchedKeyframe {
    /// Version of the map.
    pub map_version: u64,
    /// Identity of the map: other maps have versions of the same numbers.
    pub map_identity: MapIdentity,
    /// 0 is the best match; covisible keyframes without matches of their own come last.
    pub rank: u16,
    /// The keyframe.
    pub keyframe: KeyframeRecord,
    /// Its part of the error common to all keyframes: the columns of `U` in its error `U x + rest`, `[dtheta, dp]` in the
    /// map's frame, where `x` holds independent standard normal numbers, the same for the whole map. Empty where the map
    /// states nothing of that, and where it is held in this version.
    #[serde(default)]
    pub common_error: Vec<[f64; 6]>,
    /// Cross-covariances of the rest with keyframes in `held` and with keyframes of this answer of smaller rank; absent means
    /// independent. Where it is held in this version, those with held keyframes are left out.
    #[serde(default)]
    pub cross_covariances: Vec<CrossCovarianceBlock>,
    /// Matches between features of the query and landmarks; each feature at most once.
    #[serde(default)]
    pub matches: Vec<LandmarkMatch>,
}

impl Validate for MatchedKeyframe {
    fn validate(&self) -> Result<(), InvalidField> {
        require_valid(&self.keyframe, "keyframe")?;
        let few = self.common_error.len() <= MAX_COMMON_ERRORS;
        require(few, "common_error", &format!("has more than {MAX_COMMON_ERRORS} columns"))?;
        require_finite(self.common_error.as_flattened(), "common_error")?;
        require_each(&self.cross_covariances, "cross_covariances", Validate::validate)?;
        require_each(&self.matches, "matches", Validate::validate)?;
        let mut features: Vec<u32> = self.matches.iter().map(|found| found.feature).collect();
        features.sort_unstable();
        require(features.windows(2).all(|pair| pair[0] != pair[1]), "matches", "uses a query feature twice")
    }
}

/// A match between a feature of the query and a landmark.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LandmarkMatch {
    /// Index into the request's features.
    pub feature: u32,
    /// The landmark.
    pub landmark: LandmarkId,
    /// The keyframe in whose camera frame the position is expressed.
    pub anchor: KeyframeId,
    /// Position in the anchor's camera frame, metres.
    pub position_in_anchor: [f64; 3],
    /// Distance of the descriptors as a fraction: of the bits for binary ones, cosine distance for floats.
    pub distance: f32,
    /// Its pixels in the map's keyframes, the anchor included; only keyframes of this answer or in `held`.
    #[serde(default)]
    pub observations: Vec<KeyframePixel>,
}

impl Validate for LandmarkMatch {
    fn validate(&self) -> Result<(), InvalidField> {
        require_position(&self.position_in_anchor, "position_in_anchor")?;
        require_not_negative(self.distance.into(), "distance")?;
        require_each(&self.observations, "observations", Validate::validate)
    }
}

/// Pixel of a landmark in a keyframe.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyframePixel {
    /// The keyframe.
    pub keyframe: KeyframeId,
    /// `[u, v]` in its image, distorted.
    pub pixel: [f32; 2],
}

impl Validate for KeyframePixel {
    fn validate(&self) -> Result<(), InvalidField> {
        require(self.pixel.iter().all(|value| value.is_finite()), "pixel", "is not finite")
    }
}

/// Result of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MatchOutcome {
    /// At least one keyframe matched and passed geometric verification.
    Matched,
    /// No keyframe is similar to the image.
    NoMatch,
    /// Some keyframes are similar, but no camera pose is consistent with the matches.
    NotVerified,
    /// The query has too few features to be matched.
    TooFewFeatures,
    /// The map has no keyframes.
    EmptyMap,
    /// Two different parts of the map match the image about equally well (perceptual aliasing), so neither is returned. A
    /// prior pose, or an image from elsewhere, resolves it.
    Ambiguous,
}

/// The end of an answer: the result of the search and properties of the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MatchStatus {
    /// Version of the searched map.
    pub map_version: u64,
    /// Identity of the map: other maps have versions of the same numbers.
    pub map_identity: MapIdentity,
    /// Result of the search.
    pub outcome: MatchOutcome,
    /// Number of [`MatchReply::Keyframe`]s sent before this one: if fewer were received, some were lost.
    pub keyframes_sent: u16,
    /// Number of keyframes compared with the image.
    pub searched_keyframes: u32,
    /// Processing time of the server, microseconds.
    pub elapsed_us: u64,
    /// Unit vector along gravity (down) in the map's frame, if known.
    #[serde(default)]
    pub gravity_in_global: Option<[f64; 3]>,
    /// Standard deviation of the map's pixels, px.
    pub sigma_map_px: f64,
    /// Natural logarithm of the odds that the image is of the place that the answer shows, and not of a picture that repeats,
    /// both being equally likely before. Zero without an answer.
    pub log_odds: f64,
    /// What of it holds for the map before any image is seen: how little of it looks like other parts. It counts once for a
    /// pose, however many places speak for that.
    pub log_prior_odds: f64,
}

impl Validate for MatchStatus {
    fn validate(&self) -> Result<(), InvalidField> {
        require_unit(self.gravity_in_global.as_ref(), "gravity_in_global")?;
        require_positive(self.sigma_map_px, "sigma_map_px")?;
        require_finite(&[self.log_odds], "log_odds")?;
        require_finite(&[self.log_prior_odds], "log_prior_odds")
    }
}
