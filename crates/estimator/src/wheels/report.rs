//! What wheel odometry did, and what it found.

use super::calibration::WheelCalibration;
use nalgebra::DMatrix;
use serde::Serialize;
use std::collections::BTreeMap;
use types::BaseKind;

/// Counts of intervals between two images, and of readings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct WheelCounts {
    /// Intervals that corrected the state.
    pub used: usize,
    /// Intervals that the gate rejected: slip.
    pub slipped: usize,
    /// Intervals whose motion sideways or off the floor the gate rejected.
    pub off_track: usize,
    /// Intervals while the wheels were left out.
    pub left_out: usize,
    /// Intervals without readings.
    pub missing: usize,
    /// Readings that were refused.
    pub refused_readings: usize,
}

/// An estimated number with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimated {
    /// The estimate.
    pub value: f64,
    /// Its standard deviation, of the same unit.
    pub sigma: f64,
}

/// What wheel odometry did, and the calibration that it found.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct WheelReport {
    /// What the base is.
    pub base: BaseKind,
    /// Intervals and readings.
    pub counts: WheelCounts,
    /// Its geometry, by the names of [`WheelBase::parameter_names`](types::WheelBase::parameter_names), which have the units.
    #[serde(flatten)]
    pub geometry: BTreeMap<&'static str, Estimated>,
    /// Added to the stamp of a reading to obtain the IMU's time, seconds.
    pub time_offset_s: Estimated,
    /// Origin of the base in the IMU frame, metres.
    pub base_position_m: [Estimated; 3],
    /// Rotation vector of `imu_from_base`, rad; its standard deviations are those of `δθ` in the IMU's frame.
    pub base_rotation_rad: [Estimated; 3],
}

impl WheelReport {
    /// Of a calibration with the covariance of its error.
    pub(crate) fn new(counts: WheelCounts, learned: &LearnedWheels) -> Self {
        let LearnedWheels { calibration, covariance } = learned;
        let estimated = |value: f64, k: usize| Estimated { value, sigma: covariance[(k, k)].max(0.0).sqrt() };
        let turn = geometry::rotation::log(&calibration.imu_from_base.rotation);
        let position = calibration.imu_from_base.translation;
        let (base, extrinsics) = (&calibration.base, calibration.extrinsics());
        let values = base.parameters().into_iter().enumerate().map(|(k, value)| estimated(value, k));
        Self {
            base: base.kind(),
            counts,
            geometry: base.parameter_names().iter().copied().zip(values).collect(),
            time_offset_s: estimated(calibration.time_offset_s, calibration.clock()),
            base_position_m: std::array::from_fn(|k| estimated(position[k], extrinsics + 3 + k)),
            base_rotation_rad: std::array::from_fn(|k| estimated(turn[k], extrinsics + k)),
        }
    }
}

/// A calibration of the wheels as a filter learned it, for another filter of the same robot.
#[derive(Clone, Debug, PartialEq)]
pub struct LearnedWheels {
    /// The estimate.
    pub(crate) calibration: WheelCalibration,
    /// Covariance of its error.
    pub(crate) covariance: DMatrix<f64>,
}

impl LearnedWheels {
    /// The same calibration with larger standard deviations, each up to that of another one; correlations are kept.
    pub(crate) fn widened(mut self, factor: f64, up_to: &LearnedWheels) -> LearnedWheels {
        let dim = self.covariance.nrows().min(up_to.covariance.nrows());
        let scales: Vec<f64> = (0..dim)
            .map(|k| {
                let most = (up_to.covariance[(k, k)] / self.covariance[(k, k)].max(f64::MIN_POSITIVE)).sqrt();
                factor.min(most).max(1.0)
            })
            .collect();
        for row in 0..dim {
            for column in 0..dim {
                self.covariance[(row, column)] *= scales[row] * scales[column];
            }
        }
        self
    }
}
