//! `map/{map}/info`, `map/{map}/keyframes/{id}` and `map/{map}/changes`: reading a map remotely, and notices of its
//! changes.

use crate::features::{DescriptorFormat, validate_extractor};
use crate::identity::MapIdentity;
use crate::limits::{KeyframeId, LandmarkId, MAX_CHANGE_M, MAX_CHANGE_RAD};
use crate::matching::KeyframeRecord;
use crate::validate::{
    InvalidField, Validate, require, require_each, require_name, require_not_negative, require_position,
    require_positive, require_unit, require_valid,
};
use nalgebra::Vector6;
use serde::{Deserialize, Serialize};

/// Properties of a map: the answer to `map/{map}/info`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapInfoReply {
    /// Its name, as in its keys.
    pub name: String,
    /// Version of the map; grows with every change.
    pub version: u64,
    /// Identity of the map: the same for all its versions, different for different maps.
    pub identity: MapIdentity,
    /// Schema of its database (not of this message).
    pub database_schema: u16,
    /// Number of keyframes.
    pub keyframes: u64,
    /// Number of landmarks, of the first kind of features.
    pub landmarks: u64,
    /// Number of observations of these landmarks by keyframes.
    pub observations: u64,
    /// Number of cross-covariance blocks between keyframes.
    pub cross_covariances: u64,
    /// Unit vector along gravity (down) in the map's frame, if known.
    #[serde(default)]
    pub gravity_in_global: Option<[f64; 3]>,
    /// Bounding box of its keyframes; none for an empty map.
    #[serde(default)]
    pub extent: Option<Extent>,
    /// Format of a query's descriptors, of the first kind of features; none for an empty map.
    #[serde(default)]
    pub descriptors: Option<DescriptorFormat>,
    /// Name and version of the extractor of a query's features, of the first kind; empty if unknown.
    #[serde(default)]
    pub extractor: String,
    /// Standard deviation of the map's pixels, px.
    pub sigma_map_px: f64,
    /// The kinds of features that a query may have, the one of `descriptors` and `extractor` first. Empty where it is not stated: by a
    /// server of an older schema, and for an empty map.
    #[serde(default)]
    pub feature_kinds: Vec<FeatureKind>,
}

impl Validate for MapInfoReply {
    fn validate(&self) -> Result<(), InvalidField> {
        require_name(&self.name, "name")?;
        require_unit(self.gravity_in_global.as_ref(), "gravity_in_global")?;
        require_valid(self.extent.as_ref(), "extent")?;
        require_valid(self.descriptors.as_ref(), "descriptors")?;
        validate_extractor(&self.extractor)?;
        require_positive(self.sigma_map_px, "sigma_map_px")?;
        require_each(&self.feature_kinds, "feature_kinds", Validate::validate)
    }
}

/// A kind of features of a map: a query with it is answered with its landmarks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FeatureKind {
    /// Name and version of the extractor; empty if unknown.
    #[serde(default)]
    pub extractor: String,
    /// Format of a query's descriptors.
    pub descriptors: DescriptorFormat,
    /// Number of landmarks.
    pub landmarks: u64,
    /// Number of observations of landmarks by keyframes.
    pub observations: u64,
    /// Standard deviation of the pixels, px.
    pub sigma_map_px: f64,
}

impl Validate for FeatureKind {
    fn validate(&self) -> Result<(), InvalidField> {
        validate_extractor(&self.extractor)?;
        require_valid(&self.descriptors, "descriptors")?;
        require_positive(self.sigma_map_px, "sigma_map_px")
    }
}

/// Axis-aligned bounding box of all keyframe positions in the map's frame, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Extent {
    /// Smallest coordinates.
    pub min: [f64; 3],
    /// Largest coordinates.
    pub max: [f64; 3],
}

impl Validate for Extent {
    fn validate(&self) -> Result<(), InvalidField> {
        require_position(&self.min, "min")?;
        require_position(&self.max, "max")?;
        require(self.min.iter().zip(&self.max).all(|(low, high)| low <= high), "min", "exceeds max")
    }
}

/// One keyframe with its landmarks: the answer to `map/{map}/keyframes/{id}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyframeReply {
    /// Version of the map.
    pub map_version: u64,
    /// Identity of the map: other maps have versions of the same numbers.
    pub map_identity: MapIdentity,
    /// The keyframe.
    pub keyframe: KeyframeRecord,
    /// The landmarks that it observes.
    #[serde(default)]
    pub landmarks: Vec<KeyframeLandmark>,
}

impl Validate for KeyframeReply {
    fn validate(&self) -> Result<(), InvalidField> {
        require_valid(&self.keyframe, "keyframe")?;
        require_each(&self.landmarks, "landmarks", Validate::validate)
    }
}

/// A landmark and its observation in one keyframe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyframeLandmark {
    /// The landmark.
    pub landmark: LandmarkId,
    /// The keyframe in whose camera frame the position is expressed.
    pub anchor: KeyframeId,
    /// Position in the anchor's camera frame, metres.
    pub position_in_anchor: [f64; 3],
    /// Its pixel `[u, v]` in the requested keyframe, distorted.
    pub pixel: [f32; 2],
}

impl Validate for KeyframeLandmark {
    fn validate(&self) -> Result<(), InvalidField> {
        require_position(&self.position_in_anchor, "position_in_anchor")?;
        require(self.pixel.iter().all(|value| value.is_finite()), "pixel", "is not finite")
    }
}

/// Notice of a new map version, published on `map/{map}/changes`: tells robots which keyframes that they hold are
/// outdated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapChangeNotice {
    /// Name of the map.
    pub map: String,
    /// Identity of the map, the same before and after the change.
    pub identity: MapIdentity,
    /// Version before the change. A robot that uses another version missed a notice and cannot use `stated_change`.
    pub from_version: u64,
    /// Version after the change.
    pub version: u64,
    /// Keyframes whose pose, covariance, camera or landmarks changed.
    #[serde(default)]
    pub changed: Vec<KeyframeId>,
    /// The changed keyframes whose pose, covariance or cross-covariances changed: a robot's state is correlated with their
    /// old errors, not with the new ones.
    #[serde(default)]
    pub moved: Vec<KeyframeId>,
    /// Removed keyframes.
    #[serde(default)]
    pub removed: Vec<KeyframeId>,
    /// Size of the map's motion, if known.
    #[serde(default)]
    pub stated_change: Option<StatedChange>,
    /// How far the moved keyframes moved. Of none where the map moved as a whole by `stated_change`; without that, nothing is known
    /// of its motion.
    #[serde(default)]
    pub keyframe_motions: Vec<KeyframeMotion>,
}

impl Validate for MapChangeNotice {
    fn validate(&self) -> Result<(), InvalidField> {
        require_name(&self.map, "map")?;
        require(self.version > self.from_version, "version", "is not after from_version")?;
        require_valid(self.stated_change.as_ref(), "stated_change")?;
        self.keyframe_motions.iter().try_for_each(|motion| require_valid(Some(motion), "keyframe_motions"))
    }
}

/// How far a keyframe moved between two versions of a map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyframeMotion {
    /// The keyframe, which both versions have.
    pub keyframe: KeyframeId,
    /// Rotation vector `θ` in the map's frame, radians: `R = Exp(θ) R_before`.
    pub theta_rad: [f32; 3],
    /// Translation in the map's frame, metres: `p = p_before + t`.
    pub translation_m: [f32; 3],
}

impl KeyframeMotion {
    /// The motion of a keyframe that did not move.
    pub fn unmoved(keyframe: KeyframeId) -> Self {
        Self { keyframe, theta_rad: [0.0; 3], translation_m: [0.0; 3] }
    }

    /// # Arguments
    /// * `motion`: `[θ, t]` in the map's frame, rad and metres.
    pub fn from_vector(keyframe: KeyframeId, motion: &Vector6<f64>) -> Self {
        let [theta_rad, translation_m] =
            [0, 3].map(|begin| [0, 1, 2].map(|axis| motion[begin + axis] as f32));
        Self { keyframe, theta_rad, translation_m }
    }

    /// `[θ, t]` in the map's frame, rad and metres.
    pub fn to_vector(&self) -> Vector6<f64> {
        Vector6::from_iterator(self.theta_rad.into_iter().chain(self.translation_m).map(f64::from))
    }
}

impl Validate for KeyframeMotion {
    fn validate(&self) -> Result<(), InvalidField> {
        for (numbers, field, most) in [
            (self.theta_rad, "theta_rad", MAX_CHANGE_RAD),
            (self.translation_m, "translation_m", MAX_CHANGE_M),
        ] {
            let is_within = numbers.iter().all(|number| f64::from(number.abs()) <= most);
            require(is_within, field, &format!("has a number that is not within {most}"))?;
        }
        Ok(())
    }
}

/// Size of the motion of a map between two versions: process noise for `global_from_local`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StatedChange {
    /// Standard deviation of the rotation about each axis, radians.
    pub sigma_theta_rad: f64,
    /// Standard deviation of the translation along each axis, metres.
    pub sigma_p_m: f64,
}

impl Validate for StatedChange {
    fn validate(&self) -> Result<(), InvalidField> {
        for (sigma, field, most) in [
            (self.sigma_theta_rad, "sigma_theta_rad", MAX_CHANGE_RAD),
            (self.sigma_p_m, "sigma_p_m", MAX_CHANGE_M),
        ] {
            require_not_negative(sigma, field)?;
            require(sigma <= most, field, &format!("is more than {most}"))?;
        }
        Ok(())
    }
}
