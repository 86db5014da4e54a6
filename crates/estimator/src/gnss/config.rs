//! Settings of GNSS.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// An antenna on the robot, and what its positions are worth.
///
/// ```
/// use estimator::{EstimatorConfig, GnssConfig};
///
/// let mut config = EstimatorConfig::default();
/// config.gnss = Some(GnssConfig::at([0.0, 0.1, 0.8])); // metres, in the frame of the IMU
/// assert!(config.validate().is_ok());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct GnssConfig {
    /// The antenna in the frame of the IMU, metres.
    pub antenna_position_m: [f64; 3],
    /// Added to the stamp of a reading to obtain the IMU's time, seconds.
    pub time_offset_s: f64,
    /// Time over which the errors of readings are alike, seconds: their correlation falls to 1/e in it. Orbits, atmosphere and
    /// reflections change within a minute or so; with corrections (RTK) some seconds.
    pub correlation_time_s: f64,
    /// Least standard deviation of a reading, each axis, metres: receivers state less where they see no reflection.
    pub least_sigma_m: f64,
    /// Confidence of the chi-square gate on a reading.
    pub gate: f64,
    /// Standard deviation of the tilt of G against gravity, rad, where GNSS initializes `global_from_local`.
    pub sigma_tilt_rad: f64,
    /// Standard deviation of the yaw with which it does, rad; before, the robot has not driven far enough.
    pub initial_sigma_yaw_rad: f64,
}

impl Default for GnssConfig {
    /// A receiver without corrections, its antenna at the IMU.
    fn default() -> Self {
        Self {
            antenna_position_m: [0.0; 3],
            time_offset_s: 0.0,
            correlation_time_s: 30.0,
            least_sigma_m: 0.01,
            gate: 0.999,
            sigma_tilt_rad: 0.002,
            initial_sigma_yaw_rad: 0.1,
        }
    }
}

/// Largest magnitude of the time offset, seconds.
const MAX_TIME_OFFSET_S: f64 = 5.0;
/// Largest coordinate of the antenna, metres.
const MAX_POSITION_M: f64 = 100.0;

impl GnssConfig {
    /// The defaults with an antenna in the frame of the IMU, metres.
    pub fn at(antenna_position_m: [f64; 3]) -> Self {
        Self { antenna_position_m, ..Self::default() }
    }

    pub(crate) fn antenna(&self) -> Vector3<f64> {
        self.antenna_position_m.into()
    }

    /// The settings that must be positive, by name.
    pub(crate) fn positive(&self) -> [(&'static str, f64); 4] {
        [
            ("gnss.correlation_time_s", self.correlation_time_s),
            ("gnss.least_sigma_m", self.least_sigma_m),
            ("gnss.sigma_tilt_rad", self.sigma_tilt_rad),
            ("gnss.initial_sigma_yaw_rad", self.initial_sigma_yaw_rad),
        ]
    }

    /// The settings whose magnitude is limited, by name, with their limits.
    pub(crate) fn limited(&self) -> [(&'static str, f64, f64); 4] {
        let [x, y, z] = self.antenna_position_m;
        [
            ("gnss.time_offset_s", self.time_offset_s, MAX_TIME_OFFSET_S),
            ("gnss.antenna_position_m", x, MAX_POSITION_M),
            ("gnss.antenna_position_m", y, MAX_POSITION_M),
            ("gnss.antenna_position_m", z, MAX_POSITION_M),
        ]
    }
}
