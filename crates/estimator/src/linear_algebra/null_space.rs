//! Removes a landmark's error from its rows by projecting them onto the left null space of its Jacobian.
//!
//! Householder reflections that triangularize the landmark's Jacobian are applied to the rows as a
//! whole; the rows below the triangle are free of the landmark. Orthogonal, so white noise stays white.
//!
//! Source: Mourikis & Roumeliotis, ICRA 2007, section III-D.

use nalgebra::{DMatrix, DVector};

/// Projects `state` (rows x state) and `residual` in place; the last `rows - rank` rows are returned.
///
/// # Arguments
/// * `landmark`: rows x 3, overwritten.
///
/// # Returns
/// The rows that no longer depend on the landmark: `(jacobian, residual)`.
pub fn project_out(
    mut landmark: DMatrix<f64>,
    mut state: DMatrix<f64>,
    mut residual: DVector<f64>,
) -> (DMatrix<f64>, DVector<f64>) {
    let rows = landmark.nrows();
    let rank = landmark.ncols().min(rows);
    for column in 0..rank {
        let mut axis = landmark.view((column, column), (rows - column, 1)).into_owned();
        let length = axis.norm();
        if length == 0.0 {
            continue;
        }
        axis[0] += length.copysign(axis[0]);
        axis.normalize_mut();
        reflect(&axis.column(0).into_owned(), &mut landmark, column);
        reflect(&axis.column(0).into_owned(), &mut state, column);
        let along = 2.0 * axis.column(0).dot(&residual.rows(column, rows - column));
        residual.rows_mut(column, rows - column).axpy(-along, &axis.column(0), 1.0);
    }
    let kept = rows - rank;
    (state.rows(rank, kept).into_owned(), residual.rows(rank, kept).into_owned())
}

/// `M ← (I - 2 v vᵀ) M` on the rows from `first` on.
fn reflect(axis: &DVector<f64>, matrix: &mut DMatrix<f64>, first: usize) {
    let n = axis.len();
    for mut column in matrix.column_iter_mut() {
        let mut part = column.rows_mut(first, n);
        let along = 2.0 * axis.dot(&part);
        part.axpy(-along, axis, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng, rngs::StdRng};

    #[test]
    fn what_is_left_does_not_depend_on_the_landmark_and_keeps_all_else() {
        let mut rng = StdRng::seed_from_u64(1);
        for rows in [4, 7, 30] {
            let mut draw = |r: usize, c: usize| DMatrix::from_fn(r, c, |_, _| rng.random_range(-1.0..1.0));
            let (landmark, state) = (draw(rows, 3), draw(rows, 12));
            // A residual that the landmark explains is projected to nothing.
            let explained = &landmark * draw(3, 1);
            let (_, rest) = project_out(landmark.clone(), state.clone(), explained.column(0).into_owned());
            assert!(rest.amax() < 1e-12);
            // Information about the state equals the Schur complement of the joint one.
            let residual = draw(rows, 1).column(0).into_owned();
            let (projected, rest) = project_out(landmark.clone(), state.clone(), residual.clone());
            assert_eq!(projected.nrows(), rows - 3);
            let inverse = (landmark.transpose() * &landmark).try_inverse().unwrap();
            let hat = DMatrix::identity(rows, rows) - &landmark * inverse * landmark.transpose();
            let schur = state.transpose() * &hat * &state;
            assert!((projected.transpose() * &projected - schur).amax() < 1e-10);
            assert!((projected.transpose() * rest - state.transpose() * hat * residual).amax() < 1e-10);
        }
    }
}
