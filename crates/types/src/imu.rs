//! Readings of an IMU, and their noise.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// One IMU sample, in the IMU frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// Angular velocity, rad/s.
    pub gyroscope: Vector3<f64>,
    /// Specific force, m/s^2 (at rest it points up).
    pub accelerometer: Vector3<f64>,
}

impl ImuSample {
    /// Whether all of its values are finite.
    pub fn is_finite(&self) -> bool {
        self.gyroscope.iter().chain(self.accelerometer.iter()).all(|value| value.is_finite())
    }

    /// Linear interpolation between two samples.
    pub fn between(a: &Self, b: &Self, stamp_ns: i64) -> Self {
        let span = (b.stamp_ns - a.stamp_ns) as f64;
        let weight = if span > 0.0 { (stamp_ns - a.stamp_ns) as f64 / span } else { 0.0 };
        Self {
            stamp_ns,
            gyroscope: a.gyroscope.lerp(&b.gyroscope, weight),
            accelerometer: a.accelerometer.lerp(&b.accelerometer, weight),
        }
    }
}

/// IMU noise as continuous-time densities, as in a Kalibr or EuRoC `sensor.yaml`.
///
/// ```
/// let mut noise = types::ImuNoise::default();
/// noise.gyroscope = 1e-3; // rad/s/sqrt(Hz)
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ImuNoise {
    /// Gyroscope white noise, rad/s/sqrt(Hz).
    pub gyroscope: f64,
    /// Gyroscope bias random walk, rad/s^2/sqrt(Hz).
    pub gyroscope_walk: f64,
    /// Accelerometer white noise, m/s^2/sqrt(Hz).
    pub accelerometer: f64,
    /// Accelerometer bias random walk, m/s^3/sqrt(Hz).
    pub accelerometer_walk: f64,
}

impl ImuNoise {
    /// The same sensor with its white noise multiplied by `factor`.
    ///
    /// Data sheets state the noise at rest; vibration and scale-factor errors of a moving vehicle add to it.
    pub fn inflated(self, factor: f64) -> Self {
        Self { gyroscope: self.gyroscope * factor, accelerometer: self.accelerometer * factor, ..self }
    }
}

impl Default for ImuNoise {
    /// The ADIS16448 of EuRoC, from its `sensor.yaml`.
    fn default() -> Self {
        Self {
            gyroscope: 1.6968e-4,
            gyroscope_walk: 1.9393e-5,
            accelerometer: 2.0e-3,
            accelerometer_walk: 3.0e-3,
        }
    }
}
