//! Serialized forms of poses, matrices and cameras; the same fields in both formats.
//!
//! ```json
//! {"rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 0], "covariance": [[..6 numbers..], ..6 rows..]}
//! {"width": 752, "height": 480, "focal": [458.6, 457.3], "centre": [367.2, 248.4],
//!  "distortion": {"radial_tangential": [-0.283, 0.074, 0.0002, 0.00002]}}
//! ```
//! They are separate types, so that a renamed field in another crate does not change the wire format.
//!
//! nalgebra's own form (quaternions as x, y, z, w; matrices as one flat column-major list) invites mistakes in
//! scripts, so the order of the quaternion is in its name and a matrix is a list of its rows.

use geometry::camera::{Camera, Distortion};
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::{Matrix6, Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Deviation of a norm from 1 below which a quaternion is used unchanged.
///
/// Quaternions computed in f64 round-trip bit by bit; those written with few decimals are normalized.
const EXACT_NORM_TOLERANCE: f64 = 1e-12;

/// `#[serde(with = "wire::PoseForm")]`
#[derive(Serialize, Deserialize)]
#[serde(remote = "PoseWithCovariance")]
pub(crate) struct PoseForm {
    #[serde(getter = "rotation_wxyz")]
    rotation_wxyz: [f64; 4],
    #[serde(getter = "translation")]
    translation: [f64; 3],
    #[serde(getter = "covariance_rows")]
    covariance: [[f64; 6]; 6],
}

fn rotation_wxyz(uncertain: &PoseWithCovariance) -> [f64; 4] {
    let rotation = uncertain.pose.rotation;
    [rotation.w, rotation.i, rotation.j, rotation.k]
}

fn translation(uncertain: &PoseWithCovariance) -> [f64; 3] {
    uncertain.pose.translation.into()
}

fn covariance_rows(uncertain: &PoseWithCovariance) -> [[f64; 6]; 6] {
    rows_of(&uncertain.covariance)
}

fn rows_of(matrix: &Matrix6<f64>) -> [[f64; 6]; 6] {
    matrix.transpose().into()
}

fn from_rows(rows: &[[f64; 6]; 6]) -> Matrix6<f64> {
    Matrix6::from_fn(|row, column| rows[row][column])
}

/// Normalizes a nearly unit quaternion; any other is left for validation to refuse.
fn rotation_from_wxyz([w, x, y, z]: [f64; 4]) -> UnitQuaternion<f64> {
    let quaternion = Quaternion::new(w, x, y, z);
    let deviation = (quaternion.norm() - 1.0).abs();
    if deviation > EXACT_NORM_TOLERANCE && deviation <= crate::validate::UNIT_TOLERANCE {
        UnitQuaternion::new_normalize(quaternion)
    } else {
        UnitQuaternion::new_unchecked(quaternion)
    }
}

impl From<PoseForm> for PoseWithCovariance {
    fn from(form: PoseForm) -> Self {
        PoseWithCovariance {
            pose: Pose {
                rotation: rotation_from_wxyz(form.rotation_wxyz),
                translation: Vector3::from(form.translation),
            },
            covariance: from_rows(&form.covariance),
        }
    }
}

/// `#[serde(with = "wire::matrix6")]`: six rows of six.
pub(crate) mod matrix6 {
    use super::{Matrix6, from_rows, rows_of};
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub(crate) fn serialize<S: Serializer>(value: &Matrix6<f64>, serializer: S) -> Result<S::Ok, S::Error> {
        rows_of(value).serialize(serializer)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Matrix6<f64>, D::Error> {
        <[[f64; 6]; 6]>::deserialize(deserializer).map(|rows| from_rows(&rows))
    }
}

/// `#[serde(with = "wire::CameraForm")]`
#[derive(Serialize, Deserialize)]
#[serde(remote = "Camera")]
pub(crate) struct CameraForm {
    width: u32,
    height: u32,
    focal: [f64; 2],
    centre: [f64; 2],
    #[serde(with = "DistortionForm")]
    distortion: Distortion,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Distortion", rename_all = "snake_case")]
enum DistortionForm {
    None,
    RadialTangential([f64; 4]),
    Equidistant([f64; 4]),
    Fov(f64),
    Rational([f64; 12]),
    ThinPrismFisheye([f64; 8]),
    DoubleSphere { xi: f64, alpha: f64 },
    Eucm { alpha: f64, beta: f64 },
    Omni { xi: f64, distortion: [f64; 4] },
}

/// `#[serde(with = "wire::keyframe_set")]`: a set of keyframe ids.
///
/// JSON has a plain list. Bincode has the sorted ids as gaps, the number of ids between each and the one before:
/// `[7, 8, 12]` is written `[7, 0, 3]`. Ids of one map are close to each other, and bincode writes a number below 251 in
/// one byte. The encoding of a set is unique; duplicates are written once and cannot be decoded.
/// A set of more than [`MAX_HELD_KEYFRAMES`](crate::MAX_HELD_KEYFRAMES) is refused.
pub(crate) mod keyframe_set {
    use crate::limits::{KeyframeId, MAX_HELD_KEYFRAMES};
    use serde::de::Error;
    use serde::{Deserializer, Serialize, Serializer};

    pub(crate) fn serialize<S: Serializer>(ids: &[KeyframeId], serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            return ids.serialize(serializer);
        }
        let mut numbers = ids.to_vec();
        numbers.sort_unstable();
        numbers.dedup();
        for k in (1..numbers.len()).rev() {
            numbers[k] -= numbers[k - 1] + 1;
        }
        numbers.serialize(serializer)
    }

    /// Ascending from bincode, in the given order from JSON.
    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Vec<KeyframeId>, D::Error> {
        let sorted_gaps = !deserializer.is_human_readable();
        let mut numbers: Vec<KeyframeId> = types::bounded::list::<_, _, MAX_HELD_KEYFRAMES>(deserializer)?;
        if sorted_gaps {
            for k in 1..numbers.len() {
                let next = numbers[k - 1].checked_add(1).and_then(|least| least.checked_add(numbers[k]));
                numbers[k] = next.ok_or_else(|| D::Error::custom("a keyframe id exceeds 64 bits"))?;
            }
        }
        Ok(numbers)
    }
}
