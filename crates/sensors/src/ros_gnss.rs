//! Positions of GNSS in messages of ROS.

use nalgebra::{Matrix3, Vector3};
use ros_messages::sensor_msgs::NavSatFix;

/// `NavSatStatus::status` below which there is no position.
const FIX: i8 = 0;
/// `position_covariance_type` of an unknown covariance.
const UNKNOWN: u8 = 0;

/// A position of satellites before it is turned to the frame of the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SatellitePosition {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// Latitude and longitude, degrees, and altitude above the ellipsoid, metres.
    pub geodetic: Vector3<f64>,
    /// East, north and up, m^2, where it is stated.
    pub covariance: Option<Matrix3<f64>>,
}

/// The receiver has no position.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the receiver has no position (status {0}), or no altitude")]
pub struct NoFix(pub i8);

/// The position that a message states.
///
/// # Errors
/// [`NoFix`].
///
/// ```
/// use ros_messages::sensor_msgs::NavSatFix;
/// let mut message = NavSatFix { latitude: 48.0, longitude: 11.0, altitude: 500.0, ..NavSatFix::default() };
/// assert_eq!(sensors::ros::satellite_position(&message)?.geodetic.x, 48.0);
/// message.status.status = -1;
/// assert!(sensors::ros::satellite_position(&message).is_err());
/// # Ok::<(), sensors::ros::NoFix>(())
/// ```
pub fn satellite_position(message: &NavSatFix) -> Result<SatellitePosition, NoFix> {
    let geodetic = Vector3::new(message.latitude, message.longitude, message.altitude);
    if message.status.status < FIX || !geodetic.iter().all(|value| value.is_finite()) {
        return Err(NoFix(message.status.status));
    }
    let covariance = Matrix3::from_row_slice(&message.position_covariance);
    let is_stated = message.position_covariance_type != UNKNOWN && covariance.cholesky().is_some();
    Ok(SatellitePosition {
        stamp_ns: message.header.stamp.to_nanoseconds(),
        geodetic,
        covariance: is_stated.then_some(covariance),
    })
}
