//! Positions of GNSS in messages of ROS.

use crate::GnssReading;
use nalgebra::{Matrix3, Vector3};
use ros_messages::geometry_msgs::PoseWithCovarianceStamped;
use ros_messages::sensor_msgs::NavSatFix;
use ros_messages::std_msgs::Header;

/// `NavSatStatus::status` below which there is no position.
const FIX: i8 = 0;
/// `position_covariance_type` of an unknown covariance.
const UNKNOWN: u8 = 0;

/// The topic of the positions of a recording of Driftless.
pub const GNSS_TOPIC: &str = "/gnss";
/// Variance that is stated of the rotation, rad^2: nothing is known of it.
const UNKNOWN_ROTATION: f64 = 1e6;
/// Columns of the covariance of a pose.
const POSE_COLUMNS: usize = 6;

/// A position in the frame of the map as a message; `None` for a time that ROS cannot write. The rotation is the identity, with a
/// variance of 1e6 rad^2 about each axis: a zero would state that it is known.
///
/// # Arguments
/// * `frame`: name of the map's frame.
pub fn position_message(reading: &GnssReading, frame: &str) -> Option<PoseWithCovarianceStamped> {
    let mut message =
        PoseWithCovarianceStamped { header: Header::new(reading.stamp_ns, frame)?, ..Default::default() };
    let [x, y, z]: [f64; 3] = reading.position.into();
    let position = &mut message.pose.pose.position;
    (position.x, position.y, position.z) = (x, y, z);
    message.pose.pose.orientation.w = 1.0;
    for row in 0..3 {
        for column in 0..3 {
            message.pose.covariance[POSE_COLUMNS * row + column] = reading.covariance[(row, column)];
        }
        message.pose.covariance[(POSE_COLUMNS + 1) * (row + 3)] = UNKNOWN_ROTATION;
    }
    Some(message)
}

/// The position in the frame of the map that a message states; `None` where it is none, or has no covariance.
pub fn position_of_message(message: &PoseWithCovarianceStamped) -> Option<GnssReading> {
    let position = &message.pose.pose.position;
    let reading = GnssReading {
        stamp_ns: message.header.stamp.to_nanoseconds(),
        position: Vector3::new(position.x, position.y, position.z),
        covariance: Matrix3::from_fn(|row, column| message.pose.covariance[POSE_COLUMNS * row + column]),
    };
    reading.is_valid().then_some(reading)
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_states_nothing_of_the_rotation_and_comes_back() {
        let covariance = Matrix3::new(4.0, 0.5, 0.1, 0.5, 3.0, 0.2, 0.1, 0.2, 2.0);
        let reading = GnssReading { stamp_ns: 7, position: Vector3::new(1.0, 2.0, 3.0), covariance };
        let message = position_message(&reading, "map").unwrap();
        let stated = nalgebra::Matrix6::from_row_slice(&message.pose.covariance);
        assert_eq!(stated.fixed_view::<3, 3>(0, 0), covariance);
        assert_eq!(stated.fixed_view::<3, 3>(3, 3), Matrix3::from_diagonal_element(UNKNOWN_ROTATION));
        assert!(stated.cholesky().is_some(), "{stated}");
        assert_eq!(position_of_message(&message), Some(reading));
    }
}
