//! What the IMU says of consecutive views: preintegrated readings between them.

use estimator::EstimatorConfig;
use estimator::imu::ImuBuffer;
use estimator::preintegration::PreintegratedImu;
use estimator::propagation::{IMU_DIM, ImuMatrix, ImuState};
use geometry::pose::Pose;
use geometry::rotation::skew;
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, SVector, Vector3};
use sensors::ImuSample;

use super::layout::{MOTION, StateLayout};
use super::normal_equations::NormalEquations;

/// How far the first and the last reading of an interval may be extrapolated (ns): a few periods of any IMU.
pub(super) const IMU_SLACK_NS: i64 = 20_000_000;
/// Weak priors of every motion (m/s, rad/s, m/s^2), far beyond what a robot does: they keep the equations regular where
/// readings are missing.
const MOTION_SIGMAS: [f64; 3] = [50.0, 1.0, 5.0];

/// Velocity and biases of a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motion {
    /// Velocity of the IMU in G (m/s).
    pub(super) velocity: Vector3<f64>,
    /// Bias of the gyroscope (rad/s).
    pub(super) gyroscope_bias: Vector3<f64>,
    /// Bias of the accelerometer (m/s^2).
    pub(super) accelerometer_bias: Vector3<f64>,
}

impl Motion {
    /// Of an IMU state.
    pub(super) fn of(state: &ImuState) -> Motion {
        let ImuState { velocity, gyroscope_bias, accelerometer_bias, .. } = *state;
        Motion { velocity, gyroscope_bias, accelerometer_bias }
    }

    /// Adds an error `[δv, δb_g, δb_a]`.
    pub(super) fn retract(&self, error: &SVector<f64, MOTION>) -> Motion {
        Motion {
            velocity: self.velocity + error.fixed_rows::<3>(0),
            gyroscope_bias: self.gyroscope_bias + error.fixed_rows::<3>(3),
            accelerometer_bias: self.accelerometer_bias + error.fixed_rows::<3>(6),
        }
    }

    /// As one vector.
    fn vector(&self) -> SVector<f64, MOTION> {
        let mut vector = SVector::<f64, MOTION>::zeros();
        vector.fixed_rows_mut::<3>(0).copy_from(&self.velocity);
        vector.fixed_rows_mut::<3>(3).copy_from(&self.gyroscope_bias);
        vector.fixed_rows_mut::<3>(6).copy_from(&self.accelerometer_bias);
        vector
    }
}

/// The readings between consecutive views. G has z up.
pub(super) struct InertialChain {
    /// Begin of the interval, which ends at the next view, and its readings.
    intervals: Vec<(usize, PreintegratedImu)>,
    imu_from_camera: Pose,
    /// Mean and standard deviations of the biases at the first view.
    first: (Motion, SVector<f64, MOTION>),
}

impl InertialChain {
    /// Preintegrates the readings between views. Intervals that the readings do not cover are left out.
    ///
    /// # Arguments
    /// * `stamps_ns`: of the views, on the clock of the IMU.
    /// * `motions`: of the views; the readings are integrated with their biases, those of the first view are the prior.
    pub(super) fn new(
        readings: &ImuBuffer,
        stamps_ns: &[i64],
        motions: &[Motion],
        imu_from_camera: Pose,
        config: &EstimatorConfig,
    ) -> InertialChain {
        let interval = |(begin, ends): (usize, &[i64])| {
            let between = readings.interval(ends[0], ends[1], IMU_SLACK_NS).ok()?;
            let Motion { gyroscope_bias, accelerometer_bias, .. } = motions[begin];
            let preintegrated =
                PreintegratedImu::new(&between, &gyroscope_bias, &accelerometer_bias, config)?;
            Some((begin, preintegrated))
        };
        let initial = &config.initial;
        let mut sigmas = SVector::<f64, MOTION>::repeat(MOTION_SIGMAS[0]);
        sigmas.fixed_rows_mut::<3>(3).fill(initial.sigma_gyroscope_bias_rad_s);
        sigmas.fixed_rows_mut::<3>(6).fill(initial.sigma_accelerometer_bias_m_s2);
        InertialChain {
            intervals: stamps_ns.windows(2).enumerate().filter_map(interval).collect(),
            imu_from_camera,
            first: (motions[0], sigmas),
        }
    }

    fn imu_state(&self, global_from_camera: &Pose, motion: &Motion) -> ImuState {
        let Motion { velocity, gyroscope_bias, accelerometer_bias } = *motion;
        let local_from_imu = global_from_camera.compose(&self.imu_from_camera.inverse());
        ImuState { local_from_imu, velocity, gyroscope_bias, accelerometer_bias }
    }

    /// The error of an IMU state by that of the camera's pose and the motion: through the lever arm,
    /// `δp_imu = δp_camera + [R p]x δθ` with the camera at `p` in the IMU's frame.
    fn by_camera(&self, state: &ImuState) -> ImuMatrix {
        let lever = state.local_from_imu.rotation * self.imu_from_camera.translation;
        let mut jacobian = ImuMatrix::identity();
        jacobian.fixed_view_mut::<3, 3>(3, 0).copy_from(&skew(&lever));
        jacobian
    }

    /// The deviations of all motions from their priors: the view, its error in sigmas squared and the inverse variances.
    fn priors<'a>(
        &'a self,
        motions: &'a [Motion],
    ) -> impl Iterator<Item = (usize, SVector<f64, MOTION>, SVector<f64, MOTION>)> + 'a {
        let weak = SVector::<f64, MOTION>::from_fn(|row, _| MOTION_SIGMAS[row / 3].powi(-2));
        motions.iter().enumerate().map(move |(view, motion)| {
            if view == 0 {
                let (mean, sigmas) = &self.first;
                (view, motion.vector() - mean.vector(), sigmas.map(|sigma| sigma.powi(-2)))
            } else {
                (view, motion.vector(), weak)
            }
        })
    }

    /// The factor on the noise of the IMU by which its readings would fit the bundle: more than 1 where they fit worse than
    /// stated, and less than 1 where the images leave them freedom.
    ///
    /// Six of the fifteen residuals of an interval are left when velocities and biases are estimated.
    pub(super) fn noise_scale(&self, poses: &[Pose], motions: &[Motion]) -> f64 {
        if self.intervals.is_empty() {
            return 1.0;
        }
        let squares: f64 =
            self.intervals.iter().map(|interval| 2.0 * self.interval_cost(interval, poses, motions)).sum();
        (squares / (6.0 * self.intervals.len() as f64)).sqrt()
    }

    fn interval_cost(
        &self,
        (view, interval): &(usize, PreintegratedImu),
        poses: &[Pose],
        motions: &[Motion],
    ) -> f64 {
        let [begin, end] = [*view, view + 1].map(|at| self.imu_state(&poses[at], &motions[at]));
        let residual = interval.residual(&begin, &end);
        0.5 * residual.dot(&(interval.information * residual))
    }

    /// Half the sum of the squared residuals, in standard deviations.
    pub(super) fn cost(&self, poses: &[Pose], motions: &[Motion]) -> f64 {
        let of_interval = |interval: &(usize, PreintegratedImu)| self.interval_cost(interval, poses, motions);
        let priors = self
            .priors(motions)
            .map(|(_, error, information)| 0.5 * error.component_mul(&error).dot(&information));
        self.intervals.iter().map(of_interval).sum::<f64>() + priors.sum::<f64>()
    }

    /// Adds the linearized residuals.
    pub(super) fn add_to(
        &self,
        equations: &mut NormalEquations,
        layout: StateLayout,
        poses: &[Pose],
        motions: &[Motion],
    ) {
        for (view, interval) in &self.intervals {
            let [begin, end] = [*view, view + 1].map(|at| self.imu_state(&poses[at], &motions[at]));
            let linearized = interval.linearize(&begin, &end);
            let mut jacobian = DMatrix::zeros(IMU_DIM, 2 * IMU_DIM);
            let by_begin = linearized.wrt_begin * self.by_camera(&begin);
            let by_end = linearized.wrt_end * self.by_camera(&end);
            jacobian.view_mut((0, 0), (IMU_DIM, IMU_DIM)).copy_from(&by_begin);
            jacobian.view_mut((0, IMU_DIM), (IMU_DIM, IMU_DIM)).copy_from(&by_end);
            let information = DMatrix::from_column_slice(IMU_DIM, IMU_DIM, interval.information.as_slice());
            let residual = DVector::from_column_slice(linearized.residual.as_slice());
            let indices = layout.state(*view).chain(layout.state(view + 1)).collect();
            equations.add_residual(indices, &jacobian, &information, &residual);
        }
        for (view, error, information) in self.priors(motions) {
            let information = DMatrix::from_diagonal(&DVector::from_column_slice(information.as_slice()));
            let residual = DVector::from_column_slice(error.as_slice());
            let identity = DMatrix::identity(MOTION, MOTION);
            equations.add_residual(layout.motion(view).collect(), &identity, &information, &residual);
        }
    }
}

/// All readings of a recording. Those that are not finite or not newer than the one before are left out.
pub(super) fn buffered(readings: &[ImuSample]) -> ImuBuffer {
    let mut buffer = ImuBuffer::default();
    for reading in readings {
        // The odometry has counted and named them.
        let _ = buffer.push(*reading);
    }
    buffer
}

/// Yaw and position of a pose: the part of it that neither images nor IMU see, as a block of information.
pub(super) fn gauge_information(sigma_yaw_rad: f64, sigma_tilt_rad: f64, sigma_p_m: f64) -> Matrix6<f64> {
    let mut information = Matrix6::zeros();
    let tilt = sigma_tilt_rad.powi(-2);
    let rotation = Matrix3::from_diagonal(&Vector3::new(tilt, tilt, sigma_yaw_rad.powi(-2)));
    information.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    information.fixed_view_mut::<3, 3>(3, 3).fill_diagonal(sigma_p_m.powi(-2));
    information
}
