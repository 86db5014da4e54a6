//! Settings of a robot.

use super::initial_pose::InitialPoses;
use super::stop::StopSignal;
use estimator::{EstimatorConfig, GnssConfig, InitialState, WheelConfig};
use geometry::rotation;
use sensors::{GnssSensor, SensorCalibration, WheelSensor};
use std::time::Duration;
use vision::tracking::TrackerOptions;

/// Default of [`RobotSettings::query_interval_ns`].
const QUERY_INTERVAL_NS: i64 = 500_000_000;
/// Default of [`RobotSettings::query_deadline`].
const QUERY_DEADLINE: Duration = Duration::from_secs(2);
/// Default of [`RobotSettings::max_keyframes`].
const MAX_KEYFRAMES: u16 = 4;
/// Default of [`RobotSettings::cameras`]: all.
const CAMERAS: usize = usize::MAX;

/// How a robot plays its source. [`RobotSettings::new`] has the defaults.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct RobotSettings {
    /// Name of the robot, for queries and outputs: `robot`.
    pub name: String,
    /// Settings of the estimator.
    pub estimator: EstimatorConfig,
    /// The state that the estimator begins with; `None` where it initializes itself, at rest or in motion.
    pub initial: Option<InitialState>,
    /// Number of cameras to use at most, the first ones of the calibration: all.
    pub cameras: usize,
    /// The front end, for a source that has images and no tracks.
    pub tracker: TrackerOptions,
    /// Play at the speed of the recording instead of as fast as possible. A live source is played as it comes.
    pub realtime: bool,
    /// Least time between two images that features are extracted from, nanoseconds: half a second.
    pub query_interval_ns: i64,
    /// Number of cameras of a frame that the map is asked about at once, at most: one, so that they take turns.
    pub query_cameras: usize,
    /// How long a query may take: two seconds.
    pub query_deadline: Duration,
    /// Maximum number of keyframes in one answer: four.
    pub max_keyframes: u16,
    /// Where an operator sets poses.
    pub initial_poses: InitialPoses,
    /// Stops the run before the source ends.
    pub stop: StopSignal,
}

impl RobotSettings {
    /// The defaults, with settings of the estimator: see [`estimator_config`].
    pub fn new(estimator: EstimatorConfig) -> Self {
        Self {
            name: "robot".to_owned(),
            estimator,
            initial: None,
            cameras: CAMERAS,
            tracker: TrackerOptions::default(),
            realtime: false,
            query_interval_ns: QUERY_INTERVAL_NS,
            query_cameras: 1,
            query_deadline: QUERY_DEADLINE,
            max_keyframes: MAX_KEYFRAMES,
            initial_poses: InitialPoses::default(),
            stop: StopSignal::default(),
        }
    }
}

/// The default settings of the estimator with noise and gravity as the calibration of the IMU states them, the wheels and the antenna
/// of GNSS that it states; `None` without an IMU.
pub fn estimator_config(calibration: &SensorCalibration) -> Option<EstimatorConfig> {
    let imu = calibration.imu.as_ref()?;
    let mut config = EstimatorConfig::default();
    config.gravity = imu.gravity_magnitude.unwrap_or(config.gravity);
    config.imu_noise = imu.noise;
    config.wheels = calibration.wheels.as_ref().map(wheel_config);
    config.gnss = calibration.gnss.as_ref().map(gnss_config);
    Some(config)
}

/// The default settings of GNSS with its antenna and the correlation of its errors.
pub fn gnss_config(gnss: &GnssSensor) -> GnssConfig {
    let mut config = GnssConfig::at(gnss.antenna_in_imu.into());
    config.correlation_time_s = gnss.correlation_time_s.unwrap_or(config.correlation_time_s);
    config
}

/// The antenna that settings of GNSS state.
pub fn gnss_sensor(config: &GnssConfig) -> GnssSensor {
    GnssSensor {
        antenna_in_imu: config.antenna_position_m.into(),
        correlation_time_s: Some(config.correlation_time_s),
        ..GnssSensor::default()
    }
}

/// The wheels that settings state, whose readings are speeds.
pub fn wheel_sensor(config: &WheelConfig) -> WheelSensor {
    let sigma_angle_rad = Some(config.noise.sigma_angle_rad).filter(|sigma| *sigma > 0.0);
    WheelSensor {
        sigma_speed_rad_s: Some(config.noise.sigma_speed_rad_s),
        sigma_angle_rad,
        ..WheelSensor::new(config.base, config.imu_from_base())
    }
}

/// The default settings of wheels with their geometry and noise.
pub fn wheel_config(wheels: &WheelSensor) -> WheelConfig {
    let mut config = WheelConfig::new(wheels.base);
    config.base_position_m = wheels.imu_from_base.translation.into();
    config.base_rotation_rad = rotation::log(&wheels.imu_from_base.rotation).into();
    config.noise.sigma_speed_rad_s = wheels.sigma_speed_rad_s.unwrap_or(config.noise.sigma_speed_rad_s);
    config.noise.sigma_angle_rad = wheels.sigma_angle_rad.unwrap_or(config.noise.sigma_angle_rad);
    config
}
