//! The normal equations of a window: one block of 15 per image, landmarks eliminated (Schur complement).

use super::landmark_block::{LandmarkBlock, landmark_cost};
use super::problem::{Estimate, Loss, Problem, Step};
use crate::propagation::{ACCELEROMETER_BIAS, GYROSCOPE_BIAS, IMU_DIM, ImuMatrix};
use crate::state::POSE_DIM;
use nalgebra::{DMatrix, DVector, Vector3};

/// The linearized problem. Rows and columns of the newest image are the last.
pub struct NormalEquations {
    matrix: DMatrix<f64>,
    vector: DVector<f64>,
    landmarks: Vec<LandmarkBlock>,
}

impl NormalEquations {
    /// Linearizes the problem at an estimate.
    pub fn new(problem: &Problem<'_>, estimate: &Estimate, loss: Loss) -> Self {
        let dim = IMU_DIM * estimate.states.len();
        let mut equations =
            Self { matrix: DMatrix::zeros(dim, dim), vector: DVector::zeros(dim), landmarks: Vec::new() };
        equations.add_intervals(problem, estimate);
        equations.add_priors(problem, estimate);
        for landmark in &estimate.landmarks {
            equations.landmarks.push(LandmarkBlock::new(problem, &estimate.states, landmark, loss));
        }
        equations
    }

    fn add_intervals(&mut self, problem: &Problem<'_>, estimate: &Estimate) {
        for (k, interval) in problem.intervals.iter().enumerate() {
            let row = interval.linearize(&estimate.states[k], &estimate.states[k + 1]);
            let (begin, end) = (interval.information * row.wrt_begin, interval.information * row.wrt_end);
            let at = IMU_DIM * k;
            let mut add = |i: usize, j: usize, block: ImuMatrix| {
                let mut view = self.matrix.fixed_view_mut::<IMU_DIM, IMU_DIM>(i, j);
                view += block;
            };
            // The factorization reads the lower half.
            add(at, at, row.wrt_begin.transpose() * begin);
            add(at + IMU_DIM, at, row.wrt_end.transpose() * begin);
            add(at + IMU_DIM, at + IMU_DIM, row.wrt_end.transpose() * end);
            let mut first = self.vector.fixed_rows_mut::<IMU_DIM>(at);
            first -= begin.transpose() * row.residual;
            let mut second = self.vector.fixed_rows_mut::<IMU_DIM>(at + IMU_DIM);
            second -= end.transpose() * row.residual;
        }
    }

    /// Priors on the biases of the first state, and on position and yaw of the newest, which define L.
    fn add_priors(&mut self, problem: &Problem<'_>, estimate: &Estimate) {
        let bias_errors = problem.bias_errors(&estimate.states[0]);
        for (begin, sigma, error) in [
            (GYROSCOPE_BIAS, problem.config.initial.sigma_gyroscope_bias_rad_s, bias_errors.0),
            (ACCELEROMETER_BIAS, problem.config.initial.sigma_accelerometer_bias_m_s2, bias_errors.1),
        ] {
            for k in 0..3 {
                self.matrix[(begin + k, begin + k)] += 1.0 / sigma.powi(2);
                self.vector[begin + k] -= error[k] / sigma.powi(2);
            }
        }
        let newest = IMU_DIM * (estimate.states.len() - 1);
        self.matrix[(newest + 2, newest + 2)] += 1.0 / problem.config.initial.sigma_yaw_rad.powi(2);
        let position = estimate.newest().local_from_imu.translation;
        for k in 0..3 {
            let weight = 1.0 / problem.config.initial.sigma_position_m.powi(2);
            self.matrix[(newest + 3 + k, newest + 3 + k)] += weight;
            self.vector[newest + 3 + k] -= position[k] * weight;
        }
    }

    /// The information matrix of the states after the landmarks are eliminated (lower half), and its vector.
    pub fn reduced(&self) -> (DMatrix<f64>, DVector<f64>) {
        let (mut matrix, mut vector) = (self.matrix.clone(), self.vector.clone());
        for block in &self.landmarks {
            let Some(inverse) = block.inverse() else { continue };
            for &(image, other, square) in &block.squares {
                let mut view = matrix.fixed_view_mut::<POSE_DIM, POSE_DIM>(IMU_DIM * image, IMU_DIM * other);
                view += square;
            }
            for pose in &block.poses {
                let gain = pose.cross.transpose() * inverse;
                let mut rows = vector.fixed_rows_mut::<POSE_DIM>(IMU_DIM * pose.image);
                rows += pose.vector - gain * block.vector;
                for other in block.poses.iter().filter(|other| other.image <= pose.image) {
                    let mut view = matrix
                        .fixed_view_mut::<POSE_DIM, POSE_DIM>(IMU_DIM * pose.image, IMU_DIM * other.image);
                    view -= gain * other.cross;
                }
            }
        }
        (matrix, vector)
    }

    /// The Gauss-Newton step; `None` where the problem is degenerate.
    pub fn solve(&self) -> Option<Step> {
        let (matrix, vector) = self.reduced();
        let states = matrix.cholesky()?.solve(&vector);
        let landmarks = self
            .landmarks
            .iter()
            .map(|block| {
                let rest = block.poses.iter().fold(block.vector, |rest, pose| {
                    rest - pose.cross * states.fixed_rows::<POSE_DIM>(IMU_DIM * pose.image)
                });
                block.inverse().map_or_else(Vector3::zeros, |inverse| inverse * rest)
            })
            .collect();
        Some(Step { states, landmarks })
    }
}

/// Cost: half the sum of squares in sigmas, with the loss applied to the observations.
pub fn cost(problem: &Problem<'_>, estimate: &Estimate, loss: Loss) -> f64 {
    let mut cost = 0.0;
    for (interval, ends) in problem.intervals.iter().zip(estimate.states.windows(2)) {
        let residual = interval.residual(&ends[0], &ends[1]);
        cost += 0.5 * residual.dot(&(interval.information * residual));
    }
    let (gyroscope, accelerometer) = problem.bias_errors(&estimate.states[0]);
    let initial = &problem.config.initial;
    cost += 0.5 * gyroscope.norm_squared() / initial.sigma_gyroscope_bias_rad_s.powi(2);
    cost += 0.5 * accelerometer.norm_squared() / initial.sigma_accelerometer_bias_m_s2.powi(2);
    let position = estimate.newest().local_from_imu.translation;
    cost += 0.5 * position.norm_squared() / initial.sigma_position_m.powi(2);
    for landmark in &estimate.landmarks {
        cost += landmark_cost(problem, &estimate.states, landmark, loss);
    }
    cost
}
