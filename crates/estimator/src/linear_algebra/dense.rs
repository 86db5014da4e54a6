//! Column-major matrices that keep their memory when their size changes, and the dense operations of an update.
//!
//! The matrices of the filter change their size with every image; with fresh memory each time a third of an
//! update is spent on page faults. The operations are `faer`'s: at the sizes of a window of 20 clones its
//! Cholesky is 2.3, its triangular solve 5.5 and its symmetric product 1.7 times as fast as nalgebra's.

use crate::linear_algebra::NotPositiveDefinite;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltRegularization, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::{matmul, triangular_solve};
use faer::{Accum, MatMut, MatRef, Par, Spec};
use nalgebra::{DMatrix, DMatrixView, DMatrixViewMut};
use std::ops::{Index, IndexMut, Range};

/// A pivot below this part of its diagonal is rounding, not information.
const ROUNDING: f64 = 1e-14;
/// Block size of the Cholesky factorization: columns factored one by one before the rest is updated in one product.
const BLOCK: usize = 16;

/// A column-major matrix that keeps its memory when its size changes.
#[derive(Clone, Debug, Default)]
pub struct Dense {
    values: Vec<f64>,
    rows: usize,
    columns: usize,
}

impl From<DMatrix<f64>> for Dense {
    fn from(matrix: DMatrix<f64>) -> Self {
        Self { rows: matrix.nrows(), columns: matrix.ncols(), values: matrix.data.into() }
    }
}

impl Index<(usize, usize)> for Dense {
    type Output = f64;

    fn index(&self, (row, column): (usize, usize)) -> &f64 {
        &self.values[column * self.rows + row]
    }
}

impl IndexMut<(usize, usize)> for Dense {
    fn index_mut(&mut self, (row, column): (usize, usize)) -> &mut f64 {
        &mut self.values[column * self.rows + row]
    }
}

impl Dense {
    /// A matrix of zeros.
    pub fn zeros(rows: usize, columns: usize) -> Self {
        Self { values: vec![0.0; rows * columns], rows, columns }
    }

    /// The identity.
    pub fn identity(dim: usize) -> Self {
        let mut identity = Self::zeros(dim, dim);
        (0..dim).for_each(|k| identity[(k, k)] = 1.0);
        identity
    }

    /// Takes a new size and becomes zero.
    pub fn reset(&mut self, rows: usize, columns: usize) {
        (self.rows, self.columns) = (rows, columns);
        self.values.clear();
        self.values.resize(rows * columns, 0.0);
    }

    /// Rows.
    pub fn nrows(&self) -> usize {
        self.rows
    }

    /// Columns.
    pub fn ncols(&self) -> usize {
        self.columns
    }

    /// The numbers of one column.
    pub fn column(&self, column: usize) -> &[f64] {
        &self.values[column * self.rows..(column + 1) * self.rows]
    }

    /// The numbers of one column.
    pub fn column_mut(&mut self, column: usize) -> &mut [f64] {
        &mut self.values[column * self.rows..(column + 1) * self.rows]
    }

    /// The numbers of one column, and those of another one to be changed.
    ///
    /// # Panics
    /// If it is the same column.
    pub fn column_and_mut(&mut self, read: usize, changed: usize) -> (&[f64], &mut [f64]) {
        let rows = self.rows;
        let (before, after) = self.values.split_at_mut(read.max(changed) * rows);
        if read < changed {
            (&before[read * rows..(read + 1) * rows], &mut after[..rows])
        } else {
            (&after[..rows], &mut before[changed * rows..(changed + 1) * rows])
        }
    }

    /// As a nalgebra view.
    pub fn view(&self) -> DMatrixView<'_, f64> {
        DMatrixView::from_slice(&self.values, self.rows, self.columns)
    }

    /// As a nalgebra view.
    pub fn view_mut(&mut self) -> DMatrixViewMut<'_, f64> {
        DMatrixViewMut::from_slice(&mut self.values, self.rows, self.columns)
    }

    /// Appends the columns of a matrix with as many rows. A matrix without columns takes the rows of the other.
    pub fn append(&mut self, other: &Self) {
        if self.columns == 0 && other.columns > 0 {
            self.rows = other.rows;
        }
        self.values.extend_from_slice(&other.values);
        self.columns += other.columns;
    }

    /// Removes columns; those behind them move up.
    pub fn remove_columns(&mut self, columns: Range<usize>) {
        self.values.drain(columns.start * self.rows..columns.end * self.rows);
        self.columns -= columns.len();
    }

    /// A matrix of these numbers, columns of `rows` numbers one after the other.
    pub fn from_columns(rows: usize, numbers: &[f64]) -> Self {
        Self { values: numbers.to_vec(), rows, columns: numbers.len() / rows.max(1) }
    }

    /// Bytes that it holds, used or not.
    pub fn heap_bytes(&self) -> usize {
        self.values.capacity() * size_of::<f64>()
    }

    /// The numbers of all columns, one after the other.
    pub fn as_slice(&self) -> &[f64] {
        &self.values
    }

    /// As a `faer` view.
    pub(crate) fn faer(&self) -> MatRef<'_, f64> {
        MatRef::from_column_major_slice(&self.values, self.rows, self.columns)
    }

    /// As a `faer` view.
    pub(crate) fn faer_mut(&mut self) -> MatMut<'_, f64> {
        MatMut::from_column_major_slice_mut(&mut self.values, self.rows, self.columns)
    }

    /// A copy of some columns.
    pub fn columns(&self, columns: Range<usize>) -> Self {
        Self::from_columns(self.rows, &self.values[columns.start * self.rows..columns.end * self.rows])
    }

    /// The rows become the old rows `source`, one range after the other. `spare` lends its memory.
    pub fn gather_rows(&mut self, source: &[Range<usize>], spare: &mut Self) {
        let rows: usize = source.iter().map(Range::len).sum();
        (spare.rows, spare.columns) = (rows, self.columns);
        spare.values.clear();
        spare.values.reserve(rows * self.columns);
        for column in 0..self.columns {
            let old = self.column(column);
            for run in source {
                spare.values.extend_from_slice(&old[run.clone()]);
            }
        }
        std::mem::swap(self, spare);
    }

    /// Inserts the rows `inserted` before the row `at`. `spare` lends its memory.
    pub fn insert_rows(&mut self, at: usize, inserted: &Self, spare: &mut Self) {
        let rows = self.rows + inserted.rows;
        (spare.rows, spare.columns) = (rows, self.columns);
        spare.values.clear();
        spare.values.reserve(rows * self.columns);
        for column in 0..self.columns {
            let (above, below) = self.column(column).split_at(at);
            for part in [above, inserted.column(column), below] {
                spare.values.extend_from_slice(part);
            }
        }
        std::mem::swap(self, spare);
    }

    /// New row and column `i` are the old `source[i]`. `spare` lends its memory.
    pub fn gather(&mut self, source: &[Range<usize>], spare: &mut Self) {
        let dim: usize = source.iter().map(Range::len).sum();
        (spare.rows, spare.columns) = (dim, dim);
        spare.values.clear();
        spare.values.reserve(dim * dim);
        for column in source.iter().flat_map(Clone::clone) {
            let old = self.column(column);
            for run in source {
                spare.values.extend_from_slice(&old[run.clone()]);
            }
        }
        std::mem::swap(self, spare);
    }

    /// Becomes a copy of `other`.
    pub fn copy_from(&mut self, other: &Self) {
        (self.rows, self.columns) = (other.rows, other.columns);
        self.values.clone_from(&other.values);
    }

    /// Transposes the lower triangle into the upper one and leaves zeros below.
    pub fn transpose_lower(&mut self) {
        self.mirror_lower();
        for column in 0..self.columns {
            self.column_mut(column)[column + 1..].fill(0.0);
        }
    }

    /// Copies the lower triangle into the upper one.
    pub fn mirror_lower(&mut self) {
        for column in 1..self.columns {
            for row in 0..column {
                self.values[column * self.rows + row] = self.values[row * self.rows + column];
            }
        }
    }

    /// `self right`.
    pub fn times(&self, right: &Self) -> Self {
        let mut product = Self::zeros(self.rows, right.columns);
        product.add_product(self, 0..self.columns, right, 0..right.rows, BlockStructure::Rectangular);
        product
    }

    /// `self += left[.., columns] right[rows, ..]`.
    pub fn add_product(
        &mut self,
        left: &Self,
        columns: Range<usize>,
        right: &Self,
        rows: Range<usize>,
        left_is: BlockStructure,
    ) {
        let left = left.faer().subcols(columns.start, columns.len());
        let right = right.faer().subrows(rows.start, rows.len());
        let rectangular = BlockStructure::Rectangular;
        if left_is == rectangular {
            matmul::matmul(self.faer_mut(), Accum::Add, left, right, 1.0, Par::Seq);
        } else {
            triangular::matmul(
                self.faer_mut(),
                rectangular,
                Accum::Add,
                left,
                left_is,
                right,
                rectangular,
                1.0,
                Par::Seq,
            );
        }
    }

    /// The lower triangle of `self += left[.., left_columns] right[.., right_columns]ᵀ`.
    pub fn add_lower_outer(
        &mut self,
        left: &Self,
        left_columns: Range<usize>,
        right: &Self,
        right_columns: Range<usize>,
    ) {
        triangular::matmul(
            self.faer_mut(),
            BlockStructure::TriangularLower,
            Accum::Add,
            left.faer().subcols(left_columns.start, left_columns.len()),
            BlockStructure::Rectangular,
            right.faer().subcols(right_columns.start, right_columns.len()).transpose(),
            BlockStructure::Rectangular,
            1.0,
            Par::Seq,
        );
    }

    /// The lower triangle of `self -= factorᵀ factor`.
    pub fn subtract_gram(&mut self, factor: &Self) {
        triangular::matmul(
            self.faer_mut(),
            BlockStructure::TriangularLower,
            Accum::Add,
            factor.faer().transpose(),
            BlockStructure::Rectangular,
            factor.faer(),
            BlockStructure::Rectangular,
            -1.0,
            Par::Seq,
        );
    }

    /// `self ← L⁻¹ self` with the lower triangle of `lower`.
    pub fn solve_lower(&mut self, lower: &Self) {
        triangular_solve::solve_lower_triangular_in_place(lower.faer(), self.faer_mut(), Par::Seq);
    }
}

/// Cholesky factorization with reused scratch memory.
#[derive(Default)]
pub struct Factorization {
    buffer: Option<(usize, MemBuffer)>,
    diagonal: Vec<f64>,
}

impl std::fmt::Debug for Factorization {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Factorization").finish_non_exhaustive()
    }
}

impl Clone for Factorization {
    /// Scratch memory has no content to copy.
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Factorization {
    /// `A = L Lᵀ` in the lower triangle of `matrix`; the upper one is left as it was.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`].
    pub fn cholesky(&mut self, matrix: &mut Dense) -> Result<(), NotPositiveDefinite> {
        let dim = matrix.rows;
        if self.buffer.as_ref().is_none_or(|(room, _)| *room < dim) {
            let need = cholesky_in_place_scratch::<f64>(dim, Par::Seq, Spec::default());
            self.buffer = Some((dim, MemBuffer::new(need)));
        }
        let Some((_, buffer)) = &mut self.buffer else { return Err(NotPositiveDefinite) };
        let stack = MemStack::new(buffer);
        cholesky_in_place(matrix.faer_mut(), LltRegularization::default(), Par::Seq, stack, Spec::default())
            .map_err(|_| NotPositiveDefinite)?;
        // A matrix with NaN has no pivot that compares as negative.
        if (0..dim).all(|k| matrix[(k, k)].is_finite()) { Ok(()) } else { Err(NotPositiveDefinite) }
    }

    /// `A = L Lᵀ` of a matrix that may be singular: columns whose pivot is rounding are zero in `L`.
    ///
    /// Our own, because `faer`'s regularization leaves out the last rows of a matrix (0.24.4).
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] where a number is NaN.
    pub fn semidefinite_cholesky(&mut self, matrix: &mut Dense) -> Result<(), NotPositiveDefinite> {
        let dim = matrix.rows;
        self.diagonal.clear();
        self.diagonal.extend((0..dim).map(|k| matrix[(k, k)]));
        for begin in (0..dim).step_by(BLOCK) {
            let end = (begin + BLOCK).min(dim);
            for k in begin..end {
                let (done, rest) = matrix.values.split_at_mut((k + 1) * dim);
                let column = &mut done[k * dim..];
                let pivot = column[k];
                if !pivot.is_finite() {
                    return Err(NotPositiveDefinite);
                }
                if pivot <= ROUNDING * self.diagonal[k] {
                    column[k..].fill(0.0);
                    continue;
                }
                let inverse = 1.0 / pivot.sqrt();
                column[k..].iter_mut().for_each(|value| *value *= inverse);
                for (j, target) in (k + 1..end).zip(rest.chunks_exact_mut(dim)) {
                    let factor = column[j];
                    for (number, value) in target[j..].iter_mut().zip(&column[j..]) {
                        *number -= factor * value;
                    }
                }
            }
            let (done, rest) = matrix.values.split_at_mut(end * dim);
            let panel = MatRef::from_column_major_slice(&done[begin * dim..], dim, end - begin);
            let panel = panel.subrows(end, dim - end);
            let rest = MatMut::from_column_major_slice_mut(rest, dim, dim - end);
            triangular::matmul(
                rest.subrows_mut(end, dim - end),
                BlockStructure::TriangularLower,
                Accum::Add,
                panel,
                BlockStructure::Rectangular,
                panel.transpose(),
                BlockStructure::Rectangular,
                -1.0,
                Par::Seq,
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |row, column| ((3 * row + 7 * column + row * column) as f64).sin())
    }

    fn lower(matrix: &Dense) -> DMatrix<f64> {
        matrix.view().lower_triangle()
    }

    #[test]
    fn the_factor_of_a_singular_matrix_reproduces_it() {
        for (dim, rank) in [(5, 5), (40, 36), (126, 90), (7, 0)] {
            // Badly scaled, as information about radians and metres is.
            let scale =
                DMatrix::from_diagonal(&nalgebra::DVector::from_fn(dim, |k, _| 10_f64.powi(k as i32 % 5)));
            let half = &scale * wave(dim, rank);
            let matrix = &half * half.transpose();
            let mut factor = Dense::from(matrix.clone());
            Factorization::default().semidefinite_cholesky(&mut factor).unwrap();
            let factor = lower(&factor);
            let inverse = scale.try_inverse().unwrap();
            let difference = &inverse * (&factor * factor.transpose() - matrix) * &inverse;
            assert!(difference.amax() < 1e-9 * dim as f64, "{dim}: {}", difference.amax());
        }
        let mut broken = Dense::from(DMatrix::from_element(3, 3, f64::NAN));
        assert!(Factorization::default().semidefinite_cholesky(&mut broken).is_err());
        let mut negative = Dense::from(-DMatrix::<f64>::identity(3, 3));
        assert!(Factorization::default().cholesky(&mut negative).is_err());
    }

    #[test]
    fn gather_selects_rows_and_columns() {
        let matrix = wave(6, 6);
        let mut dense = Dense::from(matrix.clone());
        dense.gather(&[0..2, 4..6, 1..3], &mut Dense::default());
        let source = [0, 1, 4, 5, 1, 2];
        assert_eq!(dense.view(), matrix.select_rows(&source).select_columns(&source));
    }

    #[test]
    fn rows_and_columns_come_and_go_as_in_a_matrix_that_is_built_anew() {
        let before = wave(30, 4);
        let mut spare = Dense::default();
        // Kept, repeated, left out, exchanged, all gone.
        let sources: [&[Range<usize>]; 5] =
            [&[0..10, 10..30], &[0..30, 0..6], &[0..5, 11..20, 20..30], &[20..30, 0..20, 3..4], &[]];
        for source in sources {
            let mut matrix = Dense::from(before.clone());
            matrix.gather_rows(source, &mut spare);
            let rows: Vec<usize> = source.iter().cloned().flatten().collect();
            assert_eq!(matrix.view(), before.select_rows(&rows), "{source:?}");
        }
        for count in [1, 6, 40] {
            let mut matrix = Dense::from(before.clone());
            matrix.insert_rows(7, &Dense::from(wave(count, 4)), &mut spare);
            let mut expected = before.clone().insert_rows(7, count, 0.0);
            expected.rows_mut(7, count).copy_from(&wave(count, 4));
            assert_eq!(matrix.view(), expected);
        }
        let mut matrix = Dense::from(before.clone());
        assert_eq!(matrix.columns(1..3).view(), before.columns(1, 2));
        matrix.remove_columns(1..3);
        matrix.append(&Dense::zeros(30, 1));
        assert_eq!(matrix.view(), before.clone().remove_columns(1, 2).insert_column(2, 0.0));
    }

    #[test]
    fn products_equal_those_of_nalgebra() {
        let (a, b) = (wave(9, 7), wave(7, 5));
        let mut product = Dense::zeros(9, 5);
        let (left, right) = (Dense::from(a.clone()), Dense::from(b.clone()));
        product.add_product(&left, 2..5, &right, 1..4, BlockStructure::Rectangular);
        assert!((product.view() - a.columns(2, 3) * b.rows(1, 3)).amax() < 1e-12);
        let mut square = Dense::zeros(5, 5);
        square.subtract_gram(&right);
        assert!((lower(&square) + (b.transpose() * &b).lower_triangle()).amax() < 1e-12);
    }
}
