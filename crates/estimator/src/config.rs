//! Every switch and every number of the filter, with the reason for its default.

use crate::calibration::OnlineCalibration;
use serde::{Deserialize, Serialize};

/// What the estimator does with the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MapMode {
    /// Ignores the map: plain visual-inertial odometry.
    Odometry,
    /// SM in the paper: only the best keyframe of an answer.
    Single,
    /// MM in the paper: all keyframes of an answer, and every observation that they hold of a landmark.
    Multi,
    /// Takes poses and landmarks of the map for exact. Overconfident by construction; exists to be compared with.
    MapConst,
}

/// What is re-computed from the PnP solution when the map disagrees with the prediction (the paper's R).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Relinearization {
    /// Always linearize at the newest estimate.
    Off,
    /// Move the linearization point of `global_from_local`, as the paper does first. The solution carries the error of the
    /// keyframe that it was solved in, and that error then stands in the place of the state's: where a keyframe's own error
    /// is what disagrees, on `yq` with 0.9 degrees of it, the pose in G gets a NEES of 1.5 instead of 1.2.
    Transform,
    /// Move the linearization point of the clone that saw the matched image.
    Clone,
}

/// IMU noise as continuous-time densities, the numbers of a Kalibr or EuRoC `sensor.yaml`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
    /// The same sensor with its white noise taken `factor` times larger.
    ///
    /// Data sheets state a sensor at rest; on a vehicle vibration and scale errors come on top.
    pub fn inflated(self, factor: f64) -> Self {
        Self { gyroscope: self.gyroscope * factor, accelerometer: self.accelerometer * factor, ..self }
    }
}

impl Default for ImuNoise {
    /// The ADIS16448 of EuRoC as its `sensor.yaml` states it.
    fn default() -> Self {
        Self {
            gyroscope: 1.6968e-4,
            gyroscope_walk: 1.9393e-5,
            accelerometer: 2.0e-3,
            accelerometer_walk: 3.0e-3,
        }
    }
}

/// Standard deviations of the state that the filter starts from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InitialSigmas {
    /// Roll and pitch, rad.
    pub tilt: f64,
    /// Rotation about gravity, rad.
    pub yaw: f64,
    /// Position, metres.
    pub position: f64,
    /// Velocity, m/s.
    pub velocity: f64,
    /// Gyroscope bias, rad/s.
    pub gyroscope_bias: f64,
    /// Accelerometer bias, m/s^2.
    pub accelerometer_bias: f64,
}

impl Default for InitialSigmas {
    /// OpenVINS's figures for a start from ground truth, so that runs compare, but for yaw and
    /// position: L is *defined* by the first pose, which makes both exact. A filter that takes them for
    /// uncertain (0.017 rad, 0.05 m) shifts L against `G_T_L` for free, and its local pose on `yq/live`
    /// is off by 1.18 m instead of 0.18 m, with the pose in G unchanged.
    fn default() -> Self {
        Self {
            tilt: 0.017,
            yaw: 1e-4,
            position: 1e-3,
            velocity: 0.01,
            gyroscope_bias: 0.02,
            accelerometer_bias: 0.02,
        }
    }
}

/// All settings of the [`Estimator`](crate::Estimator).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EstimatorConfig {
    /// What to do with the map.
    pub mode: MapMode,
    /// What to do when the map disagrees by more than [`Self::relinearize_above_px`].
    pub relinearization: Relinearization,
    /// Jacobians of propagation, landmarks in the state and map rows at first estimates (keeps yaw and position
    /// unobservable). Tracks that live within one window are always linearized at the newest estimates.
    pub first_estimates: bool,
    /// Tell the filter when the body stands still (seen by its tracks).
    pub zero_velocity: bool,
    /// Clones in the sliding window. 20 beats 12 by 15 % on `loops`, and costs twice the time.
    pub window: usize,
    /// IMU noise densities.
    pub imu_noise: ImuNoise,
    /// Gravity, m/s^2.
    pub gravity: f64,
    /// Standard deviations of the start.
    pub initial: InitialSigmas,
    /// Most landmarks kept in the state; none is the plain MSCKF. 30 take a fifth to a half off the drift on every
    /// simulated recording for half as much time again; 50 are no better.
    pub slam_features: usize,
    /// Most tracks that one image's update uses.
    pub max_tracks: usize,
    /// What of the cameras' calibration is estimated online.
    pub calibration: OnlineCalibration,
    /// What is added to a camera's time to have the IMU's, seconds.
    pub camera_time_offset: f64,
    /// Noise of a tracked pixel, px.
    pub sigma_track_px: f64,
    /// Noise of a matched pixel in the current image, px.
    pub sigma_match_px: f64,
    /// Noise of a pixel stored in the map, px; unset, the map's own statement is used.
    pub sigma_map_px: Option<f64>,
    /// Significance of the chi-square gate on a track.
    pub track_gate: f64,
    /// Significance of the chi-square gate on one landmark of the map.
    pub landmark_gate: f64,
    /// Significance of the chi-square gate on one whole map update.
    pub frame_gate: f64,
    /// Mean reprojection error of the verified matches above which the linearization point moves, px.
    /// The paper's 20 px.
    pub relinearize_above_px: f64,
    /// Gauss-Newton iterations of a map update (1 is the plain extended Kalman filter).
    pub map_iterations: usize,
    /// Matches that the PnP solution of a keyframe must explain before the answer counts as verified.
    pub min_inliers: usize,
    /// What "explain" means: reprojection error as an angle, rad. Generous, because the depth of a map
    /// landmark is uncertain; the chi-square gates decide afterwards.
    pub verify_angle: f64,
    /// How far the landmarks of a keyframe are off together in its frame, in each direction, as a part of their distance:
    /// a first fix takes the camera's place from them. What six recorded maps show is 0.004 to 0.011 sideways and ahead,
    /// 0.025 ahead in one of them, with the error of the keyframe itself in it.
    pub sigma_map_shift: f64,
    /// Prior standard deviation of `global_from_local` before its first update: rotation, rad.
    /// Too small a value ruins the filter in a way that the pose in G does not show.
    pub transform_sigma_rotation: f64,
    /// The same for its position, as a fraction of the median depth of the landmarks that gave it: the
    /// distance to them is what PnP knows least, and one keyframe alone says nothing more about it.
    pub transform_sigma_depth_fraction: f64,
    /// Least prior standard deviation of its position, metres.
    pub transform_sigma_position: f64,
    /// Verified answers in a row that the gate may reject before the robot says that it is lost and
    /// finds `global_from_local` anew.
    pub lost_after_rejections: usize,
    /// Held keyframes that are updated with every step; further ones are parked (exactly, see `nuisance`).
    pub max_active_keyframes: usize,
    /// Most keyframes that are held; beyond it those not used for longest are dropped, and the filter becomes as uncertain
    /// as that takes (see `nuisance`). 5,000 take 25 to 45 MB with the default window and landmarks; a robot that drives
    /// through a building for a day uses some hundred.
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
            gravity: 9.81,
            initial: InitialSigmas::default(),
            slam_features: 30,
            max_tracks: 100,
            calibration: OnlineCalibration::default(),
            camera_time_offset: 0.0,
            sigma_track_px: 1.0,
            sigma_match_px: 1.0,
            sigma_map_px: None,
            track_gate: 0.95,
            landmark_gate: 0.95,
            frame_gate: 0.999,
            relinearize_above_px: 20.0,
            map_iterations: 1,
            min_inliers: 8,
            verify_angle: 0.0175,
            sigma_map_shift: 0.02,
            transform_sigma_rotation: 0.3,
            transform_sigma_depth_fraction: 0.3,
            transform_sigma_position: 0.3,
            lost_after_rejections: 5,
            max_active_keyframes: 24,
            max_held_keyframes: 5_000,
        }
    }
}

/// A larger offset between the clocks of camera and IMU is a mistake, seconds.
const LARGEST_TIME_OFFSET: f64 = 0.5;

impl EstimatorConfig {
    /// Says which setting cannot work, and what is expected.
    ///
    /// # Errors
    /// A sentence that names the setting.
    pub fn validate(&self) -> Result<(), String> {
        let positive = [
            ("imu_noise.gyroscope", self.imu_noise.gyroscope),
            ("imu_noise.gyroscope_walk", self.imu_noise.gyroscope_walk),
            ("imu_noise.accelerometer", self.imu_noise.accelerometer),
            ("imu_noise.accelerometer_walk", self.imu_noise.accelerometer_walk),
            ("gravity", self.gravity),
            ("initial.tilt", self.initial.tilt),
            ("initial.yaw", self.initial.yaw),
            ("initial.position", self.initial.position),
            ("initial.velocity", self.initial.velocity),
            ("initial.gyroscope_bias", self.initial.gyroscope_bias),
            ("initial.accelerometer_bias", self.initial.accelerometer_bias),
            ("sigma_track_px", self.sigma_track_px),
            ("sigma_match_px", self.sigma_match_px),
            ("sigma_map_px", self.sigma_map_px.unwrap_or(1.0)),
            ("relinearize_above_px", self.relinearize_above_px),
            ("calibration.sigma_rotation", self.calibration.sigma_rotation),
            ("calibration.sigma_position", self.calibration.sigma_position),
            ("calibration.sigma_focal", self.calibration.sigma_focal),
            ("calibration.sigma_centre", self.calibration.sigma_centre),
            ("calibration.sigma_distortion", self.calibration.sigma_distortion),
            ("calibration.sigma_time_offset", self.calibration.sigma_time_offset),
            ("verify_angle", self.verify_angle),
            ("sigma_map_shift", self.sigma_map_shift),
            ("transform_sigma_rotation", self.transform_sigma_rotation),
            ("transform_sigma_depth_fraction", self.transform_sigma_depth_fraction),
            ("transform_sigma_position", self.transform_sigma_position),
        ];
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(format!("{name} is {value}; it must be a positive number"));
            }
        }
        for (name, value) in [
            ("track_gate", self.track_gate),
            ("landmark_gate", self.landmark_gate),
            ("frame_gate", self.frame_gate),
        ] {
            if !(value > 0.0 && value < 1.0) {
                return Err(format!("{name} is {value}; a confidence lies between 0 and 1"));
            }
        }
        if !(self.camera_time_offset.is_finite() && self.camera_time_offset.abs() < LARGEST_TIME_OFFSET) {
            let offset = self.camera_time_offset;
            return Err(format!(
                "camera_time_offset is {offset} s; it must lie within {LARGEST_TIME_OFFSET} s of 0"
            ));
        }
        if self.max_tracks == 0 {
            return Err("max_tracks is 0; without tracks there is no odometry".into());
        }
        if self.window < 3 {
            return Err(format!("window is {}; a track needs at least 3 clones", self.window));
        }
        if self.map_iterations == 0 || self.min_inliers < 4 || self.max_active_keyframes == 0 {
            return Err(
                "map_iterations and max_active_keyframes must be at least 1, min_inliers at least 4".into()
            );
        }
        if self.max_held_keyframes <= self.max_active_keyframes {
            return Err(format!(
                "max_held_keyframes is {}; it must be more than max_active_keyframes, which is {}",
                self.max_held_keyframes, self.max_active_keyframes
            ));
        }
        Ok(())
    }
}
