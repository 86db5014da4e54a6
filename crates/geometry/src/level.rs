//! Whether the z axis of a map is vertical.

use nalgebra::Vector3;

/// Largest angle between the z axis of a map and the vertical, degrees, with which x, y and yaw in the map are those on the floor.
pub const MAX_TILT_DEG: f64 = 5.0;

/// Angle between the z axis of a map and the vertical, degrees, of a map that is not level.
///
/// # Arguments
/// * `up_in_global`: the direction up in the map's frame, of any length but zero. With an odometry frame L, whose z axis is up, it is
///   `global_from_local.rotation * Vector3::z()`.
///
/// # Returns
/// `None` within [`MAX_TILT_DEG`].
///
/// ```
/// use geometry::tilt_beyond_limit_deg;
/// use nalgebra::Vector3;
///
/// assert_eq!(tilt_beyond_limit_deg(&Vector3::new(0.05, 0.0, 1.0)), None);
/// assert_eq!(tilt_beyond_limit_deg(&Vector3::new(1.0, 0.0, 0.0)), Some(90.0));
/// ```
pub fn tilt_beyond_limit_deg(up_in_global: &Vector3<f64>) -> Option<f64> {
    Some(up_in_global.angle(&Vector3::z()).to_degrees()).filter(|tilt_deg| *tilt_deg > MAX_TILT_DEG)
}
