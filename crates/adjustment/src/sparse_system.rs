//! Symmetric, positive definite, sparse systems of equations, factored by `faer` with an approximate minimum degree order.

use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::Llt;
use faer::sparse::{SparseColMat, Triplet};
use faer::{MatMut, Side};
use nalgebra::{DMatrix, DVector, Dim, Matrix, RawStorage};

/// The lower half of a symmetric matrix, as a sum of entries.
pub struct SparseSystem {
    dim: usize,
    entries: Vec<Triplet<usize, usize, f64>>,
}

impl SparseSystem {
    /// Zero, with so many rows.
    pub fn new(dim: usize) -> SparseSystem {
        SparseSystem { dim, entries: Vec::new() }
    }

    /// Adds one number to the diagonal.
    pub fn add_diagonal(&mut self, index: usize, value: f64) {
        self.entries.push(Triplet::new(index, index, value));
    }

    /// Adds a block whose rows and columns are at the given indices. Of what lies above the diagonal nothing is added: a
    /// symmetric block is given whole, of any other pair of rows and columns one of the two.
    pub fn add<R: Dim, C: Dim, S: RawStorage<f64, R, C>>(
        &mut self,
        rows: &[usize],
        columns: &[usize],
        block: &Matrix<f64, R, C, S>,
    ) {
        for (j, &column) in columns.iter().enumerate() {
            for (i, &row) in rows.iter().enumerate() {
                if row >= column {
                    self.entries.push(Triplet::new(row, column, block[(i, j)]));
                }
            }
        }
    }

    /// The Cholesky factor; `None` where the matrix is not positive definite.
    pub fn factor(&self) -> Option<SparseFactor> {
        let matrix = SparseColMat::try_new_from_triplets(self.dim, self.dim, &self.entries).ok()?;
        Some(SparseFactor { dim: self.dim, factor: matrix.sp_cholesky(Side::Lower).ok()? })
    }
}

/// The Cholesky factor of a [`SparseSystem`].
pub struct SparseFactor {
    dim: usize,
    factor: Llt<usize, f64>,
}

impl SparseFactor {
    /// Solves for one right side.
    pub fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        let mut solution = right.clone();
        self.factor.solve_in_place(MatMut::from_column_major_slice_mut(solution.as_mut_slice(), self.dim, 1));
        solution
    }

    /// Columns of the inverse.
    pub fn inverse_columns(&self, columns: &[usize]) -> DMatrix<f64> {
        let mut inverse = DMatrix::zeros(self.dim, columns.len());
        for (index, &column) in columns.iter().enumerate() {
            inverse[(column, index)] = 1.0;
        }
        let right = MatMut::from_column_major_slice_mut(inverse.as_mut_slice(), self.dim, columns.len());
        self.factor.solve_in_place(right);
        inverse
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    #[test]
    fn solutions_and_inverses_are_those_of_the_dense_matrix() {
        let mut rng = StdRng::seed_from_u64(4);
        let (dim, mut system, mut dense) = (30, SparseSystem::new(30), DMatrix::<f64>::zeros(30, 30));
        for index in 0..dim {
            system.add_diagonal(index, 2.0);
            dense[(index, index)] += 2.0;
        }
        // Overlapping blocks: entries are summed.
        for begin in (0..24).step_by(3) {
            let indices: Vec<usize> = vec![begin, begin + 1, begin + 4, (begin * 7) % 30, 29];
            let mut unique = indices.clone();
            unique.sort_unstable();
            unique.dedup();
            let root = DMatrix::from_fn(unique.len(), 3, |_, _| rng.random_range(-1.0..1.0));
            let block = &root * root.transpose();
            system.add(&unique, &unique, &block);
            for (i, &row) in unique.iter().enumerate() {
                for (j, &column) in unique.iter().enumerate() {
                    dense[(row, column)] += block[(i, j)];
                }
            }
        }
        let factor = system.factor().unwrap();
        let right = DVector::from_fn(dim, |_, _| rng.random_range(-1.0..1.0));
        assert!((&dense * factor.solve(&right) - right).amax() < 1e-12);
        let inverse = dense.try_inverse().unwrap();
        let columns = factor.inverse_columns(&[3, 17]);
        assert!((columns.column(0) - inverse.column(3)).amax() < 1e-12);
        assert!((columns.column(1) - inverse.column(17)).amax() < 1e-12);
    }

    #[test]
    fn an_indefinite_matrix_has_no_factor() {
        let mut system = SparseSystem::new(2);
        system.add_diagonal(0, 1.0);
        system.add_diagonal(1, -1.0);
        assert!(system.factor().is_none());
    }
}
