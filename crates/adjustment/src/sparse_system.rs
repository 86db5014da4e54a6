//! Symmetric, positive definite, sparse systems of equations, factored by `faer` with an approximate minimum degree order.

use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{Argsort, Pair, SparseColMat, SymbolicSparseColMat};
use faer::{MatMut, Side};
use nalgebra::{DMatrix, DVector, Dim, Matrix, RawStorage};

/// The lower half of a symmetric matrix, as a sum of entries.
pub struct SparseSystem {
    dim: usize,
    /// Row and column of each entry.
    places: Vec<Pair<u32, u32>>,
    values: Vec<f64>,
}

impl SparseSystem {
    /// Zero, with so many rows, which are fewer than 2^32.
    pub fn new(dim: usize) -> SparseSystem {
        SparseSystem { dim, places: Vec::new(), values: Vec::new() }
    }

    /// Adds one number to the diagonal.
    pub fn add_diagonal(&mut self, index: usize, value: f64) {
        self.push(index, index, value);
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
                    self.push(row, column, block[(i, j)]);
                }
            }
        }
    }

    fn push(&mut self, row: usize, column: usize, value: f64) {
        self.places.push(Pair::new(row as u32, column as u32));
        self.values.push(value);
    }

    /// The Cholesky factor; `None` where the matrix is not positive definite.
    pub fn factor(self) -> Option<SparseFactor> {
        SparseCholesky::default().factor(self)
    }
}

/// Factors systems one after the other. Where the entries of one are at the places of the last one's, in the same order, as from step to step
/// of an adjustment, they are neither sorted nor ordered for elimination again.
#[derive(Default)]
pub struct SparseCholesky {
    symbolic: Option<Symbolic>,
}

/// What a factorization takes from the places of the entries alone.
struct Symbolic {
    places: Vec<Pair<u32, u32>>,
    matrix: SymbolicSparseColMat<u32>,
    /// Where the entries are in the matrix.
    order: Argsort<u32>,
    factor: SymbolicLlt<u32>,
}

impl Symbolic {
    fn new(dim: usize, places: Vec<Pair<u32, u32>>) -> Option<Symbolic> {
        let (matrix, order) = SymbolicSparseColMat::try_new_from_indices(dim, dim, &places).ok()?;
        let factor = SymbolicLlt::try_new(matrix.as_ref(), Side::Lower).ok()?;
        Some(Symbolic { places, matrix, order, factor })
    }

    fn fits(&self, system: &SparseSystem) -> bool {
        self.matrix.nrows() == system.dim && self.places == system.places
    }
}

impl SparseCholesky {
    /// The Cholesky factor; `None` where the matrix is not positive definite.
    pub fn factor(&mut self, system: SparseSystem) -> Option<SparseFactor> {
        let symbolic = match self.symbolic.take() {
            Some(symbolic) if symbolic.fits(&system) => symbolic,
            _ => Symbolic::new(system.dim, system.places)?,
        };
        let Symbolic { matrix, order, factor, .. } = self.symbolic.insert(symbolic);
        let matrix = SparseColMat::new_from_argsort(matrix.clone(), order, &system.values).ok()?;
        let factor = Llt::try_new_with_symbolic(factor.clone(), matrix.as_ref(), Side::Lower).ok()?;
        Some(SparseFactor { dim: system.dim, factor })
    }
}

/// The Cholesky factor of a [`SparseSystem`].
pub struct SparseFactor {
    dim: usize,
    factor: Llt<u32, f64>,
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
    fn systems_one_after_the_other_have_the_factors_of_each_alone() {
        let mut rng = StdRng::seed_from_u64(5);
        let mut cholesky = SparseCholesky::default();
        let mut random = |dim: usize, begins: &[usize]| {
            let mut system = SparseSystem::new(dim);
            (0..dim).for_each(|index| system.add_diagonal(index, 2.0));
            for &begin in begins {
                let root = DMatrix::from_fn(4, 3, |_, _| rng.random_range(-1.0..1.0));
                let indices = [begin, begin + 1, begin + 3, begin + 5];
                system.add(&indices, &indices, &(&root * root.transpose()));
            }
            system
        };
        // Equal places, other places, another order of them, none but the diagonal, another size, equal places again.
        let orders: [(usize, &[usize]); 7] = [
            (20, &[1, 4, 9]),
            (20, &[1, 4, 9]),
            (20, &[2, 4, 9]),
            (20, &[9, 4, 2]),
            (20, &[]),
            (14, &[1, 4]),
            (14, &[1, 4]),
        ];
        for (dim, begins) in orders {
            let system = random(dim, begins);
            let alone = SparseSystem { dim, places: system.places.clone(), values: system.values.clone() };
            let right = DVector::from_fn(dim, |row, _| row as f64 - 3.0);
            assert_eq!(cholesky.factor(system).unwrap().solve(&right), alone.factor().unwrap().solve(&right));
        }
        let mut indefinite = SparseSystem::new(14);
        (0..14).for_each(|index| indefinite.add_diagonal(index, -1.0));
        assert!(cholesky.factor(indefinite).is_none());
        assert!(cholesky.factor(random(14, &[1, 4])).is_some());
    }

    #[test]
    fn an_indefinite_matrix_has_no_factor() {
        let mut system = SparseSystem::new(2);
        system.add_diagonal(0, 1.0);
        system.add_diagonal(1, -1.0);
        assert!(system.factor().is_none());
    }
}
