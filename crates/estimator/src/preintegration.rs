//! IMU preintegration between two images.
//!
//! In the frame of the body at the begin the samples integrate to a rotation `ΔR`, a velocity change `Δv` and a position
//! change `Δp` that do not depend on the states, and to first order on the biases:
//! ```text
//! r_θ = Log(R_iᵀ R_j ΔRᵀ Exp(-F_θ δb))
//! r_p = R_iᵀ (p_j - p_i - v_i T - g T^2 / 2) - Δp - F_p δb
//! r_v = R_iᵀ (v_j - v_i - g T) - Δv - F_v δb
//! r_b = b_j - b_i
//! ```
//! Their covariance is the noise of the samples, the random walk of the biases included.
//!
//! Source: Forster, Carlone, Dellaert & Scaramuzza, T-RO 2017.

use crate::config::EstimatorConfig;
use crate::propagation::{
    ACCELEROMETER_BIAS, GYROSCOPE_BIAS, ImuError, ImuMatrix, ImuState, MotionEstimate, Propagated, VELOCITY,
    propagate,
};
use geometry::rotation::{exp, left_jacobian_inverse, log, right_jacobian, right_jacobian_inverse, skew};
use nalgebra::{Matrix3, Vector3};
use types::ImuSample;

/// The preintegrated samples of one interval.
#[derive(Clone, Debug)]
pub struct PreintegratedImu {
    seconds: f64,
    gravity: Vector3<f64>,
    /// Propagated from rest at the origin without gravity; its axes are those of the body at the begin.
    integrated: Propagated,
    /// Inverse of the noise covariance.
    pub information: ImuMatrix,
}

/// A linearized residual.
#[derive(Clone, Copy, Debug)]
pub struct LinearizedInterval {
    /// Estimated minus predicted state at the end, in the frame of the body at the begin.
    pub residual: ImuError,
    /// Jacobian of the residual with respect to the error of the state at the begin.
    pub wrt_begin: ImuMatrix,
    /// The same for the state at the end.
    pub wrt_end: ImuMatrix,
}

impl PreintegratedImu {
    /// Integrates samples with given biases.
    ///
    /// # Returns
    /// `None` where the noise is not positive definite.
    pub fn new(
        readings: &[ImuSample],
        gyroscope_bias: &Vector3<f64>,
        accelerometer_bias: &Vector3<f64>,
        config: &EstimatorConfig,
    ) -> Option<Self> {
        let rest = ImuState::at_rest(*gyroscope_bias, *accelerometer_bias);
        let integrated = propagate(&rest, &MotionEstimate::of(&rest), readings, &config.imu_noise, 0.0);
        let seconds = (readings.last()?.stamp_ns - readings.first()?.stamp_ns) as f64 * 1e-9;
        let information = integrated.noise.cholesky()?.inverse();
        Some(Self { seconds, gravity: Vector3::new(0.0, 0.0, -config.gravity), integrated, information })
    }

    /// Block of the transition: rotation, position or velocity change (`row`) with respect to a bias (`column`).
    fn wrt_bias(&self, row: usize, column: usize) -> Matrix3<f64> {
        self.integrated.transition.fixed_view::<3, 3>(row, column).into()
    }

    /// The residual `[r_θ, r_p, r_v, r_bg, r_ba]`.
    pub fn residual(&self, begin: &ImuState, end: &ImuState) -> ImuError {
        let to_begin = begin.local_from_imu.rotation.inverse();
        let integrated = &self.integrated.state;
        let gyroscope = begin.gyroscope_bias - integrated.gyroscope_bias;
        let accelerometer = begin.accelerometer_bias - integrated.accelerometer_bias;
        let shift = |row| {
            self.wrt_bias(row, GYROSCOPE_BIAS) * gyroscope
                + self.wrt_bias(row, ACCELEROMETER_BIAS) * accelerometer
        };
        let rotation_error =
            to_begin * end.local_from_imu.rotation * integrated.local_from_imu.rotation.inverse();
        let (position_change, velocity_change) = self.position_and_velocity_change(begin, end);
        let mut residual = ImuError::zeros();
        residual.fixed_rows_mut::<3>(0).copy_from(&log(&(rotation_error * exp(&-shift(0)))));
        residual
            .fixed_rows_mut::<3>(3)
            .copy_from(&(to_begin * position_change - integrated.local_from_imu.translation - shift(3)));
        residual
            .fixed_rows_mut::<3>(VELOCITY)
            .copy_from(&(to_begin * velocity_change - integrated.velocity - shift(VELOCITY)));
        residual.fixed_rows_mut::<3>(GYROSCOPE_BIAS).copy_from(&(end.gyroscope_bias - begin.gyroscope_bias));
        let walk = end.accelerometer_bias - begin.accelerometer_bias;
        residual.fixed_rows_mut::<3>(ACCELEROMETER_BIAS).copy_from(&walk);
        residual
    }

    /// Changes of position and velocity between the states without gravity, in L.
    fn position_and_velocity_change(&self, begin: &ImuState, end: &ImuState) -> (Vector3<f64>, Vector3<f64>) {
        let t = self.seconds;
        let position_change = end.local_from_imu.translation
            - begin.local_from_imu.translation
            - begin.velocity * t
            - self.gravity * (0.5 * t * t);
        (position_change, end.velocity - begin.velocity - self.gravity * t)
    }

    /// The residual with its Jacobians.
    pub fn linearize(&self, begin: &ImuState, end: &ImuState) -> LinearizedInterval {
        let residual = self.residual(begin, end);
        let to_begin = begin.local_from_imu.rotation.inverse().to_rotation_matrix().into_inner();
        let rotation_residual = residual.fixed_rows::<3>(0).into_owned();
        let (position_change, velocity_change) = self.position_and_velocity_change(begin, end);
        let rotation_wrt_bias = self.wrt_bias(0, GYROSCOPE_BIAS);
        let bias_rotation = rotation_wrt_bias * (begin.gyroscope_bias - self.integrated.state.gyroscope_bias);
        let left = left_jacobian_inverse(&rotation_residual) * to_begin;

        let (mut wrt_begin, mut wrt_end) = (ImuMatrix::zeros(), ImuMatrix::zeros());
        let put = |matrix: &mut ImuMatrix, row: usize, column: usize, block: Matrix3<f64>| {
            matrix.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        };
        put(&mut wrt_end, 0, 0, left);
        put(&mut wrt_begin, 0, 0, -left);
        let wrt_gyroscope_bias =
            right_jacobian_inverse(&rotation_residual) * right_jacobian(&-bias_rotation) * rotation_wrt_bias;
        put(&mut wrt_begin, 0, GYROSCOPE_BIAS, -wrt_gyroscope_bias);
        for (row, change) in [(3, position_change), (VELOCITY, velocity_change)] {
            put(&mut wrt_end, row, row, to_begin);
            put(&mut wrt_begin, row, row, -to_begin);
            put(&mut wrt_begin, row, 0, to_begin * skew(&change));
            put(&mut wrt_begin, row, GYROSCOPE_BIAS, -self.wrt_bias(row, GYROSCOPE_BIAS));
            put(&mut wrt_begin, row, ACCELEROMETER_BIAS, -self.wrt_bias(row, ACCELEROMETER_BIAS));
        }
        put(&mut wrt_begin, 3, VELOCITY, to_begin * -self.seconds);
        for bias in [GYROSCOPE_BIAS, ACCELEROMETER_BIAS] {
            put(&mut wrt_end, bias, bias, Matrix3::identity());
            put(&mut wrt_begin, bias, bias, -Matrix3::identity());
        }
        LinearizedInterval { residual, wrt_begin, wrt_end }
    }
}
