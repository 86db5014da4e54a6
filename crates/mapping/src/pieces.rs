//! Recordings that fall into pieces: parts that no image ties together, but seconds of the IMU alone.

use map::contents::MapContents;
use map::model::Keyframe;
use nalgebra::Matrix6;

use super::error::BuildError;

/// A rotation that is known to less than this (rad) cannot be linearized: a covariance would not say what is known.
const MAX_SIGMA_RAD: f64 = 0.3;

/// Refuses a map whose later keyframes are hardly known relative to the first one.
///
/// # Arguments
/// * `first_ns`: first frame of the recording.
///
/// # Errors
/// [`BuildError::Pieces`].
pub(super) fn check_one_piece(contents: &MapContents, first_ns: i64) -> Result<(), BuildError> {
    let mut keyframes: Vec<&Keyframe> = contents.keyframes.iter().collect();
    keyframes.sort_unstable_by_key(|keyframe| keyframe.stamp_ns);
    let of =
        |keyframe: &Keyframe, begin: usize| largest_sigma(&keyframe.global_from_keyframe.covariance, begin);
    let Some(pair) = keyframes.windows(2).find(|pair| of(pair[1], 0) > MAX_SIGMA_RAD) else { return Ok(()) };
    let middle_ns = pair[0].stamp_ns.midpoint(pair[1].stamp_ns);
    Err(BuildError::Pieces {
        at_s: (middle_ns - first_ns) as f64 * 1e-9,
        sigma_deg: of(pair[1], 0).to_degrees(),
        sigma_m: of(pair[1], 3),
    })
}

fn largest_sigma(covariance: &Matrix6<f64>, begin: usize) -> f64 {
    covariance.fixed_view::<3, 3>(begin, begin).diagonal().max().sqrt()
}
