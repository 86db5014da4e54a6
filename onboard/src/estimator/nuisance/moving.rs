//! What every step of the filter multiplies from the left, in one matrix `[R | M]`.
//!
//! `M` (n x 6 a keyframe) are the loadings of the active keyframes. `R` (n x rows at that time) is all that happened to the
//! rows of the state since keyframes were last parked; it has no columns while none is. Rows are those of the active error.

use super::super::dense::Dense;
use super::super::information::{Columns, Rows};
use super::super::propagation::{IMU_DIM, ImuMatrix};
use faer::linalg::matmul::triangular::BlockStructure;
use nalgebra::DMatrixView;
use std::ops::Range;

/// Numbers of a keyframe's error.
pub const KEYFRAME_DIM: usize = 6;

/// `[R | M]`; see the module's text.
#[derive(Clone, Debug)]
pub struct Moving {
    matrix: Dense,
    /// Columns of `R`.
    running: usize,
    spare: Dense,
}

impl Moving {
    /// No keyframe, beside an active error of `rows` numbers.
    pub fn new(rows: usize) -> Self {
        Self { matrix: Dense::zeros(rows, 0), running: 0, spare: Dense::default() }
    }

    /// Numbers of the active error.
    pub fn nrows(&self) -> usize {
        self.matrix.nrows()
    }

    /// `M` of one slot, columns one after the other.
    pub fn loadings(&self, slot: usize) -> &[f64] {
        let columns = self.columns_of(slot);
        &self.matrix.as_slice()[columns.start * self.nrows()..columns.end * self.nrows()]
    }

    /// Adds the `M` of a further slot, columns one after the other.
    pub fn push(&mut self, loadings: &[f64]) {
        self.matrix.extend_columns(loadings.iter().copied());
    }

    /// Adds a further slot of zeros.
    pub fn push_zeros(&mut self) {
        self.matrix.extend_columns(std::iter::repeat_n(0.0, KEYFRAME_DIM * self.nrows()));
    }

    /// Takes the `M` of a slot out; those behind it move up.
    pub fn remove(&mut self, slot: usize) {
        self.matrix.remove_columns(self.columns_of(slot));
    }

    /// `target += M B` with the `M` of one slot.
    pub fn add_loadings_times(&self, slot: usize, block: &Dense, target: &mut Dense) {
        let rows = 0..KEYFRAME_DIM;
        target.add_product(&self.matrix, self.columns_of(slot), block, rows, BlockStructure::Rectangular);
    }

    /// `M += R`: a slot's loadings grow by `increase`, columns one after the other.
    pub fn add_to_loadings(&mut self, slot: usize, increase: &[f64]) {
        let n = self.nrows();
        for (k, numbers) in increase.chunks_exact(n).enumerate() {
            let column = self.matrix.column_mut(self.running + KEYFRAME_DIM * slot + k);
            column.iter_mut().zip(numbers).for_each(|(sum, number)| *sum += number);
        }
    }

    /// `R X`.
    pub fn times_running(&self, right: &Dense) -> Dense {
        let mut product = Dense::zeros(self.nrows(), right.ncols());
        product.add_product(
            &self.matrix,
            0..self.running,
            right,
            0..self.running,
            BlockStructure::Rectangular,
        );
        product
    }

    /// Begins `R` anew, at the identity, and returns what it was.
    pub fn freeze(&mut self) -> Dense {
        let n = self.nrows();
        let mut identity = Dense::zeros(n, n);
        (0..n).for_each(|k| identity[(k, k)] = 1.0);
        self.replace_running(identity)
    }

    /// `R ← R S`: nothing is parked any more where `R` began, but where `S` did.
    pub fn lengthen(&mut self, before: &Dense) {
        let longer = self.times_running(before);
        self.replace_running(longer);
    }

    /// Nothing is parked any more.
    pub fn stop(&mut self) {
        self.replace_running(Dense::zeros(self.nrows(), 0));
    }

    /// `R`.
    pub fn running(&self) -> Dense {
        let n = self.nrows();
        Dense::from_columns(n, &self.matrix.as_slice()[..n * self.running])
    }

    /// Puts another matrix in the place of `R` and returns what it was.
    pub fn replace_running(&mut self, running: Dense) -> Dense {
        let old = std::mem::replace(&mut self.matrix, running);
        let (n, columns) = (old.nrows(), self.running);
        self.running = self.matrix.ncols();
        self.matrix.extend_columns(old.as_slice()[n * columns..].iter().copied());
        let mut was = old;
        was.remove_columns(columns..was.ncols());
        was
    }

    fn columns_of(&self, slot: usize) -> Range<usize> {
        let begin = self.running + KEYFRAME_DIM * slot;
        begin..begin + KEYFRAME_DIM
    }

    /// `← F [R | M]` for an `F` that touches only the IMU's rows, which are the first.
    pub fn transform_rows(&mut self, transition: &ImuMatrix) {
        for column in 0..self.matrix.ncols() {
            let own = &mut self.matrix.column_mut(column)[..IMU_DIM];
            let mut moved = [0.0; IMU_DIM];
            for (factors, number) in transition.as_slice().chunks_exact(IMU_DIM).zip(&*own) {
                for (sum, factor) in moved.iter_mut().zip(factors) {
                    *sum += factor * number;
                }
            }
            own.copy_from_slice(&moved);
        }
    }

    /// The rows become the old rows `source`, one range after the other.
    pub fn gather_rows(&mut self, source: &[Range<usize>]) {
        let rows = source.iter().map(Range::len).sum();
        self.spare.reset(rows, 0);
        for column in 0..self.matrix.ncols() {
            let old = self.matrix.column(column);
            self.spare.extend_columns(source.iter().flat_map(|run| old[run.clone()].iter().copied()));
        }
        std::mem::swap(&mut self.matrix, &mut self.spare);
    }

    /// The error at `begin` grew by `jacobian` times the error at `of`.
    pub fn add_dependence(&mut self, begin: usize, jacobian: &[f64], of: usize) {
        for column in 0..self.matrix.ncols() {
            let own = self.matrix.column_mut(column);
            let number = own[of];
            for (target, factor) in own[begin..].iter_mut().zip(jacobian) {
                *target += factor * number;
            }
        }
    }

    /// The active error grew at `at` by `jacobian` times its part `columns`, and something independent.
    pub fn insert_rows(&mut self, at: usize, columns: &Columns, jacobian: DMatrixView<'_, f64>) {
        let (count, rows) = (jacobian.nrows(), self.nrows());
        self.spare.reset(rows + count, self.matrix.ncols());
        let old = self.matrix.view();
        let mut grown = self.spare.view_mut();
        grown.rows_mut(0, at).copy_from(&old.rows(0, at));
        grown.rows_mut(at + count, rows - at).copy_from(&old.rows(at, rows - at));
        for (range, here) in columns.runs() {
            let part = jacobian.columns(here.start, here.len());
            grown.rows_mut(at, count).gemm(1.0, &part, &old.rows(range.start, range.len()), 1.0);
        }
        std::mem::swap(&mut self.matrix, &mut self.spare);
    }

    /// `M -= Wᵀ L⁻¹ H (M_C; scale E_T)` and `R -= Wᵀ L⁻¹ H_C R_C`.
    ///
    /// # Arguments
    /// * `whitened`: `W`.
    /// * `innovation`: `L` in its lower triangle.
    /// * `scale`: by how much the loadings are scaled.
    pub fn measurement_update(&mut self, rows: &Rows, whitened: &Dense, innovation: &Dense, scale: f64) {
        let touched = &mut self.spare;
        touched.reset(rows.jacobian.nrows(), self.matrix.ncols());
        for (range, here) in rows.columns.runs() {
            touched.add_product(&rows.jacobian, here, &self.matrix, range, rows.shape());
        }
        let own = rows.columns.active_len();
        for (k, &slot) in rows.columns.keyframes.iter().enumerate() {
            for j in 0..KEYFRAME_DIM {
                let column = touched.column_mut(self.running + KEYFRAME_DIM * slot + j);
                let jacobian = rows.jacobian.column(own + KEYFRAME_DIM * k + j);
                column.iter_mut().zip(jacobian).for_each(|(sum, number)| *sum += scale * number);
            }
        }
        touched.solve_lower(innovation);
        self.matrix.subtract_transposed_product(whitened, touched);
    }

    /// Bytes on the heap.
    pub fn heap_bytes(&self) -> usize {
        self.matrix.heap_bytes() + self.spare.heap_bytes()
    }
}
