//! The narrowest place of a transition: `S = Q C` with as few rows of `C` as `S` has independent directions.
//!
//! With every clone that leaves the window, the state of that time loses six numbers that still matter to the present one:
//! after a window of 20 clones only the IMU's numbers, the transform and landmarks that are in the state all the time are
//! left, 111 of 231 in the bench. Loadings of that time can then be kept as `C M`, and what is exact stays exact.

use crate::linear_algebra::dense::Dense;

/// A direction that is smaller than this part of the largest is rounding: where the rank ends, singular values fall from
/// 1e-6 to below 1e-14.
const ROUNDING: f64 = 1e-13;

/// `Q` (rows x rank) and `C` (rank x columns) of a transition, by QR with pivoted columns.
///
/// Rows are scaled to one first: what is dropped is rounding in each of them, whatever its unit.
///
/// # Returns
/// `None` where the rank is above `most`.
pub fn waist(transition: &Dense, most: usize) -> Option<(Dense, Dense)> {
    let (rows, columns) = (transition.nrows(), transition.ncols());
    let mut scaled = transition.clone();
    let scales: Vec<f64> = transition
        .view()
        .row_iter()
        .map(|row| row.norm())
        .map(|norm| if norm > 0.0 { norm } else { 1.0 })
        .collect();
    for column in 0..columns {
        scaled.column_mut(column).iter_mut().zip(&scales).for_each(|(number, scale)| *number /= scale);
    }
    let factors = scaled.faer().col_piv_qr();
    let triangle = factors.thin_R();
    let largest = triangle.get(0, 0).abs();
    let significant = |k: &usize| triangle.get(*k, *k).abs() > ROUNDING * largest;
    let rank = (0..rows.min(columns)).take_while(significant).count();
    if rank == 0 || rank > most {
        return None;
    }
    let basis = factors.compute_thin_Q();
    let mut wide = Dense::zeros(rows, rank);
    for k in 0..rank {
        let target = wide.column_mut(k).iter_mut();
        for ((row, number), scale) in target.enumerate().zip(&scales) {
            *number = basis.get(row, k) * scale;
        }
    }
    let mut narrow = Dense::zeros(rank, columns);
    for (j, &column) in factors.P().arrays().0.iter().enumerate() {
        for k in 0..rank.min(j + 1) {
            narrow[(k, column)] = *triangle.get(k, j);
        }
    }
    Some((wide, narrow))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    fn wave(rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |row, column| ((3 * row + 7 * column + row * column) as f64).sin())
    }

    #[test]
    fn the_factors_are_as_narrow_as_the_rank_and_their_product_is_the_whole() {
        for (rows, columns, rank) in [(30, 30, 12), (20, 34, 7), (34, 20, 1)] {
            // Rows in very different units.
            let units = DMatrix::from_fn(rows, columns, |row, _| 10_f64.powi(row as i32 % 7 - 3));
            let whole = (wave(rows, rank).add_scalar(0.1) * wave(rank, columns)).component_mul(&units);
            let transition = Dense::from(whole.clone());
            let (wide, narrow) = waist(&transition, rank).unwrap();
            assert_eq!((wide.ncols(), narrow.nrows()), (rank, rank));
            let apart = wide.view() * narrow.view() - &whole;
            for (row, of_row) in apart.row_iter().enumerate() {
                assert!(of_row.amax() < 1e-12 * whole.row(row).amax(), "row {row}: {}", of_row.amax());
            }
            assert!(waist(&transition, rank - 1).is_none());
        }
    }
}
