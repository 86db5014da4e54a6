//! Bytes on disk: the envelope around every record, and the plain structures inside.
//!
//! ```text
//! record version u8 | crc32 u32 LE | payload (bincode 1)
//! ```
//! The checksum covers the tree's name, the key, the version and the payload, so a record under the wrong key is
//! as damaged as one with flipped bits. The structures here are not those of [`crate::model`], so that a renamed
//! field there never changes what is on disk.

use bincode::Options;
use geometry::camera::{Camera, Distortion};
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Matrix6, Quaternion, UnitQuaternion, Vector3};
use protocol::{DescriptorKind, Descriptors, FeatureSet, KeyframeId};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::model::{CrossCovariance, Keyframe, Landmark, MapInfo, Observation};

/// Version of the structures in this module. Version 1 differs in the info of the map only, see [`InfoRecordV1`].
const RECORD_VERSION: u8 = 2;
/// The oldest version that is read.
const OLDEST_RECORD_VERSION: u8 = 1;
/// Bytes before the payload.
const HEADER_BYTES: usize = 5;
/// How far a stored quaternion may be from unit length.
const UNIT_TOLERANCE: f64 = 1e-6;

/// Puts a record into its envelope.
pub(super) fn seal<T: Serialize>(tree: &str, key: &[u8], record: &T) -> Result<Vec<u8>, String> {
    let mut bytes = vec![0; HEADER_BYTES];
    options().serialize_into(&mut bytes, record).map_err(|error| error.to_string())?;
    let checksum = checksum(tree, key, RECORD_VERSION, &bytes[HEADER_BYTES..]);
    bytes[0] = RECORD_VERSION;
    bytes[1..HEADER_BYTES].copy_from_slice(&checksum.to_le_bytes());
    Ok(bytes)
}

/// Takes a record out of its envelope; the error says what is wrong with it.
pub(super) fn unseal<T: DeserializeOwned>(tree: &str, key: &[u8], bytes: &[u8]) -> Result<T, String> {
    let (_, payload) = open(tree, key, bytes)?;
    decode(payload)
}

/// Takes the info of a map of any readable version out of its envelope.
pub(super) fn unseal_info(tree: &str, key: &[u8], bytes: &[u8]) -> Result<InfoRecord, String> {
    match open(tree, key, bytes)? {
        (1, payload) => decode::<InfoRecordV1>(payload).map(InfoRecord::from),
        (_, payload) => decode(payload),
    }
}

/// The version and the payload of an intact record.
fn open<'a>(tree: &str, key: &[u8], bytes: &'a [u8]) -> Result<(u8, &'a [u8]), String> {
    let Some((&[version, c0, c1, c2, c3], payload)) = bytes.split_first_chunk::<HEADER_BYTES>() else {
        return Err(format!("it has only {} bytes", bytes.len()));
    };
    if checksum(tree, key, version, payload) != u32::from_le_bytes([c0, c1, c2, c3]) {
        return Err("its checksum does not match".to_owned());
    }
    if !(OLDEST_RECORD_VERSION..=RECORD_VERSION).contains(&version) {
        return Err(format!(
            "it has record version {version}, this program reads {OLDEST_RECORD_VERSION} to {RECORD_VERSION}"
        ));
    }
    Ok((version, payload))
}

fn decode<T: DeserializeOwned>(payload: &[u8]) -> Result<T, String> {
    // No payload can claim more than its own length: a vector costs at least a byte an element.
    options()
        .with_limit(payload.len() as u64)
        .deserialize(payload)
        .map_err(|error| format!("it cannot be decoded: {error}"))
}

fn options() -> impl Options {
    bincode::DefaultOptions::new().with_fixint_encoding()
}

fn checksum(tree: &str, key: &[u8], version: u8, payload: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(tree.as_bytes());
    hasher.update(key);
    hasher.update(&[version]);
    hasher.update(payload);
    hasher.finalize()
}

/// [`MapInfo`] on disk.
#[derive(Serialize, Deserialize)]
pub(super) struct InfoRecord {
    name: String,
    created_by: String,
    version: u64,
    gravity_in_global: Option<[f64; 3]>,
    descriptor_kind: u8,
    descriptor_width: u16,
    sigma_px: f64,
    extractor: String,
}

/// [`InfoRecord`] of record version 1, when maps did not say their extractor.
#[derive(Serialize, Deserialize)]
pub(super) struct InfoRecordV1 {
    name: String,
    created_by: String,
    version: u64,
    gravity_in_global: Option<[f64; 3]>,
    descriptor_kind: u8,
    descriptor_width: u16,
    sigma_px: f64,
}

impl From<InfoRecordV1> for InfoRecord {
    fn from(old: InfoRecordV1) -> InfoRecord {
        InfoRecord {
            name: old.name,
            created_by: old.created_by,
            version: old.version,
            gravity_in_global: old.gravity_in_global,
            descriptor_kind: old.descriptor_kind,
            descriptor_width: old.descriptor_width,
            sigma_px: old.sigma_px,
            extractor: String::new(),
        }
    }
}

impl InfoRecord {
    pub(super) fn new(info: &MapInfo, version: u64) -> InfoRecord {
        InfoRecord {
            name: info.name.clone(),
            created_by: info.created_by.clone(),
            version,
            gravity_in_global: info.gravity_in_global.map(Into::into),
            descriptor_kind: kind_to_byte(info.descriptor_kind),
            descriptor_width: info.descriptor_width,
            sigma_px: info.sigma_px,
            extractor: info.extractor.clone(),
        }
    }

    pub(super) fn into_info(self) -> Result<MapInfo, String> {
        Ok(MapInfo {
            name: self.name,
            created_by: self.created_by,
            version: self.version,
            gravity_in_global: self.gravity_in_global.map(Vector3::from),
            descriptor_kind: kind_from_byte(self.descriptor_kind)?,
            descriptor_width: self.descriptor_width,
            sigma_px: self.sigma_px,
            extractor: self.extractor,
        })
    }
}

/// [`Keyframe`] on disk; its id is the key.
#[derive(Serialize, Deserialize)]
pub(super) struct KeyframeRecord {
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

    pub(super) fn into_keyframe(self, id: KeyframeId) -> Result<Keyframe, String> {
        let [w, x, y, z] = self.quaternion;
        let quaternion = Quaternion::new(w, x, y, z);
        let deviation = (quaternion.norm() - 1.0).abs();
        if deviation.is_nan() || deviation > UNIT_TOLERANCE {
            return Err(format!("its quaternion has length {}", quaternion.norm()));
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
    /// 0 none, 1 radial-tangential, 2 equidistant, 3 FOV (its omega is the first coefficient).
    distortion: u8,
    coefficients: [f64; 4],
}

impl CameraRecord {
    fn new(camera: &Camera) -> CameraRecord {
        let (distortion, coefficients) = match camera.distortion {
            Distortion::None => (0, [0.0; 4]),
            Distortion::RadialTangential(coefficients) => (1, coefficients),
            Distortion::Equidistant(coefficients) => (2, coefficients),
            Distortion::Fov(omega) => (3, [omega, 0.0, 0.0, 0.0]),
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

    fn into_camera(self) -> Result<Camera, String> {
        let distortion = match self.distortion {
            0 => Distortion::None,
            1 => Distortion::RadialTangential(self.coefficients),
            2 => Distortion::Equidistant(self.coefficients),
            3 => Distortion::Fov(self.coefficients[0]),
            other => return Err(format!("its camera has an unknown distortion model {other}")),
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

    fn into_features(self) -> Result<FeatureSet, String> {
        let descriptors =
            Descriptors { kind: kind_from_byte(self.kind)?, width: self.width, bytes: self.descriptors };
        Ok(FeatureSet { pixels: self.pixels, descriptors, extractor: String::new() })
    }
}

/// [`Landmark`] on disk; its id is the key.
#[derive(Serialize, Deserialize)]
pub(super) struct LandmarkRecord {
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

    pub(super) fn into_landmark(self, id: u64) -> Landmark {
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

/// [`CrossCovariance`] on disk, by columns; the pair is the key.
#[derive(Serialize, Deserialize)]
pub(super) struct CrossRecord([[f64; 6]; 6]);

impl CrossRecord {
    pub(super) fn new(cross: &CrossCovariance) -> CrossRecord {
        CrossRecord(cross.block.into())
    }

    pub(super) fn into_cross(self, a: KeyframeId, b: KeyframeId) -> CrossCovariance {
        CrossCovariance { a, b, block: Matrix6::from(self.0) }
    }
}

fn kind_to_byte(kind: DescriptorKind) -> u8 {
    match kind {
        DescriptorKind::Binary => 0,
        DescriptorKind::Float => 1,
        DescriptorKind::Int8 => 2,
    }
}

fn kind_from_byte(byte: u8) -> Result<DescriptorKind, String> {
    match byte {
        0 => Ok(DescriptorKind::Binary),
        1 => Ok(DescriptorKind::Float),
        2 => Ok(DescriptorKind::Int8),
        other => Err(format!("unknown descriptor kind {other}")),
    }
}
