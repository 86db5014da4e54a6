//! What is done to every reading of an IMU when it is taken in, be it from a folder, a bag, or live.

use crate::{ImuSample, ImuSensor, ImuUnits};
use calibration::ImuIntrinsics;

/// From readings as they are recorded or come to those of an ideal IMU with biases and noise.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ImuIntake {
    units: ImuUnits,
    intrinsics: Option<ImuIntrinsics>,
}

impl ImuIntake {
    pub(crate) fn new(units: ImuUnits, imu: Option<&ImuSensor>) -> Self {
        Self { units, intrinsics: imu.and_then(|imu| imu.intrinsics) }
    }

    /// The reading in rad/s and m/s^2, without scale and misalignment.
    pub(crate) fn take(&self, reading: ImuSample) -> ImuSample {
        let reading = self.units.in_si(reading);
        self.intrinsics.map_or(reading, |intrinsics| intrinsics.corrected(reading))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};
    use types::ImuNoise;

    #[test]
    fn the_unit_comes_before_the_scale() {
        let one = Matrix3::identity();
        let intrinsics = ImuIntrinsics::new(one * 1.25, one, one, one * 0.01).unwrap();
        let imu = ImuSensor {
            noise: ImuNoise::default(),
            rate_hz: 200.0,
            gravity_magnitude: None,
            intrinsics: Some(intrinsics),
        };
        let units = ImuUnits { accelerations_in_g: true, ..ImuUnits::default() };
        let reading = ImuSample { stamp_ns: 5, gyroscope: Vector3::x(), accelerometer: Vector3::z() * 1.25 };
        let taken = ImuIntake::new(units, Some(&imu)).take(reading);
        // 1.25 g that are read are one; a hundredth of it is in the angular velocity.
        assert!((taken.accelerometer - Vector3::z() * 9.80665).norm() < 1e-12);
        assert!((taken.gyroscope - Vector3::new(1.0, 0.0, -0.098_066_5)).norm() < 1e-12);
        assert_eq!(ImuIntake::default().take(reading), reading);
    }
}
