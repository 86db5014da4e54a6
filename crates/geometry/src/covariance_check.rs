//! Whether a matrix is a covariance: the one check, with one tolerance, of everything that is read or received.

use nalgebra::{DMatrix, SMatrix};
use thiserror::Error;

/// How far a covariance may be from symmetric and from positive semi-definite, after scaling its diagonal to 1.
///
/// A covariance computed in `f64` is off by about 1e-12 of this scale; 1e-6 leaves room for one that was written as
/// text, and is far below a wrong sign.
pub const COVARIANCE_TOLERANCE: f64 = 1e-6;

/// Why a matrix is no covariance. To be read after the name of the matrix: "the covariance is not finite".
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum CovarianceError {
    /// An entry is infinite or no number.
    #[error("is not finite")]
    NotFinite,
    /// A diagonal entry is below zero.
    #[error("has a negative variance at [{index}][{index}]")]
    NegativeVariance {
        /// Row and column of the entry.
        index: usize,
    },
    /// Two mirrored entries differ.
    #[error("is not symmetric at [{row}][{column}]")]
    NotSymmetric {
        /// Row of one of them.
        row: usize,
        /// Its column.
        column: usize,
    },
    /// An entry exceeds the geometric mean of its two variances (Cauchy-Schwarz).
    #[error("has a negative eigenvalue: [{row}][{column}] exceeds what its variances allow")]
    ExceedsVariances {
        /// Row of the entry.
        row: usize,
        /// Its column.
        column: usize,
    },
    /// Several entries contradict each other.
    #[error("has a negative eigenvalue: the smallest eigenvalue of its correlation matrix is {smallest:.3e}")]
    NotPositiveSemiDefinite {
        /// The smallest eigenvalue of the matrix scaled to a diagonal of 1.
        smallest: f64,
    },
}

/// Checks that a matrix is finite, symmetric and positive semi-definite, within [`COVARIANCE_TOLERANCE`].
///
/// Judged on the correlation matrix (diagonal scaled to 1), because radians and metres in one matrix differ by orders
/// of magnitude. A variance of zero is allowed; its row and column must then be zero.
///
/// ```
/// use geometry::covariance_check::{CovarianceError, check_covariance};
/// use nalgebra::Matrix2;
///
/// assert_eq!(check_covariance(&Matrix2::new(1e-6, 0.0, 0.0, 4.0)), Ok(()));
/// let refused = check_covariance(&Matrix2::new(1.0, 2.0, 2.0, 1.0));
/// assert_eq!(refused, Err(CovarianceError::ExceedsVariances { row: 0, column: 1 }));
/// ```
///
/// # Errors
/// [`CovarianceError`]: the first violation found.
pub fn check_covariance<const N: usize>(covariance: &SMatrix<f64, N, N>) -> Result<(), CovarianceError> {
    if !covariance.iter().all(|value| value.is_finite()) {
        return Err(CovarianceError::NotFinite);
    }
    if let Some(index) = (0..N).find(|&index| covariance[(index, index)] < 0.0) {
        return Err(CovarianceError::NegativeVariance { index });
    }
    let sigma: [f64; N] = std::array::from_fn(|index| covariance[(index, index)].sqrt());
    let mut correlation = SMatrix::<f64, N, N>::identity();
    for row in 0..N {
        for column in (0..N).filter(|&column| column != row) {
            let scale = sigma[row] * sigma[column];
            let entry = covariance[(row, column)];
            if (entry - covariance[(column, row)]).abs() > COVARIANCE_TOLERANCE * scale {
                return Err(CovarianceError::NotSymmetric { row, column });
            }
            if entry.abs() > scale * (1.0 + COVARIANCE_TOLERANCE) {
                return Err(CovarianceError::ExceedsVariances { row, column });
            }
            correlation[(row, column)] = if scale > 0.0 { entry / scale } else { 0.0 };
        }
    }
    check_eigenvalues(&correlation)
}

/// Checks that `covariance - part` is positive semi-definite, within [`COVARIANCE_TOLERANCE`] of the *covariance*: where `part`
/// explains all of it, what is left is rounding.
///
/// # Arguments
/// * `covariance`: passes [`check_covariance`].
///
/// # Errors
/// [`CovarianceError`]: the first violation found.
pub fn check_difference<const N: usize>(
    covariance: &SMatrix<f64, N, N>,
    part: &SMatrix<f64, N, N>,
) -> Result<(), CovarianceError> {
    let left = covariance - part;
    if !left.iter().all(|value| value.is_finite()) {
        return Err(CovarianceError::NotFinite);
    }
    let sigma: [f64; N] = std::array::from_fn(|index| covariance[(index, index)].max(0.0).sqrt());
    let mut scaled = SMatrix::<f64, N, N>::zeros();
    for row in 0..N {
        for column in 0..N {
            let scale = sigma[row] * sigma[column];
            let entry = (left[(row, column)] + left[(column, row)]) * 0.5;
            if scale > 0.0 {
                scaled[(row, column)] = entry / scale;
            } else if entry != 0.0 {
                return Err(CovarianceError::ExceedsVariances { row, column });
            }
        }
    }
    check_eigenvalues(&scaled)
}

/// No eigenvalue is below minus the tolerance: then, and only then, the matrix plus the tolerance has a Cholesky factor.
fn check_eigenvalues<const N: usize>(correlation: &SMatrix<f64, N, N>) -> Result<(), CovarianceError> {
    let shift = SMatrix::<f64, N, N>::from_diagonal_element(COVARIANCE_TOLERANCE);
    if (correlation + shift).cholesky().is_some() {
        return Ok(());
    }
    let smallest = DMatrix::from_column_slice(N, N, correlation.as_slice()).symmetric_eigenvalues().min();
    if smallest < -COVARIANCE_TOLERANCE {
        return Err(CovarianceError::NotPositiveSemiDefinite { smallest });
    }
    Ok(())
}
