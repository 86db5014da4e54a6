//! Calibration of the wheels and the layout of its error.
//!
//! ```text
//! base (3 to 6)      radii, then track, wheelbase or reach, metres; then the offset of the steering, rad, or the scale of the
//!                    way to the side
//! time offset (1)    seconds; t_imu = t_wheels + offset
//! extrinsics (6)     [δθ, δp] of imu_from_base, R = Exp(δθ) R̂, in the IMU's frame
//! ```
//! Source: Lee, Eckenhoff, Yang, Geneva & Huang, "Visual-inertial-wheel odometry with online calibration", IROS 2020.

use super::config::WheelConfig;
use geometry::Pose;
use nalgebra::{DMatrix, DVectorView, Vector6};
use types::{MAX_WHEEL_PARAMETERS, WheelBase};

/// Largest dimension of the error.
pub const MAX_WHEELS_DIM: usize = MAX_WHEEL_PARAMETERS + OTHERS;
/// Dimension of the error without the base: time offset and extrinsics.
const OTHERS: usize = 7;

/// Estimated calibration of the wheels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelCalibration {
    /// The base.
    pub base: WheelBase,
    /// Added to the stamp of a reading to obtain the IMU's time, seconds.
    pub time_offset_s: f64,
    /// Pose of the base in the IMU frame.
    pub imu_from_base: Pose,
}

impl WheelCalibration {
    /// As stated.
    pub fn new(config: &WheelConfig) -> Self {
        Self { base: config.base, time_offset_s: config.time_offset_s, imu_from_base: config.imu_from_base() }
    }

    /// Dimension of the error.
    pub fn dim(&self) -> usize {
        self.clock() + OTHERS
    }

    /// Index of the time offset in the error, behind the base.
    pub(super) fn clock(&self) -> usize {
        self.base.parameter_names().len()
    }

    /// Begin of the extrinsics in the error.
    pub(super) fn extrinsics(&self) -> usize {
        self.clock() + 1
    }

    /// Covariance of the error of the stated calibration.
    pub fn initial_covariance(config: &WheelConfig) -> DMatrix<f64> {
        let calibration = Self::new(config);
        let initial = &config.initial;
        let (turn, shift) = (initial.sigma_rotation_rad, initial.sigma_position_m);
        let others = [initial.sigma_time_offset_s, turn, turn, turn, shift, shift, shift];
        let mut covariance = DMatrix::zeros(calibration.dim(), calibration.dim());
        for (index, sigma) in config.parameter_sigmas().into_iter().chain(others).enumerate() {
            covariance[(index, index)] = sigma * sigma;
        }
        covariance
    }

    /// Adds an error of dimension [`Self::dim`].
    pub fn retract(&mut self, error: &DVectorView<'_, f64>) {
        let (clock, extrinsics) = (self.clock(), self.extrinsics());
        self.base.add(&error.as_slice()[..clock]);
        self.time_offset_s += error[clock];
        let step: Vector6<f64> = error.fixed_rows::<6>(extrinsics).into();
        self.imu_from_base = self.imu_from_base.retract(&step);
    }

    /// Whether all values are finite, and the lengths positive.
    pub fn is_valid(&self) -> bool {
        let parameters = self.base.parameters();
        let lengths = &parameters[..=self.base.kind().wheels()];
        lengths.iter().all(|length| *length > 0.0)
            && parameters.iter().all(|parameter| parameter.is_finite())
            && self.base.sideways_scale() > 0.0
            && self.time_offset_s.is_finite()
            && self.imu_from_base.is_finite()
    }
}
