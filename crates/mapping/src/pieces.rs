//! Recordings that fall into pieces: parts that no image ties together, but seconds of the IMU alone.

use nalgebra::Matrix6;

use super::error::BuildError;
use super::joint_covariance::JointCovariance;

/// A rotation that is known to less than this (rad) cannot be linearized: a covariance would not say what is known.
const MAX_SIGMA_RAD: f64 = 0.3;

/// Refuses a map in which a keyframe is hardly known relative to the one before.
///
/// # Arguments
/// * `keyframes`: view and stamp (ns) of each, in the order of time.
/// * `first_ns`: first frame of the recording.
///
/// # Errors
/// [`BuildError::Pieces`].
pub(super) fn check_one_piece(
    joint: &JointCovariance,
    keyframes: &[(usize, i64)],
    first_ns: i64,
) -> Result<(), BuildError> {
    let views: Vec<usize> = keyframes.iter().map(|(view, _)| *view).collect();
    let relative = joint.relative_to_the_one_before(&views);
    let Some(before) = relative.iter().position(|covariance| largest_sigma(covariance, 0) > MAX_SIGMA_RAD)
    else {
        return Ok(());
    };
    let middle_ns = keyframes[before].1.midpoint(keyframes[before + 1].1);
    Err(BuildError::Pieces {
        at_s: (middle_ns - first_ns) as f64 * 1e-9,
        sigma_deg: largest_sigma(&relative[before], 0).to_degrees(),
        sigma_m: largest_sigma(&relative[before], 3),
    })
}

fn largest_sigma(covariance: &Matrix6<f64>, begin: usize) -> f64 {
    covariance.fixed_view::<3, 3>(begin, begin).diagonal().max().sqrt()
}
