//! Calibration of the wheels and the layout of its error.
//!
//! ```text
//! radii (2)          left, right, metres
//! track (1)          metres
//! time offset (1)    seconds; t_imu = t_wheels + offset
//! extrinsics (6)     [δθ, δp] of imu_from_base, R = Exp(δθ) R̂, in the IMU's frame
//! ```
//! Source: Lee, Eckenhoff, Yang, Geneva & Huang, "Visual-inertial-wheel odometry with online calibration", IROS 2020.

use super::config::WheelConfig;
use geometry::Pose;
use nalgebra::{DVectorView, SMatrix, SVector, Vector6};

/// Dimension of the error.
pub const WHEELS_DIM: usize = 10;
/// Begin of the extrinsics in the error.
pub(super) const EXTRINSICS: usize = 4;

/// Estimated calibration of the wheels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelCalibration {
    /// Radius of the left wheel, metres.
    pub radius_left_m: f64,
    /// Radius of the right wheel, metres.
    pub radius_right_m: f64,
    /// Distance between the wheels, metres.
    pub track_m: f64,
    /// Added to the stamp of a reading to obtain the IMU's time, seconds.
    pub time_offset_s: f64,
    /// Pose of the base in the IMU frame.
    pub imu_from_base: Pose,
}

impl WheelCalibration {
    /// As stated.
    pub fn new(config: &WheelConfig) -> Self {
        Self {
            radius_left_m: config.radius_left_m,
            radius_right_m: config.radius_right_m,
            track_m: config.track_m,
            time_offset_s: config.time_offset_s,
            imu_from_base: config.imu_from_base(),
        }
    }

    /// Covariance of the error of the stated calibration.
    pub fn initial_covariance(config: &WheelConfig) -> SMatrix<f64, WHEELS_DIM, WHEELS_DIM> {
        let initial = &config.initial;
        let (turn, shift) = (initial.sigma_rotation_rad, initial.sigma_position_m);
        let sigmas = SVector::<f64, WHEELS_DIM>::from([
            initial.sigma_radius_fraction * config.radius_left_m,
            initial.sigma_radius_fraction * config.radius_right_m,
            initial.sigma_track_fraction * config.track_m,
            initial.sigma_time_offset_s,
            turn,
            turn,
            turn,
            shift,
            shift,
            shift,
        ]);
        SMatrix::from_diagonal(&sigmas.component_mul(&sigmas))
    }

    /// Adds an error of dimension [`WHEELS_DIM`].
    pub fn retract(&mut self, error: &DVectorView<'_, f64>) {
        self.radius_left_m += error[0];
        self.radius_right_m += error[1];
        self.track_m += error[2];
        self.time_offset_s += error[3];
        let step: Vector6<f64> = error.fixed_rows::<6>(EXTRINSICS).into();
        self.imu_from_base = self.imu_from_base.retract(&step);
    }

    /// Whether all values are finite, and the lengths positive.
    pub fn is_valid(&self) -> bool {
        let lengths = [self.radius_left_m, self.radius_right_m, self.track_m];
        lengths.iter().all(|length| length.is_finite() && *length > 0.0)
            && self.time_offset_s.is_finite()
            && self.imu_from_base.is_finite()
    }
}
