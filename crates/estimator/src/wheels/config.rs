//! Settings of wheel odometry.

use geometry::{Pose, rotation};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;
use types::WheelBase;

/// The wheels of a base: a differential drive, a car, or one that moves sideways.
///
/// ```
/// use estimator::{BaseKind, EstimatorConfig, WheelBase, WheelConfig};
///
/// let mut wheels = WheelConfig::new(WheelBase::new(BaseKind::Differential, 0.10, 0.50)); // metres
/// wheels.base_position_m = [-0.1, 0.0, -0.2];
/// let mut config = EstimatorConfig::default();
/// config.wheels = Some(wheels);
/// assert!(config.validate().is_ok());
/// wheels.base = WheelBase::new(BaseKind::Differential, 0.10, 0.0);
/// config.wheels = Some(wheels);
/// let error = config.validate().unwrap_err();
/// assert_eq!(error.to_string(), "wheels.base.track_m is 0; it must be a positive number");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct WheelConfig {
    /// What the base is, and its geometry.
    pub base: WheelBase,
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
    /// Track, wheelbase or reach, as a fraction of itself.
    pub sigma_track_fraction: f64,
    /// Offset of the steering, rad.
    pub sigma_steering_offset_rad: f64,
    /// Scale of the way to the side, of mecanum wheels and of three omni wheels.
    pub sigma_sideways_scale: f64,
    /// Orientation of the base in the IMU frame, rad.
    pub sigma_rotation_rad: f64,
    /// Position of the base in the IMU frame, metres.
    pub sigma_position_m: f64,
    /// Time offset, seconds.
    pub sigma_time_offset_s: f64,
}

impl Default for InitialWheelSigmas {
    /// Of a data sheet and a tape measure: 2 %, 2 %, 1 degree, 1 degree, 2 cm, 5 ms. Rollers lose 3 to 10 % of the way to the side.
    fn default() -> Self {
        Self {
            sigma_radius_fraction: 0.02,
            sigma_track_fraction: 0.02,
            sigma_steering_offset_rad: 0.0175,
            sigma_sideways_scale: 0.05,
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
    /// Error of the angle of each wheel at both ends of an interval, rad: the steps of an encoder, of which an interval does not
    /// know how far the next one is. Zero where speeds are measured.
    pub sigma_angle_rad: f64,
    /// White noise of each reading of the steering angle, rad: with the play of the steering.
    pub sigma_steering_rad: f64,
    /// Distance that a wheel rolls over a metre of floor, m/sqrt(m).
    pub sigma_rolling_m_sqrt_m: f64,
    /// Motion along the axis of the wheels and off the floor over a metre, m/sqrt(m). The wheels forbid the one, except those that
    /// roll sideways, a flat floor the other; tyres that turn and a body that sways do both.
    pub sigma_off_track_m_sqrt_m: f64,
    /// Confidence of the chi-square gate on the motion between two images: what it rejects is slip.
    pub gate: f64,
}

impl Default for WheelNoise {
    /// Rubber tyres on concrete.
    fn default() -> Self {
        Self {
            sigma_speed_rad_s: 0.05,
            sigma_angle_rad: 0.0,
            sigma_steering_rad: 0.01,
            sigma_rolling_m_sqrt_m: 0.005,
            sigma_off_track_m_sqrt_m: 0.02,
            gate: 0.999,
        }
    }
}

/// A setting that may be negative.
const STEERING_OFFSET: &str = "wheels.base.steering_offset_rad";
/// Largest scale of the way to the side.
const MAX_SIDEWAYS_SCALE: f64 = 2.0;
/// Largest magnitude of the time offset, seconds.
const MAX_TIME_OFFSET_S: f64 = 0.5;
/// Largest offset of the steering, rad.
const MAX_STEERING_OFFSET_RAD: f64 = 0.5;
/// Largest coordinate of the base in the IMU frame, metres.
const MAX_POSITION_M: f64 = 100.0;
/// Largest coordinate of its rotation vector, rad.
const MAX_ROTATION_RAD: f64 = 7.0;

impl WheelConfig {
    /// A base in the IMU's frame.
    pub fn new(base: WheelBase) -> Self {
        Self {
            base,
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

    /// Standard deviations of the [parameters of the base](WheelBase::parameters) before the first reading.
    pub fn parameter_sigmas(&self) -> Vec<f64> {
        let (initial, wheels) = (&self.initial, self.base.kind().wheels());
        let sigma = |(index, value): (usize, f64)| match index.cmp(&wheels) {
            Ordering::Less => initial.sigma_radius_fraction * value,
            Ordering::Equal => initial.sigma_track_fraction * value,
            Ordering::Greater if self.base.kind().moves_sideways() => initial.sigma_sideways_scale,
            Ordering::Greater => initial.sigma_steering_offset_rad,
        };
        self.base.parameters().into_iter().enumerate().map(sigma).collect()
    }

    /// The settings that must be positive, by name.
    pub(crate) fn positive(&self) -> impl Iterator<Item = (&'static str, f64)> + use<> {
        let (initial, noise) = (&self.initial, &self.noise);
        let others = [
            ("wheels.initial.sigma_radius_fraction", initial.sigma_radius_fraction),
            ("wheels.initial.sigma_track_fraction", initial.sigma_track_fraction),
            ("wheels.initial.sigma_steering_offset_rad", initial.sigma_steering_offset_rad),
            ("wheels.initial.sigma_sideways_scale", initial.sigma_sideways_scale),
            ("wheels.initial.sigma_rotation_rad", initial.sigma_rotation_rad),
            ("wheels.initial.sigma_position_m", initial.sigma_position_m),
            ("wheels.initial.sigma_time_offset_s", initial.sigma_time_offset_s),
            ("wheels.noise.sigma_speed_rad_s", noise.sigma_speed_rad_s),
            ("wheels.noise.sigma_steering_rad", noise.sigma_steering_rad),
            ("wheels.noise.sigma_rolling_m_sqrt_m", noise.sigma_rolling_m_sqrt_m),
            ("wheels.noise.sigma_off_track_m_sqrt_m", noise.sigma_off_track_m_sqrt_m),
        ];
        let names = self.base.parameter_names().iter().map(|name| setting(name));
        // An offset of the steering may be negative.
        let is_length = |(name, _): &(&str, f64)| *name != STEERING_OFFSET;
        names.zip(self.base.parameters()).filter(is_length).chain(others)
    }

    /// The settings whose magnitude is limited, by name, with their limits.
    pub(crate) fn limited(&self) -> [(&'static str, f64, f64); 6] {
        let largest = |numbers: [f64; 3]| numbers.into_iter().map(f64::abs).fold(0.0, f64::max);
        let sum = |numbers: [f64; 3]| numbers.into_iter().sum::<f64>();
        // Of a number that is not finite, the sum is not, either.
        let magnitude = |numbers| if sum(numbers).is_finite() { largest(numbers) } else { f64::NAN };
        let steering_rad = match self.base {
            WheelBase::Ackermann { steering_offset_rad, .. } => steering_offset_rad,
            _ => 0.0,
        };
        let exact_or_more = |sigma: f64| if sigma >= 0.0 { sigma } else { f64::NAN };
        [
            (STEERING_OFFSET, steering_rad, MAX_STEERING_OFFSET_RAD),
            ("wheels.base.sideways_scale", self.base.sideways_scale(), MAX_SIDEWAYS_SCALE),
            ("wheels.noise.sigma_angle_rad", exact_or_more(self.noise.sigma_angle_rad), MAX_ROTATION_RAD),
            ("wheels.time_offset_s", self.time_offset_s, MAX_TIME_OFFSET_S),
            ("wheels.base_position_m", magnitude(self.base_position_m), MAX_POSITION_M),
            ("wheels.base_rotation_rad", magnitude(self.base_rotation_rad), MAX_ROTATION_RAD),
        ]
    }
}

/// The name of a length of the base in the settings.
fn setting(parameter: &str) -> &'static str {
    match parameter {
        "radius_left_m" => "wheels.base.radius_left_m",
        "radius_right_m" => "wheels.base.radius_right_m",
        "track_m" => "wheels.base.track_m",
        "radius_m" => "wheels.base.radius_m",
        "wheelbase_m" => "wheels.base.wheelbase_m",
        "reach_m" => "wheels.base.reach_m",
        "steering_offset_rad" => STEERING_OFFSET,
        "sideways_scale" => "wheels.base.sideways_scale",
        _ => "wheels.base.radii_m",
    }
}
