//! What every step of the filter multiplies from the left, in one matrix `[R | M]`.
//!
//! `M` (n x 6 a keyframe) are the loadings of the active keyframes. `R` (n x rows at that time) is all that happened to the
//! rows of the state since keyframes were last parked; it has no columns while none is. Rows are those of the active error.

use super::roomy::Roomy;
use crate::linear_algebra::dense::Dense;
use crate::measurement::{LinearizedMeasurement, StateBlocks};
use crate::propagation::{IMU_DIM, ImuMatrix};
use faer::linalg::matmul::matmul;
use faer::{Accum, MatRef, Par};
use std::ops::Range;

/// Numbers of a keyframe's error.
pub const KEYFRAME_DIM: usize = 6;

/// `[R | M]`; see the module's text.
#[derive(Clone, Debug)]
pub struct Moving {
    matrix: Roomy,
    /// Columns of `R`.
    running: usize,
    /// Memory that a step needs: of small rows, and of as many columns as `[R | M]`.
    factor: Dense,
    touched: Dense,
}

impl Moving {
    /// No keyframe, beside an active error of `rows` numbers.
    pub fn new(rows: usize) -> Self {
        Self { matrix: Roomy::new(rows), running: 0, factor: Dense::default(), touched: Dense::default() }
    }

    /// Numbers of the active error.
    pub fn nrows(&self) -> usize {
        self.matrix.nrows()
    }

    /// `M` of one slot, columns one after the other.
    pub fn loadings(&self, slot: usize) -> Vec<f64> {
        self.matrix.numbers(self.columns_of(slot))
    }

    /// Adds the `M` of a further slot, columns one after the other.
    pub fn push(&mut self, loadings: &[f64]) {
        self.matrix.push_columns(loadings);
    }

    /// Adds a further slot of zeros.
    pub fn push_zeros(&mut self) {
        self.matrix.push_zeros(KEYFRAME_DIM);
    }

    /// Takes the `M` of a slot out; those behind it move up.
    pub fn remove(&mut self, slot: usize) {
        self.matrix.remove_columns(self.columns_of(slot));
    }

    /// `target += M B` with the `M` of one slot.
    pub fn add_loadings_times(&self, slot: usize, block: &Dense, target: &mut Dense) {
        let own = self.matrix.faer().subcols(self.columns_of(slot).start, KEYFRAME_DIM);
        matmul(target.faer_mut(), Accum::Add, own, block.faer(), 1.0, Par::Seq);
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
        let running = self.matrix.faer().subcols(0, self.running);
        matmul(product.faer_mut(), Accum::Add, running, right.faer(), 1.0, Par::Seq);
        product
    }

    /// Begins `R` anew, at the identity, and returns what it was.
    pub fn freeze(&mut self) -> Dense {
        let n = self.nrows();
        let mut identity = Dense::zeros(n, n);
        (0..n).for_each(|k| identity[(k, k)] = 1.0);
        let was = self.running();
        self.replace_running(&identity);
        was
    }

    /// `R ← R S`: nothing is parked any more where `R` began, but where `S` did.
    pub fn lengthen(&mut self, before: &Dense) {
        let longer = self.times_running(before);
        self.replace_running(&longer);
    }

    /// Nothing is parked any more.
    pub fn stop(&mut self) {
        self.replace_running(&Dense::zeros(self.nrows(), 0));
    }

    /// `R`.
    pub fn running(&self) -> Dense {
        Dense::from_columns(self.nrows(), &self.matrix.numbers(0..self.running))
    }

    /// Puts another matrix in the place of `R`.
    pub fn replace_running(&mut self, running: &Dense) {
        self.matrix.replace_first(self.running, running);
        self.running = running.ncols();
    }

    fn columns_of(&self, slot: usize) -> Range<usize> {
        let begin = self.running + KEYFRAME_DIM * slot;
        begin..begin + KEYFRAME_DIM
    }

    /// `← F [R | M]` for an `F` that touches only the IMU's rows, which are the first.
    pub fn transform_rows(&mut self, transition: &ImuMatrix) {
        self.touched.reset(IMU_DIM, self.matrix.ncols());
        for column in 0..self.matrix.ncols() {
            self.touched.column_mut(column).copy_from_slice(&self.matrix.column(column)[..IMU_DIM]);
        }
        let transition = MatRef::from_column_major_slice(transition.as_slice(), IMU_DIM, IMU_DIM);
        let own = self.matrix.faer_mut().subrows_mut(0, IMU_DIM);
        matmul(own, Accum::Replace, transition, self.touched.faer(), 1.0, Par::Seq);
    }

    /// The rows become the old rows `source`, one range after the other.
    pub fn gather_rows(&mut self, source: &[Range<usize>]) {
        self.matrix.gather_rows(source);
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
    pub fn insert_rows(&mut self, at: usize, columns: &StateBlocks, jacobian: &Dense) {
        times_columns(&self.matrix, columns, jacobian, &mut self.touched);
        self.matrix.insert_rows(at, &self.touched);
    }

    /// `M -= Wᵀ L⁻¹ H (M_C; scale E_T)` and `R -= Wᵀ L⁻¹ H_C R_C`.
    ///
    /// # Arguments
    /// * `whitened`: `W`.
    /// * `innovation`: `L` in its lower triangle.
    /// * `scale`: by how much the loadings are scaled.
    pub fn measurement_update(
        &mut self,
        rows: &LinearizedMeasurement,
        whitened: &Dense,
        innovation: &Dense,
        scale: f64,
    ) {
        // On the few columns of H, and not on all of its products.
        self.factor.copy_from(&rows.jacobian);
        self.factor.solve_lower(innovation);
        let Self { matrix, running, factor, touched } = self;
        times_columns(matrix, &rows.blocks, factor, touched);
        let own = rows.blocks.active_len();
        for (k, &slot) in rows.blocks.keyframes.iter().enumerate() {
            for j in 0..KEYFRAME_DIM {
                let column = touched.column_mut(*running + KEYFRAME_DIM * slot + j);
                let numbers = factor.column(own + KEYFRAME_DIM * k + j);
                column.iter_mut().zip(numbers).for_each(|(sum, number)| *sum += scale * number);
            }
        }
        let whitened = whitened.faer().transpose();
        matmul(matrix.faer_mut(), Accum::Add, whitened, touched.faer(), -1.0, Par::Seq);
    }

    /// Bytes on the heap.
    pub fn heap_bytes(&self) -> usize {
        self.matrix.heap_bytes() + self.factor.heap_bytes() + self.touched.heap_bytes()
    }
}

/// `J [R | M]_C` into `product`.
fn times_columns(matrix: &Roomy, columns: &StateBlocks, jacobian: &Dense, product: &mut Dense) {
    product.reset(jacobian.nrows(), matrix.ncols());
    for (range, here) in columns.ranges() {
        let part = jacobian.faer().subcols(here.start, here.len());
        let rows = matrix.faer().subrows(range.start, range.len());
        matmul(product.faer_mut(), Accum::Add, part, rows, 1.0, Par::Seq);
    }
}
