//! The normal equations of a window: one block of 15 an image, landmarks eliminated (Schur complement).

use super::adjustment::{Estimate, Loss, Settings};
use super::landmark_block::{LandmarkBlock, landmark_cost};
use crate::propagation::{ACCELEROMETER_BIAS, GYROSCOPE_BIAS, IMU_DIM, ImuMatrix};
use crate::state::POSE_DIM;
use nalgebra::{DMatrix, DVector, Vector3};

/// The linearized problem. Rows and columns of the newest image come last.
pub struct NormalEquations {
    matrix: DMatrix<f64>,
    vector: DVector<f64>,
    landmarks: Vec<LandmarkBlock>,
}

/// A step of all unknowns.
pub struct Step {
    /// 15 numbers an image.
    pub states: DVector<f64>,
    /// `(x, y, ρ)` of every landmark.
    pub landmarks: Vec<Vector3<f64>>,
}

impl NormalEquations {
    /// Linearizes everything at an estimate.
    pub fn new(settings: &Settings<'_>, estimate: &Estimate, loss: Loss) -> Self {
        let dim = IMU_DIM * estimate.states.len();
        let mut equations =
            Self { matrix: DMatrix::zeros(dim, dim), vector: DVector::zeros(dim), landmarks: Vec::new() };
        equations.add_intervals(settings, estimate);
        equations.add_priors(settings, estimate);
        for entry in &estimate.landmarks {
            equations.landmarks.push(LandmarkBlock::new(settings, &estimate.states, entry, loss));
        }
        equations
    }

    fn add_intervals(&mut self, settings: &Settings<'_>, estimate: &Estimate) {
        for (k, interval) in settings.intervals.iter().enumerate() {
            let row = interval.linearize(&estimate.states[k], &estimate.states[k + 1]);
            let (begin, end) = (interval.information * row.by_begin, interval.information * row.by_end);
            let at = IMU_DIM * k;
            let mut add = |i: usize, j: usize, block: ImuMatrix| {
                let mut view = self.matrix.fixed_view_mut::<IMU_DIM, IMU_DIM>(i, j);
                view += block;
            };
            // The factorization reads the lower half.
            add(at, at, row.by_begin.transpose() * begin);
            add(at + IMU_DIM, at, row.by_end.transpose() * begin);
            add(at + IMU_DIM, at + IMU_DIM, row.by_end.transpose() * end);
            let mut first = self.vector.fixed_rows_mut::<IMU_DIM>(at);
            first -= begin.transpose() * row.residual;
            let mut second = self.vector.fixed_rows_mut::<IMU_DIM>(at + IMU_DIM);
            second -= end.transpose() * row.residual;
        }
    }

    /// Biases of the first state; position and yaw of the newest, which define L.
    fn add_priors(&mut self, settings: &Settings<'_>, estimate: &Estimate) {
        let pulls = settings.bias_errors(&estimate.states[0]);
        for (begin, sigma, error) in [
            (GYROSCOPE_BIAS, settings.config.initial.gyroscope_bias, pulls.0),
            (ACCELEROMETER_BIAS, settings.config.initial.accelerometer_bias, pulls.1),
        ] {
            for k in 0..3 {
                self.matrix[(begin + k, begin + k)] += 1.0 / sigma.powi(2);
                self.vector[begin + k] -= error[k] / sigma.powi(2);
            }
        }
        let newest = IMU_DIM * (estimate.states.len() - 1);
        self.matrix[(newest + 2, newest + 2)] += 1.0 / settings.config.initial.yaw.powi(2);
        let position = estimate.newest().local_from_imu.translation;
        for k in 0..3 {
            let weight = 1.0 / settings.config.initial.position.powi(2);
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

    /// The step to the minimum of the linearized problem; `None` where it has none.
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

/// Half the sum of squares, in sigmas, the loss applied to the sightings.
pub fn cost(settings: &Settings<'_>, estimate: &Estimate, loss: Loss) -> f64 {
    let mut cost = 0.0;
    for (interval, ends) in settings.intervals.iter().zip(estimate.states.windows(2)) {
        let residual = interval.residual(&ends[0], &ends[1]);
        cost += 0.5 * residual.dot(&(interval.information * residual));
    }
    let (gyroscope, accelerometer) = settings.bias_errors(&estimate.states[0]);
    let initial = &settings.config.initial;
    cost += 0.5 * gyroscope.norm_squared() / initial.gyroscope_bias.powi(2);
    cost += 0.5 * accelerometer.norm_squared() / initial.accelerometer_bias.powi(2);
    let position = estimate.newest().local_from_imu.translation;
    cost += 0.5 * position.norm_squared() / initial.position.powi(2);
    for entry in &estimate.landmarks {
        cost += landmark_cost(settings, &estimate.states, entry, loss);
    }
    cost
}
