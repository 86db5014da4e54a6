//! Schmidt's update with all keyframes in one dense matrix, for comparison.

use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng, rngs::StdRng};

/// IMU, transform, and a window of 20 clones.
const ACTIVE: usize = 15 + 6 + 20 * 6;
/// A clone and the transform.
const TOUCHED: usize = 12;
/// Keyframes in an update.
const MATCHED: usize = 3;
/// As many rows as columns that are not zero: what is left after compression.
const ROWS: usize = TOUCHED + 6 * MATCHED;

/// A dense covariance of the active state and all keyframes.
pub struct DenseSchmidt {
    covariance: DMatrix<f64>,
    state: DVector<f64>,
    keyframes: usize,
    rng: StdRng,
}

impl DenseSchmidt {
    /// With `keyframes` held.
    pub fn new(keyframes: usize) -> Self {
        let n = ACTIVE + 6 * keyframes;
        let rng = StdRng::seed_from_u64(3);
        Self { covariance: DMatrix::identity(n, n), state: DVector::zeros(n), keyframes, rng }
    }

    /// `K = P Hᵀ S⁻¹` with no gain for the keyframes; `P ← P - K H P` in the rows and columns of the active state.
    pub fn map_update(&mut self) {
        let n = self.covariance.nrows();
        let mut jacobian = DMatrix::zeros(ROWS, n);
        let mut touched: Vec<usize> = (ACTIVE - 6..ACTIVE).chain(15..21).collect();
        for _ in 0..MATCHED {
            let begin = ACTIVE + 6 * self.rng.random_range(0..self.keyframes);
            touched.extend(begin..begin + 6);
        }
        for column in touched {
            for row in 0..ROWS {
                jacobian[(row, column)] = self.rng.random_range(-1.0..1.0);
            }
        }
        let projected = &jacobian * &self.covariance;
        let mut innovation = &projected * jacobian.transpose();
        for k in 0..ROWS {
            innovation[(k, k)] += 1.0;
        }
        let gain =
            innovation.cholesky().unwrap().solve(&projected.columns(0, ACTIVE).into_owned()).transpose();
        let residual = DVector::from_element(ROWS, 0.1);
        let correction = &gain * residual;
        let mut active = self.state.rows_mut(0, ACTIVE);
        active += correction;
        self.covariance.rows_mut(0, ACTIVE).gemm(-1.0, &gain, &projected, 1.0);
        let corner = self.covariance.view((0, ACTIVE), (ACTIVE, n - ACTIVE)).transpose();
        self.covariance.view_mut((ACTIVE, 0), (n - ACTIVE, ACTIVE)).copy_from(&corner);
    }
}
