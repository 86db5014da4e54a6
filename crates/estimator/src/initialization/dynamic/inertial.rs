//! What the readings between two images say of the states at both, integrated once (preintegration).
//!
//! In the axes of the body at the begin the readings integrate to a turn `ΔR`, a gain of velocity `Δv` and
//! a way `Δp` that do not depend on the states, only a little on the biases:
//! ```text
//! r_θ = Log(R_iᵀ R_j ΔRᵀ Exp(-F_θ δb))
//! r_p = R_iᵀ (p_j - p_i - v_i T - g T^2 / 2) - Δp - F_p δb
//! r_v = R_iᵀ (v_j - v_i - g T) - Δv - F_v δb
//! r_b = b_j - b_i
//! ```
//! Their covariance is the noise of the readings, the walk of the biases included.
//!
//! Source: Forster, Carlone, Dellaert & Scaramuzza, T-RO 2017.

use crate::config::EstimatorConfig;
use crate::imu::ImuSample;
use crate::propagation::{
    ACCELEROMETER_BIAS, GYROSCOPE_BIAS, IMU_DIM, ImuMatrix, ImuState, MotionEstimate, Propagated, VELOCITY,
    propagate,
};
use geometry::Pose;
use geometry::rotation::{exp, left_jacobian_inverse, log, right_jacobian, right_jacobian_inverse, skew};
use nalgebra::{Matrix3, SVector, Vector3};

/// An error of the IMU state, or a residual over it.
pub type ImuError = SVector<f64, IMU_DIM>;

/// The state with an error added.
pub fn moved(state: &ImuState, error: &ImuError) -> ImuState {
    ImuState {
        local_from_imu: state.local_from_imu.retract(&error.fixed_rows::<6>(0).into()),
        velocity: state.velocity + error.fixed_rows::<3>(VELOCITY),
        gyroscope_bias: state.gyroscope_bias + error.fixed_rows::<3>(GYROSCOPE_BIAS),
        accelerometer_bias: state.accelerometer_bias + error.fixed_rows::<3>(ACCELEROMETER_BIAS),
    }
}

/// The readings of one interval.
#[derive(Clone, Debug)]
pub struct Interval {
    seconds: f64,
    gravity: Vector3<f64>,
    /// From a body at rest in the origin without gravity; its axes are those of the body at the begin.
    integrated: Propagated,
    /// Inverse of the noise.
    pub information: ImuMatrix,
}

/// A linearized interval.
#[derive(Clone, Copy, Debug)]
pub struct IntervalRow {
    /// From the predicted to the believed state at the end, in the axes of the body at the begin.
    pub residual: ImuError,
    /// Derivative of the residual by the error of the state at the begin.
    pub by_begin: ImuMatrix,
    /// The same at the end.
    pub by_end: ImuMatrix,
}

impl Interval {
    /// Integrates readings with the biases that are believed so far.
    ///
    /// # Returns
    /// `None` where the noise is not positive definite.
    pub fn new(
        readings: &[ImuSample],
        gyroscope_bias: &Vector3<f64>,
        accelerometer_bias: &Vector3<f64>,
        config: &EstimatorConfig,
    ) -> Option<Self> {
        let zero = Vector3::zeros();
        let rest = ImuState {
            local_from_imu: Pose::identity(),
            velocity: zero,
            gyroscope_bias: *gyroscope_bias,
            accelerometer_bias: *accelerometer_bias,
        };
        let motion = MotionEstimate { position: zero, velocity: zero };
        let integrated = propagate(&rest, &motion, readings, &config.imu_noise, 0.0);
        let seconds = (readings.last()?.stamp_ns - readings.first()?.stamp_ns) as f64 * 1e-9;
        let information = integrated.noise.cholesky()?.inverse();
        Some(Self { seconds, gravity: Vector3::new(0.0, 0.0, -config.gravity), integrated, information })
    }

    /// How the turn, the way and the gain of velocity depend on a bias; `row` is the state's, `column` the bias's.
    fn by_bias(&self, row: usize, column: usize) -> Matrix3<f64> {
        self.integrated.transition.fixed_view::<3, 3>(row, column).into()
    }

    /// What the states at both ends leave unexplained.
    pub fn residual(&self, begin: &ImuState, end: &ImuState) -> ImuError {
        let to_begin = begin.local_from_imu.rotation.inverse();
        let done = &self.integrated.state;
        let gyroscope = begin.gyroscope_bias - done.gyroscope_bias;
        let accelerometer = begin.accelerometer_bias - done.accelerometer_bias;
        let shift = |row| {
            self.by_bias(row, GYROSCOPE_BIAS) * gyroscope
                + self.by_bias(row, ACCELEROMETER_BIAS) * accelerometer
        };
        let turned = to_begin * end.local_from_imu.rotation * done.local_from_imu.rotation.inverse();
        let (way, gain) = self.way_and_gain(begin, end);
        let mut residual = ImuError::zeros();
        residual.fixed_rows_mut::<3>(0).copy_from(&log(&(turned * exp(&-shift(0)))));
        residual
            .fixed_rows_mut::<3>(3)
            .copy_from(&(to_begin * way - done.local_from_imu.translation - shift(3)));
        residual
            .fixed_rows_mut::<3>(VELOCITY)
            .copy_from(&(to_begin * gain - done.velocity - shift(VELOCITY)));
        residual.fixed_rows_mut::<3>(GYROSCOPE_BIAS).copy_from(&(end.gyroscope_bias - begin.gyroscope_bias));
        let walk = end.accelerometer_bias - begin.accelerometer_bias;
        residual.fixed_rows_mut::<3>(ACCELEROMETER_BIAS).copy_from(&walk);
        residual
    }

    /// Way and gain of velocity that the readings must explain, in L.
    fn way_and_gain(&self, begin: &ImuState, end: &ImuState) -> (Vector3<f64>, Vector3<f64>) {
        let t = self.seconds;
        let way = end.local_from_imu.translation
            - begin.local_from_imu.translation
            - begin.velocity * t
            - self.gravity * (0.5 * t * t);
        (way, end.velocity - begin.velocity - self.gravity * t)
    }

    /// The residual with its derivatives.
    pub fn linearize(&self, begin: &ImuState, end: &ImuState) -> IntervalRow {
        let residual = self.residual(begin, end);
        let to_begin = begin.local_from_imu.rotation.inverse().to_rotation_matrix().into_inner();
        let turned = residual.fixed_rows::<3>(0).into_owned();
        let (way, gain) = self.way_and_gain(begin, end);
        let turn_by_bias = self.by_bias(0, GYROSCOPE_BIAS);
        let bias_turn = turn_by_bias * (begin.gyroscope_bias - self.integrated.state.gyroscope_bias);
        let left = left_jacobian_inverse(&turned) * to_begin;

        let (mut by_begin, mut by_end) = (ImuMatrix::zeros(), ImuMatrix::zeros());
        let put = |matrix: &mut ImuMatrix, row: usize, column: usize, block: Matrix3<f64>| {
            matrix.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        };
        put(&mut by_end, 0, 0, left);
        put(&mut by_begin, 0, 0, -left);
        let by_gyroscope = right_jacobian_inverse(&turned) * right_jacobian(&-bias_turn) * turn_by_bias;
        put(&mut by_begin, 0, GYROSCOPE_BIAS, -by_gyroscope);
        for (row, moved) in [(3, way), (VELOCITY, gain)] {
            put(&mut by_end, row, row, to_begin);
            put(&mut by_begin, row, row, -to_begin);
            put(&mut by_begin, row, 0, to_begin * skew(&moved));
            put(&mut by_begin, row, GYROSCOPE_BIAS, -self.by_bias(row, GYROSCOPE_BIAS));
            put(&mut by_begin, row, ACCELEROMETER_BIAS, -self.by_bias(row, ACCELEROMETER_BIAS));
        }
        put(&mut by_begin, 3, VELOCITY, to_begin * -self.seconds);
        for bias in [GYROSCOPE_BIAS, ACCELEROMETER_BIAS] {
            put(&mut by_end, bias, bias, Matrix3::identity());
            put(&mut by_begin, bias, bias, -Matrix3::identity());
        }
        IntervalRow { residual, by_begin, by_end }
    }
}
