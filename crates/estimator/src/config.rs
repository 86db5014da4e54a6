//! All settings of the filter, with units and the reason for each default.

use crate::calibration::{CalibratedCamera, OnlineCalibration};
use crate::gnss::config::GnssConfig;
use crate::wheels::config::WheelConfig;
use geometry::CameraError;
use serde::{Deserialize, Serialize};
use types::ImuNoise;

/// What the estimator does with the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum MapMode {
    /// Visual-inertial odometry only; the map is ignored.
    Odometry,
    /// Only the best keyframe of an answer (SM in the paper).
    Single,
    /// All keyframes of an answer, and all their observations of each landmark (MM in the paper).
    Multi,
    /// Treats the map's poses and landmarks as exact. Inconsistent (overconfident) by construction; a baseline.
    MapConst,
}

/// Which linearization point is moved to the PnP solution when the map disagrees with the prediction (R in the paper).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Relinearization {
    /// Always linearize at the newest estimate.
    Off,
    /// Move that of `global_from_local`, as the paper does first. The PnP solution has the error of its keyframe: where
    /// that error is what disagrees (0.9 degrees on the recording `yq`), the pose in G has a NEES of 1.5 instead of 1.2.
    Transform,
    /// Move that of the clone of the matched image.
    Clone,
}

/// Which noise levels are adapted to the innovations; see [`noise_adaptation`](crate::noise_adaptation).
///
/// Those that are not adapted are as stated in [`EstimatorConfig`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct AdaptiveNoise {
    /// White noise of the IMU, from [`EstimatorConfig::imu_noise`] upwards: a data sheet states a sensor at rest.
    pub imu: bool,
    /// Noise of tracked pixels, from 0.4 of [`EstimatorConfig::sigma_track_px`] upwards.
    pub tracks: bool,
    /// Noise of matched pixels in the image and in the map, from that of [`EstimatorConfig::sigma_match_px`] and
    /// [`EstimatorConfig::sigma_map_px`] upwards.
    pub matches: bool,
}

impl AdaptiveNoise {
    /// All noise as stated.
    pub const NONE: Self = Self { imu: false, tracks: false, matches: false };
}

impl Default for AdaptiveNoise {
    /// All of it.
    fn default() -> Self {
        Self { imu: true, tracks: true, matches: true }
    }
}

/// Standard deviations of the initial IMU state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct InitialSigmas {
    /// Roll and pitch, rad.
    pub sigma_tilt_rad: f64,
    /// Rotation about gravity, rad.
    pub sigma_yaw_rad: f64,
    /// Position, metres.
    pub sigma_position_m: f64,
    /// Velocity, m/s.
    pub sigma_velocity_m_s: f64,
    /// Gyroscope bias, rad/s, where it is unknown; an initialization at rest measures it.
    pub sigma_gyroscope_bias_rad_s: f64,
    /// Accelerometer bias, m/s^2, where it is unknown.
    pub sigma_accelerometer_bias_m_s2: f64,
}

impl InitialSigmas {
    /// Standard deviation of a gyroscope bias from ground truth, rad/s; as in OpenVINS.
    const KNOWN_GYROSCOPE_BIAS_RAD_S: f64 = 0.02;
    /// The same of the accelerometer's, m/s^2.
    const KNOWN_ACCELEROMETER_BIAS_M_S2: f64 = 0.02;

    /// The same with biases that are known from ground truth.
    pub fn with_known_biases(self) -> Self {
        let Self {
            sigma_gyroscope_bias_rad_s: gyroscope, sigma_accelerometer_bias_m_s2: accelerometer, ..
        } = self;
        Self {
            sigma_gyroscope_bias_rad_s: gyroscope.min(Self::KNOWN_GYROSCOPE_BIAS_RAD_S),
            sigma_accelerometer_bias_m_s2: accelerometer.min(Self::KNOWN_ACCELEROMETER_BIAS_M_S2),
            ..self
        }
    }
}

impl Default for InitialSigmas {
    /// The values of OpenVINS for an initialization from ground truth, except yaw and position: L is *defined* by the
    /// first pose, so both are exact. With uncertain ones (0.017 rad, 0.05 m) updates can shift L against
    /// `global_from_local`: the error of the local pose on the recording `yq/live` was 1.18 m instead of 0.18 m, that in G
    /// the same. The biases are unknown: real ones of EuRoC's sensor are 0.08 rad/s and up to 0.3 m/s^2.
    fn default() -> Self {
        Self {
            sigma_tilt_rad: 0.017,
            sigma_yaw_rad: 1e-4,
            sigma_position_m: 1e-3,
            sigma_velocity_m_s: 0.01,
            sigma_gyroscope_bias_rad_s: 0.1,
            sigma_accelerometer_bias_m_s2: 0.2,
        }
    }
}

/// All settings of the [`Estimator`](crate::Estimator).
///
/// ```
/// use estimator::{EstimatorConfig, MapMode};
///
/// let mut config = EstimatorConfig::default();
/// config.mode = MapMode::Odometry;
/// config.sigma_track_px = 0.7;
/// assert!(config.validate().is_ok());
///
/// config.window = 2;
/// let error = config.validate().unwrap_err();
/// assert_eq!(error.to_string(), "window is 2; it must be at least 3: a track needs three clones");
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct EstimatorConfig {
    /// What to do with the map.
    pub mode: MapMode,
    /// What to do when the map disagrees by more than [`Self::relinearize_above_px`].
    pub relinearization: Relinearization,
    /// Evaluate the Jacobians of propagation, tracks, SLAM features and map measurements at first estimates (keeps yaw and
    /// position unobservable, and the tilt of a robot that drives straight).
    pub first_estimates: bool,
    /// Zero-velocity updates while the tracks show that the body is stationary.
    pub zero_velocity: bool,
    /// Clones in the sliding window. 20 beats 12 by 15 % on `loops`, and costs twice the time.
    pub window: usize,
    /// IMU noise densities.
    pub imu_noise: ImuNoise,
    /// Which noise levels are adapted to the innovations.
    pub adaptive_noise: AdaptiveNoise,
    /// Gravity, m/s^2.
    pub gravity: f64,
    /// Standard deviations of the initial state.
    pub initial: InitialSigmas,
    /// Maximum number of SLAM features; 0 is the plain MSCKF. 30 reduce the drift by 20 to 50 % on every simulated
    /// recording and increase the run time by 50 %; 50 are no better.
    pub slam_features: usize,
    /// Maximum number of tracks in the MSCKF update of one image.
    pub max_tracks: usize,
    /// Which parts of the cameras' calibration are estimated online.
    pub calibration: OnlineCalibration,
    /// Added to a camera's time stamp to obtain the IMU's, seconds.
    pub camera_time_offset_s: f64,
    /// Readout time of each camera's rolling shutter instead of that of its calibration, seconds: one for all cameras, or one by
    /// camera; empty for those of the calibration.
    pub readout_times_s: Vec<f64>,
    /// The wheels; without it their readings are ignored.
    pub wheels: Option<WheelConfig>,
    /// The antenna of GNSS; without it its positions are ignored.
    pub gnss: Option<GnssConfig>,
    /// Noise of a tracked pixel, px.
    pub sigma_track_px: f64,
    /// Noise of a matched pixel in the current image, px.
    pub sigma_match_px: f64,
    /// Noise of the map's pixels, px; if unset, the value stated in the answer is used.
    pub sigma_map_px: Option<f64>,
    /// Confidence of the chi-square gate on a track.
    pub track_gate: f64,
    /// Confidence of the chi-square gate on one landmark of the map.
    pub landmark_gate: f64,
    /// Confidence of the chi-square gate on a whole map update.
    pub frame_gate: f64,
    /// Mean reprojection error of the inliers above which the linearization point is moved, px. 20 px as in the paper.
    pub relinearize_above_px: f64,
    /// Gauss-Newton iterations of a map update (1 is the plain extended Kalman filter).
    pub map_iterations: usize,
    /// Minimum number of PnP inliers of the best keyframe.
    pub min_inliers: usize,
    /// PnP inlier threshold: reprojection error as an angle, rad. Wide, because the depth of a map landmark is uncertain;
    /// the chi-square gates decide afterwards.
    pub verify_angle_rad: f64,
    /// Standard deviation of the common position error of a keyframe's landmarks in its frame, per axis, as a fraction of
    /// their distance; used by the map initialization. Six recorded maps show 0.004 to 0.011 sideways and forward, one of
    /// them 0.025 forward, the error of the keyframe included.
    pub sigma_map_shift_fraction: f64,
    /// Prior standard deviation of the rotation of `global_from_local` at the map initialization, rad. Too small a value
    /// makes the filter inconsistent in a way that the error of the pose in G does not show.
    pub sigma_transform_rotation_rad: f64,
    /// The same of its position, as a fraction of the median depth of the landmarks: the distance to them is what PnP
    /// determines least, and a single keyframe has no further information on it.
    pub sigma_transform_depth_fraction: f64,
    /// Lower bound of the prior standard deviation of its position, metres.
    pub sigma_transform_position_m: f64,
    /// Standard deviation of the position in G, along its worst axis, that makes a robot localized, metres: a pose that is known
    /// less well after its first answer is not given out yet. Maps whose landmarks are known to decimetres need more.
    pub localized_sigma_m: f64,
    /// Number of consecutive verified answers rejected by the gates after which the status is lost and
    /// `global_from_local` is initialized again.
    pub lost_after_rejections: usize,
    /// Maximum number of active held keyframes, updated with every step; further ones are inactive (exactly, see
    /// [`schmidt`](crate::schmidt)).
    pub max_active_keyframes: usize,
    /// Maximum number of held keyframes; beyond it the least recently used are evicted and the covariance is inflated
    /// accordingly (see [`schmidt`](crate::schmidt)). 5,000 take 25 to 45 MB with the default window and SLAM features; a
    /// robot that drives through a building for a day uses some hundreds.
    pub max_held_keyframes: usize,
}

impl Default for EstimatorConfig {
    fn default() -> Self {
        Self {
            mode: MapMode::Multi,
            relinearization: Relinearization::Clone,
            first_estimates: true,
            zero_velocity: true,
            window: 20,
            imu_noise: ImuNoise::default(),
            adaptive_noise: AdaptiveNoise::default(),
            gravity: 9.81,
            initial: InitialSigmas::default(),
            slam_features: 30,
            max_tracks: 100,
            calibration: OnlineCalibration::default(),
            camera_time_offset_s: 0.0,
            readout_times_s: Vec::new(),
            wheels: None,
            gnss: None,
            sigma_track_px: 1.0,
            sigma_match_px: 1.0,
            sigma_map_px: None,
            track_gate: 0.95,
            landmark_gate: 0.95,
            frame_gate: 0.999,
            relinearize_above_px: 20.0,
            map_iterations: 1,
            min_inliers: 8,
            verify_angle_rad: 0.0175,
            sigma_map_shift_fraction: 0.02,
            sigma_transform_rotation_rad: 0.3,
            sigma_transform_depth_fraction: 0.3,
            sigma_transform_position_m: 0.3,
            localized_sigma_m: 0.15,
            lost_after_rejections: 5,
            max_active_keyframes: 24,
            max_held_keyframes: 5_000,
        }
    }
}

/// Maximum offset between the clocks of camera and IMU, seconds; a larger one is a configuration error.
const MAX_TIME_OFFSET_S: f64 = 0.5;

/// Maximum readout time of an image, seconds; a larger one is a configuration error.
const MAX_READOUT_S: f64 = 0.2;

/// A setting or a camera that the filter cannot run with.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// A value that must be positive.
    #[error("{setting} is {value}; it must be a positive number")]
    NotPositive {
        /// Name of the setting.
        setting: &'static str,
        /// Its value.
        value: f64,
    },
    /// A confidence outside of (0, 1).
    #[error("{setting} is {value}; a confidence lies between 0 and 1")]
    NotAConfidence {
        /// Name of the setting.
        setting: &'static str,
        /// Its value.
        value: f64,
    },
    /// A value whose magnitude is too large.
    #[error("{setting} is {value}; its magnitude must be below {limit}")]
    TooLarge {
        /// Name of the setting.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// Upper bound of its magnitude.
        limit: f64,
    },
    /// A number below its minimum.
    #[error("{setting} is {value}; it must be at least {minimum}: {reason}")]
    TooSmall {
        /// Name of the setting.
        setting: &'static str,
        /// Its value.
        value: usize,
        /// The minimum.
        minimum: usize,
        /// What the minimum is needed for.
        reason: &'static str,
    },
    /// No camera was given.
    #[error("no camera is configured")]
    NoCamera,
    /// Invalid intrinsics of a camera.
    #[error("camera {camera}: {source}")]
    Camera {
        /// Index of the camera.
        camera: usize,
        /// What is wrong with it.
        source: CameraError,
    },
}

impl EstimatorConfig {
    /// Checks all settings.
    ///
    /// # Errors
    /// [`ConfigError`] names the first invalid setting, its value and what is allowed.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.validate_positive()?;
        self.validate_counts()?;
        for (setting, value) in [
            ("track_gate", self.track_gate),
            ("landmark_gate", self.landmark_gate),
            ("frame_gate", self.frame_gate),
            ("wheels.noise.gate", self.wheels.map_or(self.frame_gate, |wheels| wheels.noise.gate)),
            ("gnss.gate", self.gnss.map_or(self.frame_gate, |gnss| gnss.gate)),
        ] {
            if !(value > 0.0 && value < 1.0) {
                return Err(ConfigError::NotAConfidence { setting, value });
            }
        }
        let of_camera = ("camera_time_offset_s", self.camera_time_offset_s, MAX_TIME_OFFSET_S);
        let of_wheels = self.wheels.iter().flat_map(WheelConfig::limited);
        let of_gnss = self.gnss.iter().flat_map(GnssConfig::limited);
        let readouts = self.readout_times_s.iter().map(|&value| ("readout_times_s", value, MAX_READOUT_S));
        for (setting, value, limit) in
            std::iter::once(of_camera).chain(of_wheels).chain(of_gnss).chain(readouts)
        {
            if !(value.is_finite() && value.abs() < limit) {
                return Err(ConfigError::TooLarge { setting, value, limit });
            }
        }
        Ok(())
    }

    /// Time of an image by the clock of the IMU, by the stated time offset, nanoseconds.
    pub fn imu_stamp_ns(&self, image_stamp_ns: i64) -> i64 {
        image_stamp_ns + (self.camera_time_offset_s * 1e9).round() as i64
    }

    /// The cameras with the readout times of the settings, where these state some.
    pub fn with_readout_times(&self, mut cameras: Vec<CalibratedCamera>) -> Vec<CalibratedCamera> {
        let stated = &self.readout_times_s;
        for (index, calibrated) in cameras.iter_mut().enumerate() {
            let own = if stated.len() == 1 { stated.first() } else { stated.get(index) };
            calibrated.readout_s = own.copied().unwrap_or(calibrated.readout_s);
        }
        cameras
    }

    fn validate_positive(&self) -> Result<(), ConfigError> {
        let positive = [
            ("imu_noise.gyroscope", self.imu_noise.gyroscope),
            ("imu_noise.gyroscope_walk", self.imu_noise.gyroscope_walk),
            ("imu_noise.accelerometer", self.imu_noise.accelerometer),
            ("imu_noise.accelerometer_walk", self.imu_noise.accelerometer_walk),
            ("gravity", self.gravity),
            ("initial.sigma_tilt_rad", self.initial.sigma_tilt_rad),
            ("initial.sigma_yaw_rad", self.initial.sigma_yaw_rad),
            ("initial.sigma_position_m", self.initial.sigma_position_m),
            ("initial.sigma_velocity_m_s", self.initial.sigma_velocity_m_s),
            ("initial.sigma_gyroscope_bias_rad_s", self.initial.sigma_gyroscope_bias_rad_s),
            ("initial.sigma_accelerometer_bias_m_s2", self.initial.sigma_accelerometer_bias_m_s2),
            ("sigma_track_px", self.sigma_track_px),
            ("sigma_match_px", self.sigma_match_px),
            ("sigma_map_px", self.sigma_map_px.unwrap_or(1.0)),
            ("relinearize_above_px", self.relinearize_above_px),
            ("calibration.sigma_rotation_rad", self.calibration.sigma_rotation_rad),
            ("calibration.sigma_position_m", self.calibration.sigma_position_m),
            ("calibration.sigma_focal_fraction", self.calibration.sigma_focal_fraction),
            ("calibration.sigma_principal_point_px", self.calibration.sigma_principal_point_px),
            ("calibration.sigma_distortion", self.calibration.sigma_distortion),
            ("calibration.sigma_time_offset_s", self.calibration.sigma_time_offset_s),
            ("calibration.sigma_readout_time_s", self.calibration.sigma_readout_time_s),
            ("verify_angle_rad", self.verify_angle_rad),
            ("sigma_map_shift_fraction", self.sigma_map_shift_fraction),
            ("sigma_transform_rotation_rad", self.sigma_transform_rotation_rad),
            ("sigma_transform_depth_fraction", self.sigma_transform_depth_fraction),
            ("sigma_transform_position_m", self.sigma_transform_position_m),
            ("localized_sigma_m", self.localized_sigma_m),
        ];
        let of_wheels = self.wheels.iter().flat_map(WheelConfig::positive);
        let of_gnss = self.gnss.iter().flat_map(GnssConfig::positive);
        let all = positive.into_iter().chain(of_wheels).chain(of_gnss);
        match all.into_iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
            Some((setting, value)) => Err(ConfigError::NotPositive { setting, value }),
            None => Ok(()),
        }
    }

    fn validate_counts(&self) -> Result<(), ConfigError> {
        let more_than_active = self.max_active_keyframes.saturating_add(1);
        let minimums = [
            ("max_tracks", self.max_tracks, 1, "without tracks there is no odometry"),
            ("window", self.window, 3, "a track needs three clones"),
            ("map_iterations", self.map_iterations, 1, "the first iteration is the update"),
            ("min_inliers", self.min_inliers, 4, "a camera pose is determined by four matches"),
            ("max_active_keyframes", self.max_active_keyframes, 1, "a map update needs a keyframe"),
            (
                "max_held_keyframes",
                self.max_held_keyframes,
                more_than_active,
                "more than max_active_keyframes",
            ),
        ];
        match minimums.into_iter().find(|(_, value, minimum, _)| value < minimum) {
            Some((setting, value, minimum, reason)) => {
                Err(ConfigError::TooSmall { setting, value, minimum, reason })
            }
            None => Ok(()),
        }
    }
}
