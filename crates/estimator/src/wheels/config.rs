//! Settings of wheel odometry.

use geometry::{Pose, rotation};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// A differential drive: two driven wheels on one axis.
///
/// The base frame has its origin between the wheels on the floor, x forward, y left, z up.
///
/// ```
/// use estimator::{EstimatorConfig, WheelConfig};
///
/// let mut wheels = WheelConfig::new(0.10, 0.50); // metres
/// wheels.base_position_m = [-0.1, 0.0, -0.2];
/// let mut config = EstimatorConfig::default();
/// config.wheels = Some(wheels);
/// assert!(config.validate().is_ok());
/// wheels.track_m = 0.0;
/// config.wheels = Some(wheels);
/// let error = config.validate().unwrap_err();
/// assert_eq!(error.to_string(), "wheels.track_m is 0; it must be a positive number");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct WheelConfig {
    /// Radius of the left wheel, metres.
    pub radius_left_m: f64,
    /// Radius of the right wheel, metres.
    pub radius_right_m: f64,
    /// Distance between the wheels, metres.
    pub track_m: f64,
    /// Origin of the base in the IMU frame, metres.
    #[serde(default)]
    pub base_position_m: [f64; 3],
    /// Rotation vector of `imu_from_base`, rad.
    #[serde(default)]
    pub base_rotation_rad: [f64; 3],
    /// Added to the stamp of a reading to obtain the IMU's time, seconds.
    #[serde(default)]
    pub time_offset_s: f64,
    /// Standard deviations of the above before the first reading.
    #[serde(default)]
    pub initial: InitialWheelSigmas,
    /// Noise of readings and of the contact with the floor.
    #[serde(default)]
    pub noise: WheelNoise,
}

/// Standard deviations of the calibration of the wheels before the first reading. All of it is estimated online.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct InitialWheelSigmas {
    /// Each radius, as a fraction of itself.
    pub sigma_radius_fraction: f64,
    /// Track, as a fraction of itself.
    pub sigma_track_fraction: f64,
    /// Orientation of the base in the IMU frame, rad.
    pub sigma_rotation_rad: f64,
    /// Position of the base in the IMU frame, metres.
    pub sigma_position_m: f64,
    /// Time offset, seconds.
    pub sigma_time_offset_s: f64,
}

impl Default for InitialWheelSigmas {
    /// Of a data sheet and a tape measure: 2 %, 2 %, 1 degree, 2 cm, 5 ms.
    fn default() -> Self {
        Self {
            sigma_radius_fraction: 0.02,
            sigma_track_fraction: 0.02,
            sigma_rotation_rad: 0.0175,
            sigma_position_m: 0.02,
            sigma_time_offset_s: 0.005,
        }
    }
}

/// Noise of the wheels. What grows with the root of the distance is independent from metre to metre; what is not, an error of
/// a radius, is estimated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct WheelNoise {
    /// White noise of each reading of a wheel's speed, rad/s.
    pub sigma_speed_rad_s: f64,
    /// Distance that a wheel rolls over a metre of floor, m/sqrt(m).
    pub sigma_rolling_m_sqrt_m: f64,
    /// Motion along the axis of the wheels and off the floor over a metre, m/sqrt(m). The wheels forbid the one, a flat floor
    /// the other; tyres that turn and a body that sways do both.
    pub sigma_off_track_m_sqrt_m: f64,
    /// Confidence of the chi-square gate on the motion between two images: what it rejects is slip.
    pub gate: f64,
}

impl Default for WheelNoise {
    /// Rubber tyres on concrete.
    fn default() -> Self {
        Self {
            sigma_speed_rad_s: 0.05,
            sigma_rolling_m_sqrt_m: 0.005,
            sigma_off_track_m_sqrt_m: 0.02,
            gate: 0.999,
        }
    }
}

/// Largest magnitude of the time offset, seconds.
const MAX_TIME_OFFSET_S: f64 = 0.5;
/// Largest coordinate of the base in the IMU frame, metres.
const MAX_POSITION_M: f64 = 100.0;
/// Largest coordinate of its rotation vector, rad.
const MAX_ROTATION_RAD: f64 = 7.0;

impl WheelConfig {
    /// Two wheels of one radius, the base in the IMU's frame.
    ///
    /// # Arguments
    /// * `radius_m`, `track_m`: metres.
    pub fn new(radius_m: f64, track_m: f64) -> Self {
        Self {
            radius_left_m: radius_m,
            radius_right_m: radius_m,
            track_m,
            base_position_m: [0.0; 3],
            base_rotation_rad: [0.0; 3],
            time_offset_s: 0.0,
            initial: InitialWheelSigmas::default(),
            noise: WheelNoise::default(),
        }
    }

    /// `imu_from_base`.
    pub fn imu_from_base(&self) -> Pose {
        Pose::new(rotation::exp(&Vector3::from(self.base_rotation_rad)), Vector3::from(self.base_position_m))
    }

    /// The settings that must be positive, by name.
    pub(crate) fn positive(&self) -> [(&'static str, f64); 11] {
        let (initial, noise) = (&self.initial, &self.noise);
        [
            ("wheels.radius_left_m", self.radius_left_m),
            ("wheels.radius_right_m", self.radius_right_m),
            ("wheels.track_m", self.track_m),
            ("wheels.initial.sigma_radius_fraction", initial.sigma_radius_fraction),
            ("wheels.initial.sigma_track_fraction", initial.sigma_track_fraction),
            ("wheels.initial.sigma_rotation_rad", initial.sigma_rotation_rad),
            ("wheels.initial.sigma_position_m", initial.sigma_position_m),
            ("wheels.initial.sigma_time_offset_s", initial.sigma_time_offset_s),
            ("wheels.noise.sigma_speed_rad_s", noise.sigma_speed_rad_s),
            ("wheels.noise.sigma_rolling_m_sqrt_m", noise.sigma_rolling_m_sqrt_m),
            ("wheels.noise.sigma_off_track_m_sqrt_m", noise.sigma_off_track_m_sqrt_m),
        ]
    }

    /// The settings whose magnitude is limited, by name, with their limits.
    pub(crate) fn limited(&self) -> [(&'static str, f64, f64); 3] {
        let largest = |numbers: [f64; 3]| numbers.into_iter().map(f64::abs).fold(0.0, f64::max);
        let sum = |numbers: [f64; 3]| numbers.into_iter().sum::<f64>();
        // Of a number that is not finite, the sum is not, either.
        let magnitude = |numbers| if sum(numbers).is_finite() { largest(numbers) } else { f64::NAN };
        [
            ("wheels.time_offset_s", self.time_offset_s, MAX_TIME_OFFSET_S),
            ("wheels.base_position_m", magnitude(self.base_position_m), MAX_POSITION_M),
            ("wheels.base_rotation_rad", magnitude(self.base_rotation_rad), MAX_ROTATION_RAD),
        ]
    }
}
