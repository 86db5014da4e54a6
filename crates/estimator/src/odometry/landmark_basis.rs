//! An orthonormal basis `Q` of the columns of `H_f`, the Jacobian of a track's pixels with respect to its landmark.
//!
//! A robot that brakes moves by millimetres in the window, straight at some landmarks whose pixels then hardly depend on their depth:
//! the columns are nearly dependent, and `H_f (H_fᵀ H_f)⁻¹ H_fᵀ` is computed with rounding errors of 10⁶ times those of its
//! factors. `Q Qᵀ`, which is the same, is not.
//!
//! Source: Yamamoto, Nakatsukasa, Yanagisawa & Fukaya, "Roundoff error analysis of the CholeskyQR2 algorithm", ETNA 2015.

use crate::linear_algebra::NotPositiveDefinite;
use nalgebra::{Cholesky, Matrix2x3, Matrix3};

/// How far the columns may be from orthonormal after the first of two steps: further, rounding errors are all there is of one
/// of them, since the pixels do not determine the landmark.
const MAX_FIRST_ERROR: f64 = 0.5;

/// Makes the columns of the stacked `rows` orthonormal: twice `H_f ← H_f L⁻ᵀ`, with `L` the Cholesky factor of `H_fᵀ H_f`. The second
/// time removes the rounding errors of the first one.
///
/// # Arguments
/// * `prior`: what is known of the landmark besides, as `H_fᵀ H_f` of further rows, which are not stated.
///
/// # Errors
/// [`NotPositiveDefinite`] where the pixels do not determine the landmark.
pub(crate) fn orthonormalize(
    rows: &mut [Matrix2x3<f64>],
    mut prior: Matrix3<f64>,
) -> Result<(), NotPositiveDefinite> {
    for turn in 0..2 {
        let gram = rows.iter().fold(prior, |sum, rows| sum + rows.tr_mul(rows));
        if turn > 0 && (gram - Matrix3::identity()).amax() > MAX_FIRST_ERROR {
            return Err(NotPositiveDefinite);
        }
        let factor = Cholesky::new(gram).ok_or(NotPositiveDefinite)?.unpack();
        let inverse = factor.solve_lower_triangular(&Matrix3::identity()).ok_or(NotPositiveDefinite)?;
        for rows in &mut *rows {
            *rows *= inverse.transpose();
        }
        prior = inverse * prior * inverse.transpose();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns whose last one is the first one but for `apart`.
    fn rows(apart: f64) -> Vec<Matrix2x3<f64>> {
        let row = |k: usize| {
            let value = |m: usize| ((k * k + 3 * k * m + 7 * m * m) as f64).sin();
            Matrix2x3::new(
                value(0),
                value(1),
                value(0) + apart * value(2),
                value(3),
                value(4),
                value(3) + apart * value(5),
            )
        };
        (0..12).map(row).collect()
    }

    #[test]
    fn the_columns_are_orthonormal_and_span_the_same() {
        for apart in [1.0, 1e-3, 1e-5] {
            let before = rows(apart);
            let mut basis = before.clone();
            orthonormalize(&mut basis, Matrix3::zeros()).unwrap();
            let gram: Matrix3<f64> = basis.iter().map(|rows| rows.tr_mul(rows)).sum();
            assert!((gram - Matrix3::identity()).amax() < 1e-13, "{apart}: {gram}");
            // What is left of the columns outside of the span.
            let along: Matrix3<f64> = basis.iter().zip(&before).map(|(basis, rows)| basis.tr_mul(rows)).sum();
            let outside = basis.iter().zip(&before).map(|(basis, rows)| (rows - basis * along).amax());
            assert!(outside.fold(0.0, f64::max) < 1e-12);
        }
    }

    #[test]
    fn dependent_columns_are_refused_and_a_prior_makes_them_a_basis() {
        assert!(orthonormalize(&mut rows(0.0), Matrix3::zeros()).is_err());
        let prior = Matrix3::identity();
        let mut basis = rows(0.0);
        orthonormalize(&mut basis, prior).unwrap();
        let gram: Matrix3<f64> = basis.iter().map(|rows| rows.tr_mul(rows)).sum();
        // The rest of the unit columns lies in the rows of the prior.
        assert!((Matrix3::identity() - gram).symmetric_eigenvalues().min() > 0.0);
    }
}
