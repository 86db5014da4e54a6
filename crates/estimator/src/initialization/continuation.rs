//! L goes on after a divergence: from the last pose that was trusted, as uncertain as what may have happened since.

use super::static_init::{InitialState, yaw_between};
use geometry::{Pose, PoseWithCovariance, rotation};
use nalgebra::Vector3;
use types::ImuSample;

/// Speed of a body that something else moves, m/s: of who carries it, or a lift.
const CARRIED_SPEED_M_S: f64 = 1.5;
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
}

impl Continuation {
    pub(super) fn of(last: &LastTrustedPose) -> Self {
        let rotation = last.local_from_imu.pose.rotation;
        Self { last: *last, rotation, propagated_ns: last.stamp_ns }
    }

    /// Turns it by what the gyroscope measured between two readings.
    pub(super) fn propagate(&mut self, previous: &ImuSample, reading: &ImuSample) {
        let seconds = (reading.stamp_ns - previous.stamp_ns.max(self.propagated_ns)) as f64 * 1e-9;
        if seconds > 0.0 {
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
        placed.covariance[(2, 2)] += last.covariance[(2, 2)] + (YAW_DRIFT_RAD_S * seconds).powi(2);
        for k in 3..6 {
            placed.covariance[(k, k)] += last.covariance[(k, k)] + moved * moved;
        }
        placed
    }
}
