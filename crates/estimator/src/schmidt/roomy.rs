//! A column-major matrix with room below its rows, so that rows come and go without every number being moved.
//!
//! With each image a clone enters and another leaves: six rows at the end are copied, and those behind six others move up.
//! Columns packed tightly would all have to move for that, 340 of 231 numbers in the bench, two or three times an image.

use crate::linear_algebra::dense::Dense;
use faer::{MatMut, MatRef};
use smallvec::SmallVec;
use std::ops::Range;

/// Rows that there is room for when the rows have outgrown the room: two clones more, or four landmarks.
const FURTHER_ROWS: usize = 12;
/// Numbers in a cache line. A column is an odd number of lines long, so that the rows of neighbouring columns do not
/// compete for the same places of the cache.
const LINE: usize = 8;

/// See the module's text.
#[derive(Clone, Debug)]
pub struct Roomy {
    values: Vec<f64>,
    rows: usize,
    columns: usize,
    /// From one column to the next; at least `rows`. What lies between is of no meaning.
    stride: usize,
    /// Of one column, while its rows are arranged anew.
    spare: Vec<f64>,
}

impl Roomy {
    /// Without columns.
    pub fn new(rows: usize) -> Self {
        Self { values: Vec::new(), rows, columns: 0, stride: stride_for(rows), spare: Vec::new() }
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
        &self.values[column * self.stride..][..self.rows]
    }

    /// The numbers of one column.
    pub fn column_mut(&mut self, column: usize) -> &mut [f64] {
        &mut self.values[column * self.stride..][..self.rows]
    }

    /// The numbers of some columns, one after the other.
    pub fn numbers(&self, columns: Range<usize>) -> Vec<f64> {
        columns.flat_map(|column| self.column(column)).copied().collect()
    }

    /// Puts whole columns, one after the other in `numbers`, behind the others.
    pub fn push_columns(&mut self, numbers: &[f64]) {
        for column in numbers.chunks_exact(self.rows) {
            self.values.extend_from_slice(column);
            self.columns += 1;
            self.values.resize(self.columns * self.stride, 0.0);
        }
    }

    /// Puts columns of zeros behind the others.
    pub fn push_zeros(&mut self, count: usize) {
        self.columns += count;
        self.values.resize(self.columns * self.stride, 0.0);
    }

    /// Takes columns out; those behind them move up.
    pub fn remove_columns(&mut self, columns: Range<usize>) {
        self.values.drain(columns.start * self.stride..columns.end * self.stride);
        self.columns -= columns.len();
    }

    /// Puts others in the place of the first `count` columns.
    pub fn replace_first(&mut self, count: usize, by: &Dense) {
        let rest = self.values.split_off(count * self.stride);
        let columns = self.columns - count;
        (self.columns, self.rows) = (0, by.nrows());
        self.values.clear();
        self.push_columns(by.as_slice());
        self.values.extend(rest);
        self.columns += columns;
    }

    /// The rows become the old rows `source`, one range after the other.
    pub fn gather_rows(&mut self, source: &[Range<usize>]) {
        let mut runs = SmallVec::<[Range<usize>; 32]>::new();
        for run in source {
            match runs.last_mut() {
                Some(last) if last.end == run.start => last.end = run.end,
                _ => runs.push(run.clone()),
            }
        }
        // What stays where it is.
        let kept = runs.first().filter(|run| run.start == 0).map_or(0, |run| run.end);
        let moved = if kept > 0 { &runs[1..] } else { &runs[..] };
        let old_rows = self.rows;
        self.set_rows(kept + moved.iter().map(Range::len).sum::<usize>());
        for column in self.values.chunks_exact_mut(self.stride) {
            self.spare.clear();
            for run in moved {
                self.spare.extend_from_slice(&column[..old_rows][run.clone()]);
            }
            column[kept..self.rows].copy_from_slice(&self.spare);
        }
    }

    /// Puts rows before the row `at`, `count` numbers of each column in `inserted`.
    pub fn insert_rows(&mut self, at: usize, inserted: &Dense) {
        let (old_rows, count) = (self.rows, inserted.nrows());
        self.set_rows(old_rows + count);
        for (k, column) in self.values.chunks_exact_mut(self.stride).enumerate() {
            column.copy_within(at..old_rows, at + count);
            column[at..at + count].copy_from_slice(inserted.column(k));
        }
    }

    /// Rows that are new have no meaning yet.
    fn set_rows(&mut self, rows: usize) {
        if rows > self.stride {
            let stride = stride_for(rows);
            let mut values = vec![0.0; self.columns * stride];
            for (new, old) in values.chunks_exact_mut(stride).zip(self.values.chunks_exact(self.stride)) {
                new[..self.stride].copy_from_slice(old);
            }
            (self.values, self.stride) = (values, stride);
        }
        self.rows = rows;
    }

    /// As `faer` sees it.
    pub fn faer(&self) -> MatRef<'_, f64> {
        MatRef::from_column_major_slice_with_stride(&self.values, self.rows, self.columns, self.stride)
    }

    /// As `faer` sees it.
    pub fn faer_mut(&mut self) -> MatMut<'_, f64> {
        MatMut::from_column_major_slice_with_stride_mut(
            &mut self.values,
            self.rows,
            self.columns,
            self.stride,
        )
    }

    /// Bytes that it holds, used or not.
    pub fn heap_bytes(&self) -> usize {
        (self.values.capacity() + self.spare.capacity()) * size_of::<f64>()
    }
}

fn stride_for(rows: usize) -> usize {
    ((rows + FURTHER_ROWS).div_ceil(LINE) | 1) * LINE
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    fn wave(rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |row, column| (100 * row + column) as f64)
    }

    fn roomy(matrix: &DMatrix<f64>) -> Roomy {
        let mut roomy = Roomy::new(matrix.nrows());
        roomy.push_columns(matrix.as_slice());
        roomy
    }

    fn dense(roomy: &Roomy) -> DMatrix<f64> {
        DMatrix::from_vec(roomy.nrows(), roomy.ncols(), roomy.numbers(0..roomy.ncols()))
    }

    #[test]
    fn rows_come_and_go_as_in_a_matrix_that_is_built_anew() {
        let before = wave(30, 4);
        // Kept, repeated, left out, exchanged, outgrown, all gone.
        let sources: [&[Range<usize>]; 6] = [
            &[0..10, 10..30],
            &[0..30, 0..6],
            &[0..5, 11..20, 20..30],
            &[20..30, 0..20, 3..4],
            &[0..30, 0..30, 10..30],
            &[],
        ];
        for source in sources {
            let mut matrix = roomy(&before);
            matrix.gather_rows(source);
            let rows: Vec<usize> = source.iter().cloned().flatten().collect();
            assert_eq!(dense(&matrix), before.select_rows(&rows), "{source:?}");
            assert_eq!(matrix.faer().nrows(), rows.len());
        }
        for count in [1, 6, 40] {
            let mut matrix = roomy(&before);
            matrix.insert_rows(7, &Dense::from(wave(count, 4)));
            let mut expected = before.clone().insert_rows(7, count, 0.0);
            expected.rows_mut(7, count).copy_from(&wave(count, 4));
            assert_eq!(dense(&matrix), expected);
        }
    }

    #[test]
    fn columns_come_and_go() {
        let before = wave(10, 6);
        let mut matrix = roomy(&before);
        matrix.remove_columns(1..3);
        matrix.push_zeros(1);
        assert_eq!(dense(&matrix), before.clone().remove_columns(1, 2).insert_column(4, 0.0));
        matrix.replace_first(3, &Dense::from(wave(10, 1)));
        assert_eq!(matrix.ncols(), 3);
        assert_eq!(matrix.column(0), wave(10, 1).as_slice());
        assert_eq!(matrix.column(1), before.column(5).as_slice());
        assert_eq!(matrix.column(2), [0.0; 10]);
    }
}
