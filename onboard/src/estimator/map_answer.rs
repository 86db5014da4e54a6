//! What the map answered to one image, in the estimator's own terms.

use geometry::{Camera, PoseWithCovariance};
use nalgebra::{Matrix6, Vector2, Vector3};
use protocol::KeyframeId;

/// A keyframe of the map that shares landmarks with the image.
#[derive(Clone, Debug)]
pub struct MapKeyframe {
    /// Its name in the map.
    pub id: KeyframeId,
    /// Camera pose in G with covariance.
    pub global_from_keyframe: PoseWithCovariance,
    /// Its camera.
    pub camera: Camera,
    /// Its covariance with other keyframes, rows are its own error. Absent means independent.
    pub cross_covariances: Vec<(KeyframeId, Matrix6<f64>)>,
}

/// A landmark of the map that the image saw.
#[derive(Clone, Debug)]
pub struct MatchedLandmark {
    /// Where the current image saw it, pixels.
    pub pixel: Vector2<f64>,
    /// The keyframe in whose camera frame its position is given.
    pub anchor: KeyframeId,
    /// Position in the anchor's camera frame, metres. A point to linearize at, not a measurement.
    pub position_in_anchor: Vector3<f64>,
    /// Where keyframes saw it, pixels; the anchor among them.
    pub observations: Vec<(KeyframeId, Vector2<f64>)>,
}

/// All that the map had to say about one image.
#[derive(Clone, Debug)]
pub struct MapAnswer {
    /// Version of the map that answered.
    pub map_version: u64,
    /// Best first.
    pub keyframes: Vec<MapKeyframe>,
    /// What matched.
    pub landmarks: Vec<MatchedLandmark>,
    /// Unit vector along gravity in G, where the map states it.
    pub gravity_in_global: Option<Vector3<f64>>,
    /// Noise of the map's pixels as the map states it, px.
    pub sigma_map_px: f64,
}

impl MapAnswer {
    /// A keyframe of this answer.
    pub fn keyframe(&self, id: KeyframeId) -> Option<&MapKeyframe> {
        self.keyframes.iter().find(|keyframe| keyframe.id == id)
    }
}
