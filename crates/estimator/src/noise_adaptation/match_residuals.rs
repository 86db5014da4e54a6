//! Noise of matched pixels, from the residuals of an answer that no error of a pose explains.
//!
//! All landmarks of an answer depend on the pose of the image in the keyframes. A least-squares fit of these poses removes
//! the errors of state and map; what remains is noise. The fit is robust (iteratively reweighted, Huber), its scale is the
//! median absolute deviation: the matches have passed no gate yet.

use geometry::median;
use nalgebra::{DMatrix, DVector};

/// Iterations of the reweighted fit.
const ITERATIONS: usize = 5;
/// Residual beyond which a row's weight decreases, sigmas.
const HUBER_SIGMAS: f64 = 1.5;
/// Standard deviation of a normal distribution over its median absolute deviation.
const SIGMA_OVER_MEDIAN: f64 = 1.4826;
/// Minimum number of rows beyond those that the poses explain.
const MIN_FREE_ROWS: usize = 10;
/// Regularization relative to the diagonal: poses are determined relative to each other only.
const RIDGE: f64 = 1e-9;
/// Smallest result. Matches with the very images of a map have no residuals.
const MIN_SIGMA: f64 = 1e-3;

/// Robust standard deviation of the residuals that `jacobian` does not explain.
///
/// # Arguments
/// * `jacobian`: m x n, whitened.
/// * `residual`: m, whitened.
/// * `pose_columns`: number of columns of clone and transform, which act as one pose of six degrees of freedom.
///
/// # Returns
/// In units of the noise that the rows are whitened with; `None` with too few rows.
pub fn robust_sigma(jacobian: &DMatrix<f64>, residual: &DVector<f64>, pose_columns: usize) -> Option<f64> {
    let rows = residual.len();
    let explained = jacobian.ncols().saturating_sub(pose_columns).max(6);
    let free = rows.checked_sub(explained).filter(|free| *free >= MIN_FREE_ROWS)?;
    let mut weights = DVector::repeat(rows, 1.0);
    let mut sigma = 0.0;
    for _ in 0..ITERATIONS {
        let left = unexplained(jacobian, residual, &weights)?;
        let mut sizes: Vec<f64> = left.iter().map(|value| value.abs()).collect();
        sigma = (SIGMA_OVER_MEDIAN * median(&mut sizes)? * (rows as f64 / free as f64).sqrt()).max(MIN_SIGMA);
        weights = left.map(|value| (HUBER_SIGMAS * sigma / value.abs()).min(1.0));
    }
    Some(sigma)
}

/// Residuals of a weighted least-squares fit.
fn unexplained(
    jacobian: &DMatrix<f64>,
    residual: &DVector<f64>,
    weights: &DVector<f64>,
) -> Option<DVector<f64>> {
    let mut weighted = jacobian.clone();
    for (mut row, weight) in weighted.row_iter_mut().zip(weights) {
        row *= *weight;
    }
    let mut normal = weighted.tr_mul(jacobian);
    let ridge = RIDGE * normal.diagonal().amax();
    for k in 0..normal.nrows() {
        normal[(k, k)] += ridge;
    }
    let step = normal.cholesky()?.solve(&weighted.tr_mul(residual));
    Some(residual - jacobian * step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution as _, StandardNormal};

    /// Residuals with noise `sigma`, a large error in all columns, and a fraction of outliers.
    fn found(sigma: f64, rows: usize, outliers: f64) -> Option<f64> {
        let mut rng = StdRng::seed_from_u64(3);
        let mut jacobian = DMatrix::from_fn(rows, 18, |_, _| rng.random_range(-100.0..100.0));
        // Clone and transform act alike.
        for k in 0..6 {
            let copy = jacobian.column(k).into_owned();
            jacobian.set_column(6 + k, &copy);
        }
        let error = DVector::from_fn(18, |_, _| rng.random_range(-1.0..1.0));
        let noise = DVector::from_fn(rows, |_, _| {
            let normal: f64 = StandardNormal.sample(&mut rng);
            if rng.random_bool(outliers) { 30.0 } else { sigma * normal }
        });
        robust_sigma(&jacobian, &(&jacobian * error + noise), 12)
    }

    #[test]
    fn the_noise_is_found_whatever_the_errors_of_the_poses() {
        for sigma in [0.5, 1.0, 3.0] {
            let estimate = found(sigma, 300, 0.0).unwrap();
            assert!((estimate / sigma - 1.0).abs() < 0.15, "{estimate} for {sigma}");
            let estimate = found(sigma, 300, 0.1).unwrap();
            assert!((estimate / sigma - 1.0).abs() < 0.35, "{estimate} for {sigma} with outliers");
        }
        assert_eq!(found(1.0, 15, 0.0), None, "too few rows");
    }
}
