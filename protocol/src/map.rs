//! `map/{map}/info`, `map/{map}/keyframes/{id}` and `map/{map}/changes`: reading a map remotely, and news of it.

use crate::codec::Message;
use crate::features::{DescriptorFormat, validate_extractor};
use crate::matching::KeyframeRecord;
use crate::validate::{InvalidField, Validate, require, require_each, require_finite, require_unit};
use crate::{KeyframeId, LandmarkId, keys};
use serde::{Deserialize, Serialize};

/// What a map is: the answer to `map/{map}/info`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapInfo {
    /// Its name, as in its keys.
    pub name: String,
    /// Grows with every change.
    pub version: u64,
    /// Schema of its database, not of this message.
    pub database_schema: u16,
    /// Number of keyframes.
    pub keyframes: u64,
    /// Number of landmarks.
    pub landmarks: u64,
    /// Number of observations of landmarks by keyframes.
    pub observations: u64,
    /// Number of cross-covariance blocks between keyframes.
    pub cross_covariances: u64,
    /// Unit vector along which things fall, in the map's frame, if the map knows.
    #[serde(default)]
    pub gravity_in_global: Option<[f64; 3]>,
    /// Where its keyframes are; none for an empty map.
    #[serde(default)]
    pub extent: Option<Extent>,
    /// What a query's descriptors must be; none for an empty map.
    #[serde(default)]
    pub descriptors: Option<DescriptorFormat>,
    /// Name and version of the extractor that a query's features must come from; empty where the map does not say.
    #[serde(default)]
    pub extractor: String,
    /// Standard deviation of the map's pixels, pixels.
    pub sigma_px: f64,
}

impl Validate for MapInfo {
    fn validate(&self) -> Result<(), InvalidField> {
        keys::validate_name(&self.name).map_err(|error| InvalidField::new("name", error.to_string()))?;
        if let Some(gravity) = &self.gravity_in_global {
            require_unit(gravity, "gravity_in_global")?;
        }
        if let Some(extent) = &self.extent {
            extent.validate().map_err(|violation| violation.within("extent"))?;
        }
        if let Some(format) = &self.descriptors {
            format.validate().map_err(|violation| violation.within("descriptors"))?;
        }
        validate_extractor(&self.extractor)?;
        let positive = self.sigma_px.is_finite() && self.sigma_px > 0.0;
        require(positive, "sigma_px", "is not a finite, positive number")
    }
}

impl Message for MapInfo {
    const TAG: u16 = 5;
    const NAME: &'static str = "map_info";
}

/// The smallest box, along the axes of the map's frame, that holds all keyframes; metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Extent {
    /// Smallest coordinates.
    pub min: [f64; 3],
    /// Largest coordinates.
    pub max: [f64; 3],
}

impl Validate for Extent {
    fn validate(&self) -> Result<(), InvalidField> {
        require_finite(&self.min, "min")?;
        require_finite(&self.max, "max")?;
        require(self.min.iter().zip(&self.max).all(|(low, high)| low <= high), "min", "exceeds max")
    }
}

/// One keyframe with what it sees: the answer to `map/{map}/keyframes/{id}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyframeReply {
    /// Version of the map that this is from.
    pub map_version: u64,
    /// The keyframe.
    pub keyframe: KeyframeRecord,
    /// The landmarks that it observed.
    #[serde(default)]
    pub landmarks: Vec<KeyframeLandmark>,
}

impl Validate for KeyframeReply {
    fn validate(&self) -> Result<(), InvalidField> {
        self.keyframe.validate().map_err(|violation| violation.within("keyframe"))?;
        require_each(&self.landmarks, "landmarks", Validate::validate)
    }
}

impl Message for KeyframeReply {
    const TAG: u16 = 6;
    const NAME: &'static str = "keyframe_reply";
}

/// A landmark as one keyframe observed it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyframeLandmark {
    /// The landmark.
    pub landmark: LandmarkId,
    /// The keyframe in whose camera frame its position is given.
    pub anchor: KeyframeId,
    /// Position in the anchor's camera frame, metres.
    pub position_in_anchor: [f64; 3],
    /// Where the asked keyframe saw it, `[u, v]`, distorted.
    pub pixel: [f32; 2],
}

impl Validate for KeyframeLandmark {
    fn validate(&self) -> Result<(), InvalidField> {
        require_finite(&self.position_in_anchor, "position_in_anchor")?;
        require(self.pixel.iter().all(|value| value.is_finite()), "pixel", "is not finite")
    }
}

/// News of a map, published on `map/{map}/changes`: what a robot holds of it must be fetched again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapChange {
    /// Name of the map.
    pub map: String,
    /// Version until now. Whoever holds another one missed a message and cannot use what is stated here.
    pub from_version: u64,
    /// Version from now on.
    pub version: u64,
    /// Keyframes whose pose, covariance, camera or landmarks are no longer what they were.
    #[serde(default)]
    pub changed: Vec<KeyframeId>,
    /// Of the changed ones, those whose pose, covariance or cross-covariances are others: their errors are no longer those
    /// that a robot's state depends on.
    #[serde(default)]
    pub moved: Vec<KeyframeId>,
    /// Keyframes that are gone.
    #[serde(default)]
    pub removed: Vec<KeyframeId>,
    /// How far the map moved under the robots, where that is known.
    #[serde(default)]
    pub stated_change: Option<StatedChange>,
}

impl Validate for MapChange {
    fn validate(&self) -> Result<(), InvalidField> {
        keys::validate_name(&self.map).map_err(|error| InvalidField::new("map", error.to_string()))?;
        let check =
            |change: &StatedChange| change.validate().map_err(|violation| violation.within("stated_change"));
        self.stated_change.as_ref().map_or(Ok(()), check)
    }
}

impl Message for MapChange {
    const TAG: u16 = 7;
    const NAME: &'static str = "map_change";
}

/// Size of a change of the map: process noise for `global_from_local`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StatedChange {
    /// Standard deviation of the rotation, radians an axis.
    pub sigma_theta_rad: f64,
    /// Standard deviation of the translation, metres an axis.
    pub sigma_p_m: f64,
}

impl Validate for StatedChange {
    fn validate(&self) -> Result<(), InvalidField> {
        for (value, field) in [(self.sigma_theta_rad, "sigma_theta_rad"), (self.sigma_p_m, "sigma_p_m")] {
            require(value.is_finite() && value >= 0.0, field, "is not a finite, non-negative number")?;
        }
        Ok(())
    }
}
