//! L goes on after a divergence: from the last pose that was trusted, as uncertain as what may have happened since.

use super::static_init::{InitialState, yaw_between};
use crate::propagation::{ImuError, VELOCITY, turn_variance_across_gap};
use geometry::{Pose, PoseWithCovariance, rotation};
use nalgebra::Vector3;
use types::ImuSample;

/// Speed of a body that something else moves, m/s: of who carries it, or a lift.
const CARRIED_SPEED_M_S: f64 = 1.5;
/// Variance of a yaw of which nothing is known, rad^2: all are as likely.
const UNKNOWN_YAW: f64 = std::f64::consts::PI * std::f64::consts::PI / 3.0;
/// Error of the propagated yaw a second, rad: the error of a bias after a temperature shock.
const YAW_DRIFT_RAD_S: f64 = 0.002;

/// The last pose in L before the filter diverged, from which L is continued.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LastTrustedPose {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// IMU pose in L, with the covariance of its error.
    pub local_from_imu: PoseWithCovariance,
    /// Velocity in L, m/s.
    pub velocity: Vector3<f64>,
    /// Gyroscope bias, rad/s, for the propagation of the rotation until the next initialization.
    pub gyroscope_bias: Vector3<f64>,
}

/// The last trusted pose, its rotation propagated with the gyroscope.
#[derive(Clone, Debug)]
pub(super) struct Continuation {
    last: LastTrustedPose,
    rotation: nalgebra::UnitQuaternion<f64>,
    propagated_ns: i64,
    /// Of its yaw, by the gaps in the readings so far, rad^2.
    gap_variance: f64,
}

impl Continuation {
    pub(super) fn of(last: &LastTrustedPose) -> Self {
        let rotation = last.local_from_imu.pose.rotation;
        Self { last: *last, rotation, propagated_ns: last.stamp_ns, gap_variance: 0.0 }
    }

    /// Turns it by what the gyroscope measured between two readings. Where readings are missing it may have turned otherwise.
    pub(super) fn propagate(&mut self, previous: &ImuSample, reading: &ImuSample) {
        let seconds = (reading.stamp_ns - previous.stamp_ns.max(self.propagated_ns)) as f64 * 1e-9;
        if seconds > 0.0 {
            let unmeasured_s = (previous.stamp_ns - self.propagated_ns) as f64 * 1e-9;
            self.gap_variance += turn_variance_across_gap(seconds) + turn_variance_across_gap(unmeasured_s);
            let rate = 0.5 * (previous.gyroscope + reading.gyroscope) - self.last.gyroscope_bias;
            self.rotation *= rotation::exp(&(rate * seconds));
            self.propagated_ns = reading.stamp_ns;
        }
    }

    /// An initial state with position and yaw of the last trusted pose. Since then the body may have gone on at its speed, or
    /// have been carried: filter, images and IMU contradicted each other.
    pub(super) fn place(&self, initial: &InitialState) -> InitialState {
        let last = &self.last.local_from_imu;
        let turn = yaw_between(&initial.imu.local_from_imu.rotation, &self.rotation);
        let mut placed = initial.transformed(&Pose::new(turn, last.pose.translation));
        let seconds = ((initial.stamp_ns - self.last.stamp_ns) as f64 * 1e-9).max(0.0);
        let moved = self.last.velocity.norm().max(CARRIED_SPEED_M_S) * seconds;
        let drifted = last.covariance[(2, 2)] + (YAW_DRIFT_RAD_S * seconds).powi(2) + self.gap_variance;
        let yaw_variance = drifted.min(UNKNOWN_YAW);
        // The velocity is known in the body: in L it turns with the yaw.
        let mut by_yaw = ImuError::zeros();
        by_yaw[2] = 1.0;
        by_yaw.fixed_rows_mut::<3>(VELOCITY).copy_from(&Vector3::z().cross(&placed.imu.velocity));
        placed.covariance += by_yaw * by_yaw.transpose() * yaw_variance;
        for k in 3..6 {
            placed.covariance[(k, k)] += last.covariance[(k, k)] + moved * moved;
        }
        placed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::propagation::{ImuMatrix, ImuState};
    use nalgebra::{Matrix6, UnitQuaternion};

    fn reading(stamp_ms: i64, rate: f64) -> ImuSample {
        ImuSample {
            stamp_ns: stamp_ms * 1_000_000,
            gyroscope: Vector3::z() * rate,
            accelerometer: Vector3::z() * 9.81,
        }
    }

    fn last() -> LastTrustedPose {
        LastTrustedPose {
            stamp_ns: 0,
            local_from_imu: PoseWithCovariance::new(Pose::identity(), Matrix6::identity() * 1e-6),
            velocity: Vector3::zeros(),
            gyroscope_bias: Vector3::zeros(),
        }
    }

    /// The state from which L goes on after readings at some times, of a body that moves.
    fn placed(stamps_ms: &[i64], velocity: Vector3<f64>) -> InitialState {
        let mut continuation = Continuation::of(&last());
        for pair in stamps_ms.windows(2) {
            continuation.propagate(&reading(pair[0], 0.0), &reading(pair[1], 0.0));
        }
        let imu = ImuState {
            local_from_imu: Pose::new(UnitQuaternion::identity(), Vector3::zeros()),
            velocity,
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
        };
        let end_ns = stamps_ms.last().map_or(0, |ms| ms * 1_000_000);
        let initial = InitialState { stamp_ns: end_ns, imu, covariance: ImuMatrix::zeros() };
        continuation.place(&initial)
    }

    /// Standard deviation of the yaw.
    fn sigma_yaw(stamps_ms: &[i64]) -> f64 {
        placed(stamps_ms, Vector3::zeros()).covariance[(2, 2)].sqrt()
    }

    /// What measures the velocity in the body, as images do, says nothing about the yaw in L.
    #[test]
    fn the_velocity_turns_with_the_yaw() {
        let stamps: Vec<i64> = (0..=200).map(|step| 5 * step).chain([2300]).collect();
        let placed = placed(&stamps, Vector3::new(2.0, -1.0, 0.3));
        let (v, covariance) = (placed.imu.velocity, placed.covariance + ImuMatrix::identity() * 1e-6);
        // Along and across in the body: v rotated by minus the error of the rotation.
        let across = Vector3::z().cross(&v).normalize();
        let mut row = ImuError::zeros();
        row.fixed_rows_mut::<3>(0).copy_from(&across.cross(&v));
        row.fixed_rows_mut::<3>(VELOCITY).copy_from(&across);
        let gain = covariance * row / ((row.transpose() * covariance * row)[0] + 0.05 * 0.05);
        let after = covariance - gain * (row.transpose() * covariance);
        assert!(covariance[(2, 2)].sqrt() > 0.6, "{}", covariance[(2, 2)]);
        assert!(after[(2, 2)] > 0.999 * covariance[(2, 2)], "{} {}", after[(2, 2)], covariance[(2, 2)]);
    }

    #[test]
    fn what_turned_while_readings_were_missing_is_not_known() {
        let all: Vec<i64> = (0..=1200).map(|step| 5 * step).collect();
        assert!(sigma_yaw(&all) < 0.02, "{}", sigma_yaw(&all));
        // Five seconds in which a robot may have turned on the spot.
        let with_gap: Vec<i64> = all.iter().copied().filter(|ms| !(500..5500).contains(ms)).collect();
        assert!(sigma_yaw(&with_gap) > 1.5, "{}", sigma_yaw(&with_gap));
        let late: Vec<i64> = all.iter().copied().filter(|ms| *ms >= 5000).collect();
        assert!(sigma_yaw(&late) > 1.5, "{}", sigma_yaw(&late));
    }
}
