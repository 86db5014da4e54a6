//! Symmetric, positive definite, sparse systems of equations, factored by `faer` with an approximate minimum degree order.

use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{Argsort, Pair, SparseColMat, SymbolicSparseColMat};
use faer::{MatMut, Side};
use nalgebra::{DMatrix, DVector, Dim, Matrix, RawStorage};
use std::collections::HashMap;

/// Rows and columns of a tile: rotations, positions, velocities and biases have three numbers.
const TILE: usize = 3;

/// The lower half of a symmetric matrix, of which most is zero.
///
/// What is added is summed at once, in tiles of 3 by 3: a landmark that hundreds of keyframes see adds to hundreds of thousands of
/// numbers, which other landmarks add to as well.
#[derive(Clone)]
pub struct SparseSystem {
    dim: usize,
    /// The number of each tile in `tiles`, by column and row of tiles.
    numbers: HashMap<(u32, u32), usize>,
    /// Their numbers, column by column.
    tiles: Vec<[f64; TILE * TILE]>,
}

/// Consecutive indices of a block that are in one tile.
struct Run {
    tile: u32,
    /// The first one, as an index of the block.
    begin: usize,
    /// Where each is in the tile.
    offsets: Vec<usize>,
}

impl Run {
    fn all_of(indices: &[usize]) -> Vec<Run> {
        let mut runs: Vec<Run> = Vec::new();
        for (place, &index) in indices.iter().enumerate() {
            let (tile, offset) = ((index / TILE) as u32, index % TILE);
            match runs.last_mut().filter(|run| run.tile == tile) {
                Some(run) => run.offsets.push(offset),
                None => runs.push(Run { tile, begin: place, offsets: vec![offset] }),
            }
        }
        runs
    }
}

impl SparseSystem {
    /// Zero, with so many rows, which are fewer than 2^32.
    pub fn new(dim: usize) -> SparseSystem {
        SparseSystem { dim, numbers: HashMap::new(), tiles: Vec::new() }
    }

    /// Adds one number to the diagonal.
    pub fn add_diagonal(&mut self, index: usize, value: f64) {
        let tile = (index / TILE) as u32;
        self.tile(tile, tile)[(index % TILE) * (TILE + 1)] += value;
    }

    /// Adds a block whose rows and columns are at the given indices. Of what lies above the diagonal nothing is added: a
    /// symmetric block is given whole, of any other pair of rows and columns one of the two.
    pub fn add<R: Dim, C: Dim, S: RawStorage<f64, R, C>>(
        &mut self,
        rows: &[usize],
        columns: &[usize],
        block: &Matrix<f64, R, C, S>,
    ) {
        let (rows, columns) = (Run::all_of(rows), Run::all_of(columns));
        for of_columns in &columns {
            for of_rows in rows.iter().filter(|run| run.tile >= of_columns.tile) {
                let tile = self.tile(of_rows.tile, of_columns.tile);
                for (j, column) in of_columns.offsets.iter().enumerate() {
                    for (i, row) in of_rows.offsets.iter().enumerate() {
                        tile[TILE * column + row] += block[(of_rows.begin + i, of_columns.begin + j)];
                    }
                }
            }
        }
    }

    fn tile(&mut self, row: u32, column: u32) -> &mut [f64; TILE * TILE] {
        let tiles = &mut self.tiles;
        let number = *self.numbers.entry((column, row)).or_insert_with(|| {
            tiles.push([0.0; TILE * TILE]);
            tiles.len() - 1
        });
        &mut tiles[number]
    }

    /// The numbers of all tiles on and below the diagonal, with their places; in the same order whatever was added first.
    fn entries(&self) -> (Vec<Pair<u32, u32>>, Vec<f64>) {
        let mut sorted: Vec<((u32, u32), usize)> =
            self.numbers.iter().map(|(at, number)| (*at, *number)).collect();
        sorted.sort_unstable();
        let mut places = Vec::with_capacity(TILE * TILE * sorted.len());
        let mut values = Vec::with_capacity(places.capacity());
        for ((tile_column, tile_row), number) in sorted {
            for (place, value) in self.tiles[number].iter().enumerate() {
                let (row, column) =
                    (TILE * tile_row as usize + place % TILE, TILE * tile_column as usize + place / TILE);
                if column <= row && row < self.dim {
                    places.push(Pair::new(row as u32, column as u32));
                    values.push(*value);
                }
            }
        }
        (places, values)
    }

    /// The product with a vector.
    pub fn times(&self, vector: &DVector<f64>) -> DVector<f64> {
        let (places, values) = self.entries();
        let mut product = DVector::zeros(self.dim);
        for (place, value) in places.iter().zip(values) {
            let (row, column) = (place.row as usize, place.col as usize);
            product[row] += value * vector[column];
            if row != column {
                product[column] += value * vector[row];
            }
        }
        product
    }

    /// The Cholesky factor; `None` where the matrix is not positive definite.
    pub fn factor(&self) -> Option<SparseFactor> {
        SparseCholesky::default().factor(self)
    }
}

/// Factors systems one after the other. Where the entries of one are at the places of the last one's, as from step to step of an
/// adjustment, they are neither sorted nor ordered for elimination again.
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

    fn fits(&self, dim: usize, places: &[Pair<u32, u32>]) -> bool {
        self.matrix.nrows() == dim && self.places == places
    }
}

impl SparseCholesky {
    /// The Cholesky factor; `None` where the matrix is not positive definite.
    pub fn factor(&mut self, system: &SparseSystem) -> Option<SparseFactor> {
        let (places, values) = system.entries();
        let symbolic = match self.symbolic.take() {
            Some(symbolic) if symbolic.fits(system.dim, &places) => symbolic,
            _ => Symbolic::new(system.dim, places)?,
        };
        let Symbolic { matrix, order, factor, .. } = self.symbolic.insert(symbolic);
        let matrix = SparseColMat::new_from_argsort(matrix.clone(), order, &values).ok()?;
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
        assert!((&dense * factor.solve(&right) - &right).amax() < 1e-12);
        assert!((&dense * &right - system.times(&right)).amax() < 1e-12);
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
            let alone = system.factor().unwrap();
            let right = DVector::from_fn(dim, |row, _| row as f64 - 3.0);
            assert_eq!(cholesky.factor(&system).unwrap().solve(&right), alone.solve(&right));
        }
        let mut indefinite = SparseSystem::new(14);
        (0..14).for_each(|index| indefinite.add_diagonal(index, -1.0));
        assert!(cholesky.factor(&indefinite).is_none());
        assert!(cholesky.factor(&random(14, &[1, 4])).is_some());
    }

    #[test]
    fn an_indefinite_matrix_has_no_factor() {
        let mut system = SparseSystem::new(2);
        system.add_diagonal(0, 1.0);
        system.add_diagonal(1, -1.0);
        assert!(system.factor().is_none());
    }
}
