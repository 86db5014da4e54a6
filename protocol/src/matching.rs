//! `map/{map}/match`: features of an image in, matched keyframes with their landmarks out.
//!
//! ```text
//! robot                                map server
//!   MatchRequest  ------------------->
//!                 <-------------------  MatchReply::Keyframe   rank 0, the best
//!                 <-------------------  MatchReply::Keyframe   rank 1, ..
//!                 <-------------------  MatchReply::Done       always, and always last
//! ```
//! No `Done` means that the answer is incomplete: ask again. It never means "no match".

use crate::codec::{Message, malformed_json};
use crate::features::FeatureSet;
use crate::validate::{InvalidField, Validate, require, require_each, require_finite, require_unit};
use crate::{KeyframeId, LandmarkId, keys, wire};
use geometry::camera::Camera;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::Matrix6;
use serde::{Deserialize, Serialize};

/// Where the asker believes its camera to be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PosePrior {
    /// Camera in the map's frame, with an honest covariance: the search is narrowed to it.
    #[serde(with = "wire::uncertain_pose")]
    pub global_from_camera: PoseWithCovariance,
}

impl Validate for PosePrior {
    fn validate(&self) -> Result<(), InvalidField> {
        self.global_from_camera.validate().map_err(|violation| violation.within("global_from_camera"))
    }
}

/// Which keyframes does this image match?
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MatchRequest {
    /// Name of the asking robot, as in its keys.
    pub robot: String,
    /// Sensor time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// The camera that took it.
    #[serde(with = "wire::camera")]
    pub camera: Camera,
    /// What was seen. May be empty; the answer then says [`MatchOutcome::TooFewFeatures`].
    pub features: FeatureSet,
    /// Where the camera probably is; none means anywhere in the map.
    #[serde(default)]
    pub prior: Option<PosePrior>,
    /// Unit vector along which things fall, in the camera frame, if known.
    #[serde(default)]
    pub gravity_in_camera: Option<[f64; 3]>,
    /// Keyframes that the robot holds of this map, in any order: cross-covariances towards them are wanted. From bincode
    /// they come sorted, none twice.
    #[serde(default, with = "wire::keyframe_set")]
    pub held: Vec<KeyframeId>,
    /// Version of the map when the held keyframes were fetched.
    #[serde(default)]
    pub map_version_held: Option<u64>,
    /// Most keyframes to send: 1 for single matching.
    pub max_keyframes: u16,
}

impl Validate for MatchRequest {
    fn validate(&self) -> Result<(), InvalidField> {
        keys::validate_name(&self.robot).map_err(|error| InvalidField::new("robot", error.to_string()))?;
        Validate::validate(&self.camera).map_err(|violation| violation.within("camera"))?;
        self.features.validate().map_err(|violation| violation.within("features"))?;
        if let Some(prior) = &self.prior {
            prior.validate().map_err(|violation| violation.within("prior"))?;
        }
        if let Some(gravity) = &self.gravity_in_camera {
            require_unit(gravity, "gravity_in_camera")?;
        }
        require(self.max_keyframes > 0, "max_keyframes", "is zero")
    }
}

impl Message for MatchRequest {
    const TAG: u16 = 1;
    const NAME: &'static str = "match_request";
}

/// One part of the answer to a [`MatchRequest`].
///
/// In JSON `{"schema": 2, "type": "match_reply", "keyframe": {..}}` or `{.., "done": {..}}`.
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
            Self::Keyframe(keyframe) => keyframe.validate().map_err(|violation| violation.within("keyframe")),
            Self::Done(status) => status.validate().map_err(|violation| violation.within("done")),
        }
    }
}

impl Message for MatchReply {
    const TAG: u16 = 2;
    const NAME: &'static str = "match_reply";

    /// The flat object holds more keys than serde's form of an enumeration has, so they are told apart here.
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
    /// Its camera in the map's frame, as uncertain as the map knows it.
    #[serde(with = "wire::uncertain_pose")]
    pub global_from_keyframe: PoseWithCovariance,
    /// The camera that took it.
    #[serde(with = "wire::camera")]
    pub camera: Camera,
}

impl Validate for KeyframeRecord {
    fn validate(&self) -> Result<(), InvalidField> {
        self.global_from_keyframe.validate().map_err(|violation| violation.within("global_from_keyframe"))?;
        Validate::validate(&self.camera).map_err(|violation| violation.within("camera"))
    }
}

/// How the pose errors of two keyframes move together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CrossCovariance {
    /// The other keyframe.
    pub other: KeyframeId,
    /// `E[error(this keyframe) error(other)^T]`, 6x6, each error `[dtheta, dp]` in the map's frame.
    #[serde(with = "wire::matrix6")]
    pub block: Matrix6<f64>,
}

impl Validate for CrossCovariance {
    fn validate(&self) -> Result<(), InvalidField> {
        require_finite(self.block.as_slice(), "block")
    }
}

/// A keyframe of the answer with the query's features that it explains.
///
/// The anchor of every landmark is a keyframe of the same answer that observed it: where the map's own anchor is not
/// sent, the server anchors the landmark anew in the keyframe that matched it. Observations are from keyframes of the
/// same answer or of the request's `held`. A keyframe without `matches` is covisible: it observed landmarks that
/// keyframes of smaller rank matched.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MatchedKeyframe {
    /// Version of the map that this is from.
    pub map_version: u64,
    /// 0 is the best match; covisible keyframes without matches of their own come last.
    pub rank: u16,
    /// The keyframe.
    pub keyframe: KeyframeRecord,
    /// Towards keyframes that the robot holds and those of this answer with a smaller rank; absent is independent.
    #[serde(default)]
    pub cross_covariances: Vec<CrossCovariance>,
    /// Which of the query's features are which landmarks. No feature twice.
    #[serde(default)]
    pub matches: Vec<LandmarkMatch>,
}

impl Validate for MatchedKeyframe {
    fn validate(&self) -> Result<(), InvalidField> {
        self.keyframe.validate().map_err(|violation| violation.within("keyframe"))?;
        require_each(&self.cross_covariances, "cross_covariances", Validate::validate)?;
        require_each(&self.matches, "matches", Validate::validate)?;
        let mut features: Vec<u32> = self.matches.iter().map(|found| found.feature).collect();
        features.sort_unstable();
        require(features.windows(2).all(|pair| pair[0] != pair[1]), "matches", "uses a query feature twice")
    }
}

/// A landmark that one of the query's features shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LandmarkMatch {
    /// Index into the request's features.
    pub feature: u32,
    /// The landmark.
    pub landmark: LandmarkId,
    /// The keyframe in whose camera frame its position is given.
    pub anchor: KeyframeId,
    /// Position in the anchor's camera frame, metres.
    pub position_in_anchor: [f64; 3],
    /// Distance of the descriptors as a fraction: of the bits for binary ones, cosine distance for floats.
    pub distance: f32,
    /// Where the map's keyframes saw it, the anchor included; only keyframes of this answer or held by the robot.
    #[serde(default)]
    pub observations: Vec<KeyframePixel>,
}

impl Validate for LandmarkMatch {
    fn validate(&self) -> Result<(), InvalidField> {
        require_finite(&self.position_in_anchor, "position_in_anchor")?;
        require(
            self.distance.is_finite() && self.distance >= 0.0,
            "distance",
            "is not a finite, non-negative number",
        )?;
        require_each(&self.observations, "observations", Validate::validate)
    }
}

/// Where a keyframe saw a landmark.
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

/// How a search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MatchOutcome {
    /// At least one keyframe matched and passed geometric verification.
    Matched,
    /// No keyframe looks like the image.
    NoMatch,
    /// Some keyframes look like it, but no camera pose explains the matches.
    NotVerified,
    /// The query has too few features to be matched at all.
    TooFewFeatures,
    /// The map has no keyframes.
    EmptyMap,
    /// Two places of the map that look alike explain the image nearly equally well, so neither is an answer. A prior
    /// pose, or an image from elsewhere, tells them apart.
    Ambiguous,
}

/// The end of an answer: what was found, and what holds for all of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MatchStatus {
    /// Version of the map that was searched.
    pub map_version: u64,
    /// How the search ended.
    pub outcome: MatchOutcome,
    /// Number of [`MatchReply::Keyframe`]s that were sent before: fewer received means that some were lost.
    pub keyframes_sent: u16,
    /// Number of keyframes that were compared with the image.
    pub searched_keyframes: u32,
    /// Time the server took, microseconds.
    pub elapsed_us: u64,
    /// Unit vector along which things fall, in the map's frame, if the map knows.
    #[serde(default)]
    pub gravity_in_global: Option<[f64; 3]>,
    /// Standard deviation of the map's pixels, pixels.
    pub sigma_map_px: f64,
}

impl Validate for MatchStatus {
    fn validate(&self) -> Result<(), InvalidField> {
        if let Some(gravity) = &self.gravity_in_global {
            require_unit(gravity, "gravity_in_global")?;
        }
        let positive = self.sigma_map_px.is_finite() && self.sigma_map_px > 0.0;
        require(positive, "sigma_map_px", "is not a finite, positive number")
    }
}
