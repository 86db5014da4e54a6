//! Checks on the values of a decoded message.
//!
//! A checksum guarantees that the bytes are those that were sent, not that they are meaningful. Every message is
//! therefore validated after decoding and before encoding; the error names the field, for example
//! `keyframe.global_from_keyframe.rotation`. Covariances are checked by [`check_covariance`].

use crate::keys;
use crate::limits::MAX_TEXT_BYTES;
use geometry::camera::Camera;
use geometry::covariance_check::check_covariance;
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use geometry::{MAX_COORDINATE_M, is_coordinate};
use thiserror::Error;

/// How far the norm of a decoded quaternion or direction may be from 1.
///
/// Allows quaternions written with six decimals.
pub const UNIT_TOLERANCE: f64 = 1e-5;

/// A field of a message has an invalid value.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("field `{field}` {reason}")]
pub struct InvalidField {
    /// Path of the field inside the message, like `features.pixels[3]`.
    pub field: String,
    /// The violation, to be read after the field's name: "is not finite".
    pub reason: String,
}

impl InvalidField {
    /// A violation of the field at a path.
    pub fn new(field: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { field: field.into(), reason: reason.into() }
    }

    /// The same violation with `parent` prepended to the path.
    #[must_use]
    pub fn within(self, parent: &str) -> Self {
        let separator = if self.field.is_empty() || self.field.starts_with('[') { "" } else { "." };
        Self { field: format!("{parent}{separator}{}", self.field), reason: self.reason }
    }
}

/// Types whose values can be checked.
pub trait Validate {
    /// Checks every field.
    ///
    /// # Errors
    /// The first [`InvalidField`] found.
    fn validate(&self) -> Result<(), InvalidField>;
}

/// Returns the violation unless `holds`.
pub(crate) fn require(holds: bool, field: &str, reason: &str) -> Result<(), InvalidField> {
    if holds { Ok(()) } else { Err(InvalidField::new(field, reason)) }
}

/// Every number is finite.
pub(crate) fn require_finite(values: &[f64], field: &str) -> Result<(), InvalidField> {
    require(values.iter().all(|value| value.is_finite()), field, "is not finite")
}

/// Every number is a coordinate of a position, m.
pub(crate) fn require_position(values: &[f64], field: &str) -> Result<(), InvalidField> {
    require_finite(values, field)?;
    let reason = format!("has a coordinate beyond {MAX_COORDINATE_M:e} m");
    require(values.iter().copied().all(is_coordinate), field, &reason)
}

/// A direction: three finite numbers of norm 1.
pub(crate) fn require_positive(value: f64, field: &str) -> Result<(), InvalidField> {
    require(value.is_finite() && value > 0.0, field, "is not a finite, positive number")
}

pub(crate) fn require_not_negative(value: f64, field: &str) -> Result<(), InvalidField> {
    require(value.is_finite() && value >= 0.0, field, "is not a finite, non-negative number")
}

/// Checks a field that is a message's part; an absent one is valid.
pub(crate) fn require_valid<'a, T: Validate + 'a>(
    part: impl Into<Option<&'a T>>,
    field: &str,
) -> Result<(), InvalidField> {
    part.into().map_or(Ok(()), |part| part.validate().map_err(|violation| violation.within(field)))
}

pub(crate) fn require_name(name: &str, field: &str) -> Result<(), InvalidField> {
    keys::validate_name(name).map_err(|error| InvalidField::new(field, error.to_string()))
}

/// Checks a direction; an absent one is valid.
pub(crate) fn require_unit(direction: Option<&[f64; 3]>, field: &str) -> Result<(), InvalidField> {
    let Some(direction) = direction else { return Ok(()) };
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

/// Human-readable text: at most [`MAX_TEXT_BYTES`].
pub(crate) fn require_short(text: &str, field: &str) -> Result<(), InvalidField> {
    let reason = format!("is longer than {MAX_TEXT_BYTES} bytes");
    require(text.len() <= MAX_TEXT_BYTES, field, &reason)
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
        require_position(self.translation.as_slice(), "translation")
    }
}

impl Validate for PoseWithCovariance {
    fn validate(&self) -> Result<(), InvalidField> {
        self.pose.validate()?;
        check_covariance(&self.covariance)
            .map_err(|violation| InvalidField::new("covariance", violation.to_string()))
    }
}

impl Validate for Camera {
    fn validate(&self) -> Result<(), InvalidField> {
        Camera::validate(self)
            .map_err(|error| InvalidField::new("", format!("is not a usable camera: {error}")))
    }
}
