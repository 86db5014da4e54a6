//! What a message must satisfy beyond having parsed, and how a violation is named.
//!
//! A checksum says that the bytes are those that were sent, not that the sender made sense. Every message is
//! therefore validated after decoding (and before encoding), and the error names the field, like
//! `keyframe.global_from_keyframe.rotation`.

use geometry::camera::Camera;
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::Matrix6;
use thiserror::Error;

/// How far the norm of a decoded quaternion or direction may be from 1.
///
/// Loose enough for a script that writes six decimals.
pub const UNIT_TOLERANCE: f64 = 1e-5;

/// How far a covariance may be from symmetric and from positive semi-definite, after scaling its diagonal to 1.
///
/// Covariances come out of filters in f64: rounding leaves about 1e-12 of this; a covariance written with six
/// digits by a script leaves 1e-6.
pub const COVARIANCE_TOLERANCE: f64 = 1e-5;

/// A field of a message holds something that no correct sender sends.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("field `{field}` {reason}")]
pub struct InvalidField {
    /// Path of the field inside the message, like `features.pixels[3]`.
    pub field: String,
    /// What is wrong with it, to be read after the field's name: "is not finite".
    pub reason: String,
}

impl InvalidField {
    /// Names a field and what is wrong with it.
    pub fn new(field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { field: field.into(), reason: reason.into() }
    }

    /// The same violation seen from the message that holds the field's owner as `parent`.
    #[must_use]
    pub fn within(self, parent: &str) -> Self {
        let separator = if self.field.is_empty() || self.field.starts_with('[') { "" } else { "." };
        Self { field: format!("{parent}{separator}{}", self.field), reason: self.reason }
    }
}

/// Something that can say whether its content makes sense.
pub trait Validate {
    /// Checks every field.
    ///
    /// # Errors
    /// The first [`InvalidField`] found.
    fn validate(&self) -> Result<(), InvalidField>;
}

/// Fails with the violation unless `holds`.
pub(crate) fn require(holds: bool, field: &str, reason: &str) -> Result<(), InvalidField> {
    if holds { Ok(()) } else { Err(InvalidField::new(field, reason)) }
}

/// Every number is finite.
pub(crate) fn require_finite(values: &[f64], field: &str) -> Result<(), InvalidField> {
    require(values.iter().all(|value| value.is_finite()), field, "is not finite")
}

/// A direction: three finite numbers of norm 1.
pub(crate) fn require_unit(direction: &[f64; 3], field: &str) -> Result<(), InvalidField> {
    require_finite(direction, field)?;
    let norm = direction.iter().map(|value| value * value).sum::<f64>().sqrt();
    require((norm - 1.0).abs() <= UNIT_TOLERANCE, field, &format!("has norm {norm}, not 1"))
}

/// Every element of a list, with its index in the name of the violation.
pub(crate) fn require_each<T>(
    items: &[T],
    field: &str,
    check: impl Fn(&T) -> Result<(), InvalidField>,
) -> Result<(), InvalidField> {
    items.iter().enumerate().try_for_each(|(index, item)| {
        check(item).map_err(|violation| violation.within(&format!("{field}[{index}]")))
    })
}

/// Text that people read: at most [`crate::MAX_TEXT_BYTES`].
pub(crate) fn require_short(text: &str, field: &str) -> Result<(), InvalidField> {
    let reason = format!("is longer than {} bytes", crate::MAX_TEXT_BYTES);
    require(text.len() <= crate::MAX_TEXT_BYTES, field, &reason)
}

impl Validate for Pose {
    fn validate(&self) -> Result<(), InvalidField> {
        let coordinates = self.rotation.quaternion().coords;
        require_finite(coordinates.as_slice(), "rotation")?;
        let norm = coordinates.norm();
        require(
            (norm - 1.0).abs() <= UNIT_TOLERANCE,
            "rotation",
            &format!("is not a unit quaternion (norm {norm})"),
        )?;
        require_finite(self.translation.as_slice(), "translation")
    }
}

impl Validate for PoseWithCovariance {
    fn validate(&self) -> Result<(), InvalidField> {
        self.pose.validate()?;
        validate_covariance(&self.covariance).map_err(|reason| InvalidField::new("covariance", reason))
    }
}

impl Validate for Camera {
    fn validate(&self) -> Result<(), InvalidField> {
        Camera::validate(self)
            .map_err(|error| InvalidField::new("", format!("is not a usable camera: {error}")))
    }
}

/// A covariance is finite, has no negative variance, is symmetric and positive semi-definite.
///
/// The last two are judged on the correlation matrix (diagonal scaled to 1), because radians and metres in one
/// matrix differ by orders of magnitude.
fn validate_covariance(covariance: &Matrix6<f64>) -> Result<(), String> {
    if !covariance.iter().all(|value| value.is_finite()) {
        return Err("is not finite".into());
    }
    let sigmas = covariance.diagonal().map(f64::sqrt);
    if let Some(index) = (0..6).find(|&index| covariance[(index, index)] < 0.0) {
        return Err(format!("has a negative variance at [{index}][{index}]"));
    }
    let mut correlation = Matrix6::identity();
    for row in 0..6 {
        for column in (0..6).filter(|&column| column != row) {
            let scale = sigmas[row] * sigmas[column];
            let entry = covariance[(row, column)];
            if (entry - covariance[(column, row)]).abs() > COVARIANCE_TOLERANCE * scale {
                return Err(format!("is not symmetric at [{row}][{column}]"));
            }
            if entry.abs() > scale * (1.0 + COVARIANCE_TOLERANCE) {
                return Err(format!("is negative: [{row}][{column}] exceeds what its variances allow"));
            }
            correlation[(row, column)] = if scale > 0.0 { entry / scale } else { 0.0 };
        }
    }
    let smallest = correlation.symmetric_eigenvalues().min();
    if smallest < -COVARIANCE_TOLERANCE {
        return Err(format!("is negative: its correlation matrix has the eigenvalue {smallest:e}"));
    }
    Ok(())
}
