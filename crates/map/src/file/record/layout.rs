//! The payloads of records.
//!
//! These structures are not those of [`crate::model`], so that a renamed field there never changes what is on disk.

use geometry::camera::{Camera, Distortion};
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Matrix6, Matrix6xX, Quaternion, UnitQuaternion, Vector3};
use protocol::{DescriptorKind, Descriptors, FeatureSet, KeyframeId, LandmarkId};
use serde::{Deserialize, Serialize};

use super::error::RecordError;
use crate::added::KeptImage;
use crate::model::{
    Alias, CommonError, Keyframe, KeyframeAliases, KeyframeCrossCovariance, Landmark, LandmarkExistence,
    Observation,
};

/// How far a stored quaternion may be from unit length: as in a valid map.
const UNIT_TOLERANCE: f64 = 1e-6;

/// [`Keyframe`] on disk; its id is the key.
#[derive(Serialize, Deserialize)]
pub struct KeyframeRecord {
    stamp_ns: i64,
    /// w, x, y, z
    quaternion: [f64; 4],
    translation: [f64; 3],
    /// Columns of the 6x6 covariance.
    covariance: [[f64; 6]; 6],
    camera: CameraRecord,
    features: Option<FeaturesRecord>,
}

impl KeyframeRecord {
    /// The record of a keyframe.
    pub(super) fn new(keyframe: &Keyframe) -> KeyframeRecord {
        let pose = &keyframe.global_from_keyframe.pose;
        let quaternion = pose.rotation.quaternion();
        KeyframeRecord {
            stamp_ns: keyframe.stamp_ns,
            quaternion: [quaternion.w, quaternion.i, quaternion.j, quaternion.k],
            translation: pose.translation.into(),
            covariance: keyframe.global_from_keyframe.covariance.into(),
            camera: CameraRecord::new(&keyframe.camera),
            features: keyframe.features.as_ref().map(FeaturesRecord::new),
        }
    }

    /// The keyframe that the record holds; its id is the key.
    ///
    /// # Errors
    /// A value that no keyframe can have.
    pub(super) fn into_keyframe(self, id: KeyframeId) -> Result<Keyframe, RecordError> {
        let [w, x, y, z] = self.quaternion;
        let quaternion = Quaternion::new(w, x, y, z);
        let deviation = (quaternion.norm() - 1.0).abs();
        if deviation.is_nan() || deviation > UNIT_TOLERANCE {
            return Err(RecordError::Quaternion { norm: quaternion.norm() });
        }
        // Not normalized again: what was written is read back to the last bit.
        let rotation = UnitQuaternion::new_unchecked(quaternion);
        Ok(Keyframe {
            id,
            stamp_ns: self.stamp_ns,
            global_from_keyframe: PoseWithCovariance {
                pose: Pose { rotation, translation: Vector3::from(self.translation) },
                covariance: Matrix6::from(self.covariance),
            },
            camera: self.camera.into_camera()?,
            features: self.features.map(FeaturesRecord::into_features).transpose()?,
        })
    }
}

#[derive(Serialize, Deserialize)]
struct CameraRecord {
    width: u32,
    height: u32,
    focal: [f64; 2],
    centre: [f64; 2],
    /// 0 none, 1 radial-tangential, 2 equidistant, 3 FOV, 4 rational, 5 thin prism fisheye, 6 double sphere, 7 extended unified,
    /// 8 omnidirectional.
    distortion: u8,
    /// As many as the model has, in its order.
    coefficients: Vec<f64>,
}

impl CameraRecord {
    fn new(camera: &Camera) -> CameraRecord {
        let coefficients = camera.distortion.coefficients();
        let (distortion, coefficients) = match camera.distortion {
            Distortion::None => (0, coefficients),
            Distortion::RadialTangential(_) => (1, coefficients),
            Distortion::Equidistant(_) => (2, coefficients),
            Distortion::Fov(_) => (3, coefficients),
            Distortion::Rational(all) => (4, all.to_vec()),
            Distortion::ThinPrismFisheye(_) => (5, coefficients),
            Distortion::DoubleSphere { .. } => (6, coefficients),
            Distortion::Eucm { .. } => (7, coefficients),
            Distortion::Omni { .. } => (8, coefficients),
        };
        CameraRecord {
            width: camera.width,
            height: camera.height,
            focal: camera.focal,
            centre: camera.centre,
            distortion,
            coefficients,
        }
    }

    fn into_camera(self) -> Result<Camera, RecordError> {
        let distortion = match (self.distortion, self.coefficients.as_slice()) {
            (0, []) => Distortion::None,
            (1, &[k1, k2, p1, p2]) => Distortion::RadialTangential([k1, k2, p1, p2]),
            (2, &[k1, k2, k3, k4]) => Distortion::Equidistant([k1, k2, k3, k4]),
            (3, &[omega]) => Distortion::Fov(omega),
            (4, all) if all.len() == 12 => Distortion::Rational(std::array::from_fn(|k| all[k])),
            (5, all) if all.len() == 8 => Distortion::ThinPrismFisheye(std::array::from_fn(|k| all[k])),
            (6, &[xi, alpha]) => Distortion::DoubleSphere { xi, alpha },
            (7, &[alpha, beta]) => Distortion::Eucm { alpha, beta },
            (8, &[xi, k1, k2, p1, p2]) => Distortion::Omni { xi, distortion: [k1, k2, p1, p2] },
            (model @ 0..=8, others) => {
                return Err(RecordError::DistortionCoefficients { model, count: others.len() });
            }
            (model, _) => return Err(RecordError::DistortionModel { model }),
        };
        Ok(Camera {
            width: self.width,
            height: self.height,
            focal: self.focal,
            centre: self.centre,
            distortion,
        })
    }
}

#[derive(Serialize, Deserialize)]
struct FeaturesRecord {
    pixels: Vec<[f32; 2]>,
    kind: u8,
    width: u16,
    #[serde(with = "serde_bytes")]
    descriptors: Vec<u8>,
}

impl FeaturesRecord {
    fn new(features: &FeatureSet) -> FeaturesRecord {
        FeaturesRecord {
            pixels: features.pixels.clone(),
            kind: kind_to_byte(features.descriptors.kind),
            width: features.descriptors.width,
            descriptors: features.descriptors.bytes.clone(),
        }
    }

    fn into_features(self) -> Result<FeatureSet, RecordError> {
        let descriptors =
            Descriptors { kind: kind_from_byte(self.kind)?, width: self.width, bytes: self.descriptors };
        Ok(FeatureSet { pixels: self.pixels, descriptors, extractor: String::new() })
    }
}

/// [`Landmark`] on disk; its id is the key.
#[derive(Serialize, Deserialize)]
pub struct LandmarkRecord {
    anchor: u64,
    position_in_anchor: [f64; 3],
    observations: Vec<ObservationRecord>,
}

#[derive(Serialize, Deserialize)]
struct ObservationRecord {
    keyframe: u64,
    pixel: [f32; 2],
    #[serde(with = "serde_bytes")]
    descriptor: Vec<u8>,
}

impl LandmarkRecord {
    /// The record of a landmark.
    pub(super) fn new(landmark: &Landmark) -> LandmarkRecord {
        let observations = landmark.observations.iter().map(|observation| ObservationRecord {
            keyframe: observation.keyframe,
            pixel: observation.pixel,
            descriptor: observation.descriptor.clone(),
        });
        LandmarkRecord {
            anchor: landmark.anchor,
            position_in_anchor: landmark.position_in_anchor.into(),
            observations: observations.collect(),
        }
    }

    /// The landmark that the record holds; its id is the key.
    pub(super) fn into_landmark(self, id: LandmarkId) -> Landmark {
        let observations = self.observations.into_iter().map(|observation| Observation {
            keyframe: observation.keyframe,
            pixel: observation.pixel,
            descriptor: observation.descriptor,
        });
        Landmark {
            id,
            anchor: self.anchor,
            position_in_anchor: Vector3::from(self.position_in_anchor),
            observations: observations.collect(),
        }
    }
}

/// What [`LandmarkRecord`] holds, without a copy of its descriptors.
#[derive(Deserialize)]
pub struct LandmarkObservers<'a> {
    _anchor: u64,
    _position_in_anchor: [f64; 3],
    #[serde(borrow)]
    observations: Vec<ObserverRecord<'a>>,
}

#[derive(Deserialize)]
struct ObserverRecord<'a> {
    keyframe: u64,
    _pixel: [f32; 2],
    _descriptor: &'a [u8],
}

impl LandmarkObservers<'_> {
    /// The keyframes that observe the landmark, in the order of its observations.
    pub(crate) fn keyframes(&self) -> impl Iterator<Item = KeyframeId> {
        self.observations.iter().map(|observation| observation.keyframe)
    }
}

/// [`KeyframeCrossCovariance`] on disk, by columns; the pair is the key.
#[derive(Serialize, Deserialize)]
pub struct CrossCovarianceRecord([[f64; 6]; 6]);

impl CrossCovarianceRecord {
    /// The record of a cross-covariance block.
    pub(super) fn new(cross: &KeyframeCrossCovariance) -> CrossCovarianceRecord {
        CrossCovarianceRecord(cross.block.into())
    }

    /// The block that the record holds; the keyframes are the key.
    pub(super) fn into_cross_covariance(self, a: KeyframeId, b: KeyframeId) -> KeyframeCrossCovariance {
        KeyframeCrossCovariance { a, b, block: Matrix6::from(self.0) }
    }
}

/// [`CommonError`] on disk: the columns of its factor; the keyframe is the key.
#[derive(Serialize, Deserialize)]
pub struct CommonErrorRecord(Vec<[f64; 6]>);

impl CommonErrorRecord {
    /// The record of a common error.
    pub(super) fn new(common: &CommonError) -> CommonErrorRecord {
        CommonErrorRecord(common.columns())
    }

    /// The common error that the record holds; the keyframe is the key.
    pub(super) fn into_common_error(self, keyframe: KeyframeId) -> CommonError {
        CommonError { keyframe, factor: Matrix6xX::from_column_slice(self.0.as_flattened()) }
    }
}

/// [`KeyframeAliases`] on disk: keyframes and log-odds; the keyframe is the key.
#[derive(Serialize, Deserialize)]
pub struct AliasesRecord(Vec<(u64, f64)>);

impl AliasesRecord {
    /// The record of a keyframe's aliases.
    pub(super) fn new(aliases: &KeyframeAliases) -> AliasesRecord {
        AliasesRecord(aliases.places.iter().map(|place| (place.keyframe, place.log_odds)).collect())
    }

    /// The aliases that the record holds; the keyframe is the key.
    pub(super) fn into_aliases(self, keyframe: KeyframeId) -> KeyframeAliases {
        let places = self.0.into_iter().map(|(keyframe, log_odds)| Alias { keyframe, log_odds }).collect();
        KeyframeAliases { keyframe, places }
    }
}

/// [`KeptImage`] on disk; the keyframe is the key.
#[derive(Serialize, Deserialize)]
pub struct ImageRecord(#[serde(with = "serde_bytes")] Vec<u8>);

impl ImageRecord {
    /// The record of an image.
    pub(super) fn new(image: &KeptImage) -> ImageRecord {
        ImageRecord(image.jpeg.clone())
    }

    /// The image that the record holds; the keyframe is the key.
    pub(super) fn into_image(self, keyframe: KeyframeId) -> KeptImage {
        KeptImage { keyframe, jpeg: self.0 }
    }
}

/// [`LandmarkExistence`] on disk; the landmark is the key.
#[derive(Serialize, Deserialize)]
pub struct ExistenceRecord {
    log_odds: f64,
    stamp_ns: i64,
    seen_ns: i64,
}

impl ExistenceRecord {
    /// The record of a landmark's existence.
    pub(super) fn new(existence: &LandmarkExistence) -> ExistenceRecord {
        let LandmarkExistence { log_odds, stamp_ns, seen_ns, .. } = *existence;
        ExistenceRecord { log_odds, stamp_ns, seen_ns }
    }

    /// The existence that the record holds; the landmark is the key.
    pub(super) fn into_existence(self, landmark: LandmarkId) -> LandmarkExistence {
        let ExistenceRecord { log_odds, stamp_ns, seen_ns } = self;
        LandmarkExistence { landmark, log_odds, stamp_ns, seen_ns }
    }
}

/// The number of a kind of descriptors.
pub(crate) fn kind_to_byte(kind: DescriptorKind) -> u8 {
    match kind {
        DescriptorKind::Binary => 0,
        DescriptorKind::Float => 1,
        DescriptorKind::Int8 => 2,
    }
}

fn kind_from_byte(byte: u8) -> Result<DescriptorKind, RecordError> {
    match byte {
        0 => Ok(DescriptorKind::Binary),
        1 => Ok(DescriptorKind::Float),
        2 => Ok(DescriptorKind::Int8),
        kind => Err(RecordError::DescriptorKind { kind }),
    }
}
