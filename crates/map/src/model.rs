//! The elements of a map: keyframes, landmarks in their anchors, observations, cross-covariances, common errors.
//!
//! # Frames
//! All geometry is relative to the keyframe poses `global_from_keyframe` (G from the keyframe's camera frame, metres). A
//! landmark is a point in the camera frame of its *anchor* keyframe, so that it moves with the keyframe when
//! the map is re-optimized. Pose errors are `[δθ, δp]` in the parent frame G (radians, metres).

use geometry::camera::Camera;
use geometry::uncertain_pose::PoseWithCovariance;
use geometry::{Viewpoint, is_coordinate};
use nalgebra::{Matrix6, Matrix6xX, Vector2, Vector3};
use protocol::{DescriptorKind, FeatureSet, KeyframeId, LandmarkId, MapIdentity};
use serde::{Deserialize, Serialize};

use crate::sessions::Session;

/// Standard deviation of a map pixel (px) where the builder of a map states no other: features are located to about a
/// pixel.
pub const DEFAULT_SIGMA_PX: f64 = 1.0;

/// Largest id of a keyframe or a landmark: the ids of two maps can be added, which merging does.
pub const MAX_ID: u64 = u64::MAX / 2;

/// Smallest depth (m) at which a point counts as in front of a camera: less is a division by nearly zero.
const MIN_DEPTH: f64 = 1e-3;

/// What applies to the map as a whole; manifests have it under these names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapMetadata {
    /// A name for display; the name under which a server serves the map is given to the server.
    pub name: String,
    /// The program and input that the map was built with, for display.
    pub created_by: String,
    /// Grows by one with every change. A store sets it; the value given to a store is not used.
    pub version: u64,
    /// The same for all versions of a map, and different for different maps. A store sets it to the
    /// [digest](crate::MapContents::digest) of the first version; the value given to a store is not used. `None`: the map
    /// was never stored.
    pub identity: Option<MapIdentity>,
    /// Unit vector of the direction in which gravity points (downwards), in G. `None`: not known.
    pub gravity_in_global: Option<Vector3<f64>>,
    /// Whether G is defined by the map itself, which was built without reference poses and priors: a truth is to be aligned
    /// with it.
    pub own_frame: bool,
    /// The kind of all descriptors of the map.
    pub descriptor_kind: DescriptorKind,
    /// Bytes in each descriptor.
    pub descriptor_width: u16,
    /// Standard deviation of the map's pixels (px), one value for both axes. It covers those of all sessions, see
    /// [`MapMetadata::covering_sigma_px`].
    pub sigma_px: f64,
    /// Name and version of the extractor that computed the descriptors, like `sift-1`; empty where unknown.
    pub extractor: String,
    /// The ledger: which sessions the map was made of, by the ids of their keyframes, which ascend from session to session.
    /// Empty where it is not known.
    pub sessions: Vec<Session>,
}

impl MapMetadata {
    /// Info of a new map: version 0, no identity, gravity, extractor and sessions unknown, not its own frame, [`DEFAULT_SIGMA_PX`].
    ///
    /// # Arguments
    /// * `descriptor_width`: bytes in one descriptor.
    pub fn new(
        name: impl Into<String>,
        created_by: impl Into<String>,
        descriptor_kind: DescriptorKind,
        descriptor_width: u16,
    ) -> MapMetadata {
        MapMetadata {
            name: name.into(),
            created_by: created_by.into(),
            version: 0,
            identity: None,
            gravity_in_global: None,
            own_frame: false,
            descriptor_kind,
            descriptor_width,
            sigma_px: DEFAULT_SIGMA_PX,
            extractor: String::new(),
            sessions: Vec::new(),
        }
    }
}

/// One camera pose of the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Keyframe {
    /// Identity within the map.
    pub id: KeyframeId,
    /// When the image was taken (ns).
    pub stamp_ns: i64,
    /// Pose of the camera in G with its 6x6 covariance, `[δθ, δp]` in G (rad, m).
    pub global_from_keyframe: PoseWithCovariance,
    /// The camera that took it.
    pub camera: Camera,
    /// All features seen in the image, with or without a landmark. `None` where the builder kept none:
    /// recognition needs only the observations of landmarks.
    pub features: Option<FeatureSet>,
}

impl Keyframe {
    /// Where its camera is and where it looks, in G.
    pub fn viewpoint(&self) -> Viewpoint {
        Viewpoint::of(&self.global_from_keyframe.pose)
    }

    /// A point in the keyframe's camera frame (m): on the ray of the pixel where the keyframe observes it, at the depth that the poses
    /// give.
    ///
    /// The poses of a map are uncertain: transformed alone, the point would miss that pixel by the errors of two of them.
    ///
    /// # Arguments
    /// * `in_global`: in G (m).
    ///
    /// # Returns
    /// `None` where the point is not in front of the camera, or the pixel has no ray.
    pub fn point_on_ray(&self, pixel: [f32; 2], in_global: &Vector3<f64>) -> Option<Vector3<f64>> {
        let depth = self.global_from_keyframe.pose.inverse_transform(in_global).z;
        let ray = self.camera.unproject(&Vector2::from(pixel.map(f64::from))).ok()?;
        let point = ray.push(1.0) * depth;
        (depth > MIN_DEPTH && point.iter().copied().all(is_coordinate)).then_some(point)
    }
}

/// Standard deviations of the frame of a map that defines its own: of positions along an axis (m), and of the rotation about gravity
/// (rad). They are those of a definition, so small as can be without making its covariance singular.
pub const GAUGE_SIGMA_P: f64 = 1e-3;
/// See [`GAUGE_SIGMA_P`].
pub const GAUGE_SIGMA_YAW: f64 = 1e-4;

/// One point of the map.
#[derive(Clone, Debug, PartialEq)]
pub struct Landmark {
    /// Identity within the map.
    pub id: LandmarkId,
    /// The keyframe in whose camera frame the position is given. It is one of those that observe the landmark.
    pub anchor: KeyframeId,
    /// Position in the camera frame of the anchor (m).
    pub position_in_anchor: Vector3<f64>,
    /// Its observations, at most one a keyframe, with one by the anchor.
    pub observations: Vec<Observation>,
}

impl Landmark {
    /// The same landmark in a map whose keyframes and landmarks have other ids: higher ones by so much.
    pub fn with_higher_ids(mut self, of_keyframes: KeyframeId, of_landmarks: LandmarkId) -> Landmark {
        self.id += of_landmarks;
        self.anchor += of_keyframes;
        self.observations.iter_mut().for_each(|observation| observation.keyframe += of_keyframes);
        self
    }
}

/// A landmark as one keyframe saw it.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// The observing keyframe.
    pub keyframe: KeyframeId,
    /// Distorted pixel; (0, 0) is the centre of the top-left pixel.
    pub pixel: [f32; 2],
    /// Descriptor of [`MapMetadata::descriptor_width`] bytes.
    pub descriptor: Vec<u8>,
}

/// Whether a landmark is still there, by the sessions that passed it.
///
/// Landmarks without one were never expected by a session since they entered the map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LandmarkExistence {
    /// Which landmark.
    pub landmark: LandmarkId,
    /// Natural logarithm of the odds that it is there, at `stamp_ns`.
    pub log_odds: f64,
    /// Time of the last session that saw or missed it and was independent of the one before (ns).
    pub stamp_ns: i64,
    /// Time at which it was seen last (ns).
    pub seen_ns: i64,
}

/// Covariance between the pose errors of two keyframes, beyond what both have in [`CommonError`]s; zero for pairs that a map
/// does not list.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyframeCrossCovariance {
    /// The keyframe of the rows. In a stored map `a < b`, see [`KeyframeCrossCovariance::ordered`].
    pub a: KeyframeId,
    /// The keyframe of the columns.
    pub b: KeyframeId,
    /// `E[e_a e_bᵀ]` with `e = [δθ, δp]` in G (rad, m).
    pub block: Matrix6<f64>,
}

impl KeyframeCrossCovariance {
    /// The same with `a <= b`: the block is transposed where the two are exchanged.
    pub fn ordered(&self) -> KeyframeCrossCovariance {
        if self.a <= self.b {
            self.clone()
        } else {
            KeyframeCrossCovariance { a: self.b, b: self.a, block: self.block.transpose() }
        }
    }
}

/// A keyframe's part of the error common to all: `e = U x + rest`, where `x` holds independent standard normal numbers, the
/// same for the whole map, and `rest` is correlated as the map's [`KeyframeCrossCovariance`]s say.
///
/// So the covariance of two keyframes is `U_a U_bᵀ`, plus the block of the pair where the map lists one. That of a keyframe
/// with itself stays the one that the keyframe states, which contains `U Uᵀ`. Maps state it where they have too many pairs to
/// list all.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CommonError {
    /// Whose error it is.
    pub keyframe: KeyframeId,
    /// `U`, a row for each number of `[δθ, δp]` in G (rad, m), a column for each number of `x`: of all keyframes equally many.
    pub factor: Matrix6xX<f64>,
}

impl CommonError {
    /// The columns of `U`, as they are stored and sent.
    pub fn columns(&self) -> Vec<[f64; 6]> {
        self.factor.column_iter().map(|column| column.into_owned().into()).collect()
    }

    /// What it adds to the covariance of its keyframe with another, `U_a U_bᵀ`; rows are its own.
    pub fn covariance_with(&self, other: &CommonError) -> Matrix6<f64> {
        &self.factor * other.factor.transpose()
    }
}

/// The other places of a map that the image of a keyframe could be taken for: what looks alike, its perceptual aliasing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyframeAliases {
    /// The keyframe whose image was compared with the rest of the map.
    pub keyframe: KeyframeId,
    /// The places that explain the image as well, the one that explains most first. Empty where none does.
    pub places: Vec<Alias>,
}

impl KeyframeAliases {
    /// The log-odds of the place that explains most.
    pub fn log_odds(&self) -> Option<f64> {
        self.places.iter().map(|place| place.log_odds).reduce(f64::max)
    }
}

/// A place that the image of a keyframe could be taken for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Alias {
    /// The keyframe next to it.
    pub keyframe: KeyframeId,
    /// Natural logarithm of its odds over an unknown place, by the image alone.
    pub log_odds: f64,
}
