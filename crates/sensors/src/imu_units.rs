//! Units of an IMU's readings as they are recorded or come.

use crate::ImuSample;
use crate::imu_check::STANDARD_GRAVITY;

/// Units of an IMU's readings; rad/s and m/s^2 by default.
///
/// ```
/// use nalgebra::Vector3;
/// use sensors::{ImuSample, ImuUnits};
///
/// let units = ImuUnits { accelerations_in_g: true, ..ImuUnits::default() };
/// let reading = ImuSample { stamp_ns: 0, gyroscope: Vector3::x(), accelerometer: Vector3::z() };
/// assert_eq!(units.in_si(reading).accelerometer.z, 9.80665);
/// assert_eq!(units.in_si(reading).gyroscope.x, 1.0);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImuUnits {
    /// Accelerations are in g, not in m/s^2.
    pub accelerations_in_g: bool,
    /// Rates are in deg/s, not in rad/s.
    pub rates_in_degrees: bool,
}

impl ImuUnits {
    /// A reading in rad/s and m/s^2.
    #[must_use]
    pub fn in_si(self, reading: ImuSample) -> ImuSample {
        let gyroscope =
            if self.rates_in_degrees { reading.gyroscope.map(f64::to_radians) } else { reading.gyroscope };
        let accelerometer = if self.accelerations_in_g {
            reading.accelerometer * STANDARD_GRAVITY
        } else {
            reading.accelerometer
        };
        ImuSample { gyroscope, accelerometer, ..reading }
    }
}
