//! Motion of the IMU at one time, and its prediction by readings that the filter has not used yet.

use crate::imu::plausibility::ReadingCheck;
use crate::propagation::{GYROSCOPE_BIAS, ImuMatrix, ImuState, Propagation, VELOCITY};
use geometry::{PoseWithCovariance, rotation};
use nalgebra::{Matrix6, SMatrix, Vector3};
use types::ImuNoise;
use types::ImuSample;

/// Pose, velocity and angular velocity of the IMU, with the covariance of their errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Time by the IMU's clock, nanoseconds.
    pub stamp_ns: i64,
    /// Pose, velocity and biases in L.
    pub state: ImuState,
    /// 15x15, of the error of `state`: see [`propagation`](crate::propagation).
    pub covariance: ImuMatrix,
    /// Angular velocity in the IMU's frame, bias removed, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// Variance of the gyroscope's white noise in it, each axis, (rad/s)^2. The bias's error comes on top.
    pub angular_velocity_variance: f64,
}

impl Motion {
    pub(crate) fn new(
        stamp_ns: i64,
        state: ImuState,
        covariance: &ImuMatrix,
        rate: &AngularRate,
        noise: &ImuNoise,
    ) -> Self {
        Self {
            stamp_ns,
            state,
            covariance: *covariance,
            angular_velocity: rate.gyroscope - state.gyroscope_bias,
            angular_velocity_variance: noise.gyroscope.powi(2) * rate.bandwidth_hz,
        }
    }

    /// IMU pose in L, with the covariance of its error `[δθ, δp]` in L (rad, metres).
    pub fn local_from_imu(&self) -> PoseWithCovariance {
        let covariance = self.covariance.fixed_view::<6, 6>(0, 0).into_owned();
        PoseWithCovariance { pose: self.state.local_from_imu, covariance }
    }

    /// Covariance of the linear velocity of a point of the body (m/s), then of the angular velocity (rad/s), both in
    /// the axes of the IMU.
    ///
    /// # Arguments
    /// * `point`: in the IMU's frame, metres.
    pub fn twist_covariance(&self, point: &Vector3<f64>) -> Matrix6<f64> {
        // u = Rᵀ v + ω x point, with the errors of the state and ω's -(δb_g + n).
        let imu_from_local = self.state.local_from_imu.rotation.inverse().to_rotation_matrix().into_inner();
        let lever = rotation::skew(point);
        let mut jacobian = SMatrix::<f64, 6, 15>::zeros();
        let by_rotation = imu_from_local * rotation::skew(&self.state.velocity);
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_rotation);
        jacobian.fixed_view_mut::<3, 3>(0, VELOCITY).copy_from(&imu_from_local);
        let mut by_rate = SMatrix::<f64, 6, 3>::zeros();
        by_rate.fixed_view_mut::<3, 3>(0, 0).copy_from(&-lever);
        by_rate.fixed_view_mut::<3, 3>(3, 0).fill_with_identity();
        jacobian.fixed_view_mut::<6, 3>(0, GYROSCOPE_BIAS).copy_from(&-by_rate);
        jacobian * self.covariance * jacobian.transpose()
            + by_rate * by_rate.transpose() * self.angular_velocity_variance
    }
}

/// What the gyroscope measured at one time.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct AngularRate {
    /// Angular velocity with its bias, rad/s.
    pub(crate) gyroscope: Vector3<f64>,
    /// Readings a second, over which the white noise spreads.
    bandwidth_hz: f64,
}

impl AngularRate {
    /// At the end of an interval.
    pub(crate) fn at_end(readings: &[ImuSample]) -> Self {
        let [first, .., last] = readings else { return Self::default() };
        let seconds = (last.stamp_ns - first.stamp_ns) as f64 * 1e-9;
        let bandwidth_hz = if seconds > 0.0 { (readings.len() - 1) as f64 / seconds } else { 0.0 };
        Self { gyroscope: last.gyroscope, bandwidth_hz }
    }
}

/// Integrates readings from the newest state on, beside the filter.
///
/// The result at a time is what [`Estimator::time_update`](crate::Estimator::time_update) to that time would make of the
/// same readings. [`Estimator::predictor`](crate::Estimator::predictor) makes one.
///
/// # Example
/// ```
/// # use estimator::*;
/// # fn fast(estimator: &Estimator, readings: &[ImuSample]) {
/// let mut predictor = estimator.predictor();
/// for reading in readings {
///     if let Some(motion) = predictor.add(*reading) {
///         println!("{} {}", motion.stamp_ns, motion.state.local_from_imu.translation);
///     }
/// }
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct MotionPredictor {
    stamp_ns: i64,
    covariance: ImuMatrix,
    propagation: Propagation,
    noise: ImuNoise,
    newest: Option<ImuSample>,
    check: ReadingCheck,
}

impl MotionPredictor {
    /// # Arguments
    /// * `check`: of the readings that come after the last one at or before the state's time.
    pub(crate) fn new(
        stamp_ns: i64,
        covariance: &ImuMatrix,
        propagation: Propagation,
        noise: ImuNoise,
        check: ReadingCheck,
    ) -> Self {
        Self { stamp_ns, covariance: *covariance, propagation, noise, newest: check.newest(), check }
    }

    /// Time of the state from which is predicted, nanoseconds.
    pub fn state_ns(&self) -> i64 {
        self.stamp_ns
    }

    /// Takes the next reading. The last one at or before the state's time belongs to them: between it and the next one the
    /// motion at the state's time is interpolated.
    ///
    /// # Returns
    /// The motion at the reading; `None` for one that is not after the state, or that the filter would refuse.
    pub fn add(&mut self, reading: ImuSample) -> Option<Motion> {
        self.check.check(&reading).ok()?;
        let before = self.newest.replace(reading);
        if reading.stamp_ns <= self.stamp_ns {
            return None;
        }
        let from = match before {
            None => ImuSample { stamp_ns: self.stamp_ns, ..reading },
            Some(before) if before.stamp_ns < self.stamp_ns => {
                ImuSample::between(&before, &reading, self.stamp_ns)
            }
            Some(before) => before,
        };
        let spacing_ns = before.map_or(0, |before| reading.stamp_ns - before.stamp_ns);
        self.propagation.step_within(&from, &reading, spacing_ns);
        let propagated = self.propagation.end();
        let transition = &propagated.transition;
        let covariance = transition * self.covariance * transition.transpose() + propagated.noise;
        let rate = AngularRate::at_end(&[before.unwrap_or(from), reading]);
        Some(Motion::new(reading.stamp_ns, propagated.state, &covariance, &rate, &self.noise))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::propagation::ImuError;
    use geometry::Pose;

    #[test]
    fn the_covariance_of_the_twist_is_that_of_the_errors_that_cause_it() {
        let pose = Pose::new(rotation::exp(&Vector3::new(0.4, -0.2, 1.1)), Vector3::new(1.0, 2.0, 3.0));
        let state = ImuState {
            local_from_imu: pose,
            velocity: Vector3::new(1.3, -0.4, 0.2),
            gyroscope_bias: Vector3::new(0.02, 0.01, -0.03),
            accelerometer_bias: Vector3::zeros(),
        };
        let (reading, point) = (Vector3::new(0.3, 0.8, -0.5), Vector3::new(0.2, -0.1, 0.4));
        let twist = |state: &ImuState, noise: &Vector3<f64>| {
            let rate = reading - state.gyroscope_bias - noise;
            let linear = state.local_from_imu.rotation.inverse() * state.velocity + rate.cross(&point);
            nalgebra::Vector6::new(linear.x, linear.y, linear.z, rate.x, rate.y, rate.z)
        };
        let (step, zero) = (1e-6, Vector3::zeros());
        let root = ImuMatrix::from_fn(|row, column| {
            ((row * 7 + column * 3) % 5) as f64 * 0.01 + if row == column { 0.2 } else { 0.0 }
        });
        let mut expected = Matrix6::zeros();
        for column in 0..15 {
            let error: ImuError = root.column(column) * step;
            let by =
                (twist(&state.retract(&error), &zero) - twist(&state.retract(&-error), &zero)) / (2.0 * step);
            expected += by * by.transpose();
        }
        let mut noise = ImuNoise::default();
        noise.gyroscope = 0.01;
        for axis in 0..3 {
            let error = Vector3::ith(axis, step);
            let by =
                (twist(&state, &error) - twist(&state, &-error)) / (2.0 * step) * (0.01 * 200_f64.sqrt());
            expected += by * by.transpose();
        }
        let rate = AngularRate { gyroscope: reading, bandwidth_hz: 200.0 };
        let motion = Motion::new(0, state, &(root * root.transpose()), &rate, &noise);
        let difference = motion.twist_covariance(&point) - expected;
        assert!(difference.amax() < 1e-7, "{difference}");
    }
}
