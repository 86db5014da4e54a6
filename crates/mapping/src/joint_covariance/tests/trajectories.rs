//! Random trajectories with the exact joint covariance of their poses.

use adjustment::POSE;
use geometry::rotation::skew;
use nalgebra::{Cholesky, DMatrix, DVector, Matrix3, Vector3};
use rand::{RngExt, rngs::StdRng};

/// Unknowns of a pose of the simulated trajectories: its own, and a slowly changing rate of yaw, which is not stated.
const STATE: usize = POSE + 1;
/// Poses nearer than this, from another time, are seen again (m).
const SEEN_AGAIN: f64 = 1.5;

/// Positions a metre apart (m).
#[derive(Clone, Copy, Debug)]
pub(super) enum Place {
    /// A street that turns at random.
    Street,
    /// Rounds of a circuit.
    Rounds,
    /// Streets that cross, walked at random.
    Town,
}

pub(super) fn positions(place: Place, count: usize, rng: &mut StdRng) -> Vec<Vector3<f64>> {
    let mut heading: f64 = 0.0;
    let mut at = Vector3::zeros();
    let mut positions = Vec::with_capacity(count);
    for index in 0..count {
        positions.push(at + Vector3::from_fn(|_, _| rng.random_range(-0.1..0.1)));
        match place {
            Place::Street => heading += rng.random_range(-0.15..0.15),
            Place::Rounds => heading = std::f64::consts::TAU * 4.0 * index as f64 / count as f64,
            Place::Town if index % 12 == 11 => {
                heading = std::f64::consts::FRAC_PI_2 * f64::from(rng.random_range(0..4));
            }
            Place::Town => {}
        }
        at += Vector3::new(heading.cos(), heading.sin(), 0.0);
    }
    positions
}

/// The information of relative poses between neighbours and where a place is seen again, of gravity, and of the first pose.
struct Information(DMatrix<f64>);

impl Information {
    /// Adds the information of a linear measurement of unknowns, `sum of jacobian * error`, with independent noise.
    fn add(&mut self, parts: &[(usize, DMatrix<f64>)], sigmas: &[f64]) {
        let weights = sigmas.iter().map(|sigma| sigma.powi(-2));
        let weights = DMatrix::from_diagonal(&DVector::from_iterator(sigmas.len(), weights));
        for (row, by_row) in parts {
            for (column, by_column) in parts {
                let block = by_row.transpose() * &weights * by_column;
                let mut at = self.0.view_mut((*row, *column), block.shape());
                at += block;
            }
        }
    }

    /// Adds a measured relative pose: `d = p_j - p_i`, `e_j - [I 0; -[d]x I] e_i`.
    fn add_relative(&mut self, [i, j]: [usize; 2], positions: &[Vector3<f64>], sigmas: [f64; 2]) {
        let mut by_first = DMatrix::identity(POSE, POSE) * -1.0;
        let turned: Matrix3<f64> = skew(&(positions[j] - positions[i]));
        by_first.fixed_view_mut::<3, 3>(3, 0).copy_from(&turned);
        let [theta, p] = sigmas;
        let noise = [theta, theta, theta, p, p, p];
        let mut parts = vec![(STATE * i, by_first), (STATE * j, DMatrix::identity(POSE, POSE))];
        if j == i + 1 {
            let mut by_rate = DMatrix::zeros(POSE, 1);
            by_rate[(2, 0)] = -1.0;
            parts.push((STATE * i + POSE, by_rate));
        }
        self.add(&parts, &noise);
    }
}

/// The joint covariance of the poses along a trajectory.
pub(super) fn exact(positions: &[Vector3<f64>]) -> DMatrix<f64> {
    let count = positions.len();
    let mut information = Information(DMatrix::zeros(STATE * count, STATE * count));
    let whole = DMatrix::identity(POSE, POSE);
    information.add(&[(0, whole)], &[2e-3, 2e-3, 1e-4, 1e-3, 1e-3, 1e-3]);
    let rate = |index: usize, value: f64| (STATE * index + POSE, DMatrix::from_element(1, 1, value));
    information.add(&[rate(0, 1.0)], &[1e-3]);
    for j in 0..count {
        information.add(&[(STATE * j, DMatrix::identity(2, POSE))], &[5e-3, 5e-3]);
        if j > 0 {
            information.add_relative([j - 1, j], positions, [4e-4, 4e-3]);
            information.add(&[rate(j - 1, -1.0), rate(j, 1.0)], &[5e-5]);
        }
        for i in 0..j.saturating_sub(1) {
            let near = (positions[j] - positions[i]).norm() < SEEN_AGAIN;
            if near && (j - i <= 3 || (i + j) % 3 == 0) {
                information.add_relative([i, j], positions, [8e-4, 8e-3]);
            }
        }
    }
    let covariance = Cholesky::new(information.0).unwrap().inverse();
    let rows: Vec<usize> = (0..count).flat_map(|index| STATE * index..STATE * index + POSE).collect();
    let poses = covariance.select_rows(&rows).select_columns(&rows);
    (&poses + poses.transpose()) * 0.5
}
