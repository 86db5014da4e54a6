//! Rank-revealing factorization `S = Q C` of a transition.
//!
//! Each clone that leaves the window removes six dimensions of the state that older sensitivities refer to. After a
//! window of 20 clones only the IMU, the transform and long-lived SLAM features connect the state of then with that of
//! now: 111 of 231 dimensions in the bench. A sensitivity of then can be kept as `C M`, without any approximation.

use crate::linear_algebra::dense::Dense;

/// Pivots below this part of the largest are rounding: at the rank, singular values drop from 1e-6 to below 1e-14.
const ROUNDING: f64 = 1e-13;

/// `Q` (rows x rank) and `C` (rank x columns) of a transition, by QR with column pivoting.
///
/// Rows are scaled to unit length first, so that the cut-off is relative in each of them, whatever its unit.
pub fn rank_factorization(transition: &Dense) -> (Dense, Dense) {
    let (rows, columns) = (transition.nrows(), transition.ncols());
    let norm = |norm: f64| if norm > 0.0 { norm } else { 1.0 };
    let scales: Vec<f64> = transition.view().row_iter().map(|row| norm(row.norm())).collect();
    let mut scaled = transition.clone();
    for column in 0..columns {
        scaled.column_mut(column).iter_mut().zip(&scales).for_each(|(number, scale)| *number /= scale);
    }
    let qr = scaled.faer().col_piv_qr();
    let (q, r) = (qr.compute_thin_Q(), qr.thin_R());
    let significant = |k: &usize| r[(*k, *k)].abs() > ROUNDING * r[(0, 0)].abs();
    let rank = (0..rows.min(columns)).take_while(significant).count();
    let mut left = Dense::zeros(rows, rank);
    let mut right = Dense::zeros(rank, columns);
    for k in 0..rank {
        for (row, scale) in scales.iter().enumerate() {
            left[(row, k)] = q[(row, k)] * scale;
        }
        for (j, &column) in qr.P().arrays().0.iter().enumerate().skip(k) {
            right[(k, column)] = r[(k, j)];
        }
    }
    (left, right)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    fn wave(rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |row, column| ((3 * row + 7 * column + row * column) as f64).sin())
    }

    #[test]
    fn the_factors_have_the_rank_as_inner_dimension_and_reproduce_the_matrix() {
        for (rows, columns, rank) in [(30, 30, 12), (20, 34, 7), (34, 20, 1)] {
            // Rows in very different units.
            let units = DMatrix::from_fn(rows, columns, |row, _| 10_f64.powi(row as i32 % 7 - 3));
            let whole = (wave(rows, rank).add_scalar(0.1) * wave(rank, columns)).component_mul(&units);
            let (left, right) = rank_factorization(&Dense::from(whole.clone()));
            assert_eq!((left.ncols(), right.nrows()), (rank, rank));
            let difference = left.view() * right.view() - &whole;
            for (row, of_row) in difference.row_iter().enumerate() {
                assert!(of_row.amax() < 1e-12 * whole.row(row).amax(), "row {row}: {}", of_row.amax());
            }
        }
    }
}
