//! What the IMU says of consecutive views of an adjustment: preintegrated readings between them.

use crate::config::EstimatorConfig;
use crate::preintegration::PreintegratedImu;
use crate::propagation::{IMU_DIM, ImuMatrix, ImuState};
use adjustment::{Bundle, Factor, MOTION, NormalEquations, ViewMotion};
use geometry::Pose;
use geometry::rotation::skew;
use nalgebra::{SMatrix, SVector};

/// Standard deviations of velocity and biases that hardly say anything, far beyond what a robot does (m/s, rad/s, m/s^2).
const WEAK_SIGMAS: [f64; 3] = [50.0, 1.0, 5.0];

/// The readings between consecutive views. G has z up.
pub struct InertialChain {
    /// Begin of the interval, which ends at the next view, and its readings.
    intervals: Vec<(usize, PreintegratedImu)>,
    imu_from_body: Pose,
    /// Mean and inverse variances of the motion of the first view.
    first: (ViewMotion, SVector<f64, MOTION>),
    /// Whether all other motions have a weak prior.
    weak_priors: bool,
}

impl InertialChain {
    /// The readings between views, with a prior of the biases at the first one.
    ///
    /// # Arguments
    /// * `intervals`: the view that each begins at, and its readings up to the next view.
    /// * `first`: mean of the motion of the first view; the standard deviations of the biases are those of the settings.
    /// * `imu_from_body`: of the bodies whose poses are adjusted.
    pub fn new(
        intervals: Vec<(usize, PreintegratedImu)>,
        first: ViewMotion,
        imu_from_body: Pose,
        config: &EstimatorConfig,
    ) -> Self {
        let sigmas = [
            WEAK_SIGMAS[0],
            config.initial.sigma_gyroscope_bias_rad_s,
            config.initial.sigma_accelerometer_bias_m_s2,
        ];
        Self { intervals, imu_from_body, first: (first, inverse_variances(sigmas)), weak_priors: false }
    }

    /// With weak priors of all other motions, around zero: they keep the equations regular where readings are missing.
    #[must_use]
    pub fn with_weak_priors(self) -> Self {
        Self { weak_priors: true, ..self }
    }

    fn imu_state(&self, bundle: &Bundle, view: usize) -> ImuState {
        let global_from_imu = bundle.poses[view].compose(&self.imu_from_body.inverse());
        ImuState::of(global_from_imu, &bundle.motions[view])
    }

    /// The error of an IMU state by that of the body's pose and the motion: through the lever arm,
    /// `δp_imu = δp_body + [R p]x δθ` with the body at `p` in the IMU's frame.
    fn by_body(&self, state: &ImuState) -> ImuMatrix {
        let lever = state.local_from_imu.rotation * self.imu_from_body.translation;
        let mut jacobian = ImuMatrix::identity();
        jacobian.fixed_view_mut::<3, 3>(3, 0).copy_from(&skew(&lever));
        jacobian
    }

    /// The deviations of motions from their priors: the view, its error and the inverse variances.
    fn priors(
        &self,
        motions: &[ViewMotion],
    ) -> impl Iterator<Item = (usize, SVector<f64, MOTION>, SVector<f64, MOTION>)> {
        let count = if self.weak_priors { motions.len() } else { 1 };
        motions.iter().take(count).enumerate().map(move |(view, motion)| {
            if view == 0 {
                let (mean, information) = &self.first;
                (view, motion.vector() - mean.vector(), *information)
            } else {
                (view, motion.vector(), inverse_variances(WEAK_SIGMAS))
            }
        })
    }

    /// The factor on the noise of the IMU by which its readings would fit the bundle: more than 1 where they fit worse than
    /// stated, and less than 1 where the images leave them freedom.
    ///
    /// Six of the fifteen residuals of an interval are left when velocities and biases are estimated.
    pub fn noise_scale(&self, bundle: &Bundle) -> f64 {
        if self.intervals.is_empty() {
            return 1.0;
        }
        let squares: f64 =
            self.intervals.iter().map(|interval| 2.0 * self.interval_cost(interval, bundle)).sum();
        (squares / (6.0 * self.intervals.len() as f64)).sqrt()
    }

    fn interval_cost(&self, (view, interval): &(usize, PreintegratedImu), bundle: &Bundle) -> f64 {
        let [begin, end] = [*view, view + 1].map(|at| self.imu_state(bundle, at));
        let residual = interval.residual(&begin, &end);
        0.5 * residual.dot(&(interval.information * residual))
    }
}

impl Factor for InertialChain {
    fn cost(&self, bundle: &Bundle, _scale: f64) -> f64 {
        let priors = self
            .priors(&bundle.motions)
            .map(|(_, error, information)| 0.5 * error.component_mul(&error).dot(&information));
        let intervals = self.intervals.iter().map(|interval| self.interval_cost(interval, bundle));
        intervals.sum::<f64>() + priors.sum::<f64>()
    }

    fn add_to(&self, equations: &mut NormalEquations, bundle: &Bundle, _scale: f64) {
        let layout = bundle.layout();
        for (view, interval) in &self.intervals {
            let [begin, end] = [*view, view + 1].map(|at| self.imu_state(bundle, at));
            let linearized = interval.linearize(&begin, &end);
            let mut jacobian = SMatrix::<f64, IMU_DIM, { 2 * IMU_DIM }>::zeros();
            let by_begin = linearized.wrt_begin * self.by_body(&begin);
            let by_end = linearized.wrt_end * self.by_body(&end);
            jacobian.fixed_columns_mut::<IMU_DIM>(0).copy_from(&by_begin);
            jacobian.fixed_columns_mut::<IMU_DIM>(IMU_DIM).copy_from(&by_end);
            let indices = layout.state(*view).chain(layout.state(view + 1));
            equations.add_residual(indices, &jacobian, &interval.information, &linearized.residual);
        }
        for (view, error, information) in self.priors(&bundle.motions) {
            let information = SMatrix::from_diagonal(&information);
            equations.add_residual(
                layout.motion(view),
                &SMatrix::<f64, MOTION, MOTION>::identity(),
                &information,
                &error,
            );
        }
    }
}

/// Of velocity, bias of the gyroscope and bias of the accelerometer.
fn inverse_variances(sigmas: [f64; 3]) -> SVector<f64, MOTION> {
    SVector::<f64, MOTION>::from_fn(|row, _| sigmas[row / 3].powi(-2))
}
