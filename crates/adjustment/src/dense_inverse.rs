//! Inverses of large dense covariances, by `faer`.

use faer::linalg::solvers::DenseSolveCore;
use faer::{MatRef, Side};
use nalgebra::DMatrix;

/// The inverse of a symmetric matrix; `None` where it is not positive definite.
pub fn inverse_of(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let size = matrix.nrows();
    let inverse =
        MatRef::from_column_major_slice(matrix.as_slice(), size, size).llt(Side::Lower).ok()?.inverse();
    Some(DMatrix::from_fn(size, size, |row, column| 0.5 * (inverse[(row, column)] + inverse[(column, row)])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_of_a_covariance_is_its_inverse() {
        let root = DMatrix::from_fn(40, 40, |row, column| {
            ((row * 7 + column * 13) as f64).sin() + f64::from(row == column)
        });
        let matrix = &root * root.transpose() + DMatrix::identity(40, 40);
        let product = &matrix * inverse_of(&matrix).unwrap();
        assert!((product - DMatrix::identity(40, 40)).amax() < 1e-9);
        assert!(inverse_of(&-matrix).is_none());
        assert_eq!(inverse_of(&DMatrix::zeros(0, 0)), Some(DMatrix::zeros(0, 0)));
    }
}
