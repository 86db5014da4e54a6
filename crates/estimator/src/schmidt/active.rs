//! Active keyframes: their sensitivities follow every step of the filter.
//!
//! One matrix `[R | X | M]`, rows are those of the active error state, takes part in all of them. `M` (6 columns for a
//! keyframe) are the sensitivities; `R` is the product of all steps since keyframes were last deactivated, the transition
//! from the newest level of inactive keyframes to now. It has no columns while no keyframe is inactive. `X` is the
//! sensitivity to the errors common to the map's keyframes; it has columns only while keyframes are used.

use super::keyframe::{HeldKeyframe, KEYFRAME_DIM};
use crate::linear_algebra::dense::Dense;
use crate::linear_algebra::dependence::Dependence;
use crate::measurement::{LinearizedMeasurement, StateBlocks};
use crate::propagation::{IMU_DIM, ImuMatrix};
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::BlockStructure::Rectangular;
use faer::{Accum, MatRef, Par};
use std::ops::Range;

/// See the module's documentation.
#[derive(Clone, Debug)]
pub struct ActiveKeyframes {
    keyframes: Vec<HeldKeyframe>,
    /// `[R | X | M]`.
    matrix: Dense,
    /// Columns of `R`.
    transition_dim: usize,
    /// Columns of `X`.
    common_dim: usize,
    /// Memory reused by each step.
    factor: Dense,
    product: Dense,
    spare: Dense,
}

impl ActiveKeyframes {
    /// No keyframe, beside an active error state of `dim` numbers.
    pub fn new(dim: usize) -> Self {
        Self {
            keyframes: Vec::new(),
            matrix: Dense::zeros(dim, 0),
            transition_dim: 0,
            common_dim: 0,
            factor: Dense::default(),
            product: Dense::default(),
            spare: Dense::default(),
        }
    }

    /// Size of the active error state.
    pub fn dim(&self) -> usize {
        self.matrix.nrows()
    }

    /// The active keyframes by slot.
    pub fn keyframes(&self) -> &[HeldKeyframe] {
        &self.keyframes
    }

    /// The same.
    pub fn keyframes_mut(&mut self) -> &mut [HeldKeyframe] {
        &mut self.keyframes
    }

    /// Adds keyframes with their sensitivities, 6 columns each.
    pub fn push(&mut self, keyframes: impl IntoIterator<Item = HeldKeyframe>, sensitivity: &Dense) {
        self.keyframes.extend(keyframes);
        self.matrix.append(sensitivity);
    }

    /// Removes a keyframe and returns it with its sensitivity; later slots move up.
    pub fn remove(&mut self, slot: usize) -> (HeldKeyframe, Dense) {
        let columns = self.columns_of(slot);
        let sensitivity = self.matrix.columns(columns.clone());
        self.matrix.remove_columns(columns);
        (self.keyframes.remove(slot), sensitivity)
    }

    /// `target += M B` with the `M` of one slot.
    pub fn add_sensitivity_times(&self, slot: usize, block: &Dense, target: &mut Dense) {
        target.add_product(&self.matrix, self.columns_of(slot), block, 0..KEYFRAME_DIM, Rectangular);
    }

    /// `M += increase` for one slot.
    pub fn add_to_sensitivity(&mut self, slot: usize, increase: &[f64]) {
        let columns = self.columns_of(slot);
        for (column, numbers) in columns.zip(increase.chunks_exact(self.dim())) {
            self.matrix.column_mut(column).iter_mut().zip(numbers).for_each(|(sum, number)| *sum += number);
        }
    }

    /// `R`.
    pub fn transition(&self) -> Dense {
        self.matrix.columns(0..self.transition_dim)
    }

    /// `R X`.
    pub fn transition_times(&self, right: &Dense) -> Dense {
        let mut product = Dense::zeros(self.dim(), right.ncols());
        product.add_product(&self.matrix, 0..self.transition_dim, right, 0..right.nrows(), Rectangular);
        product
    }

    /// Replaces `R`.
    pub fn set_transition(&mut self, transition: &Dense) {
        let mut matrix = transition.clone();
        matrix.append(&self.matrix.columns(self.transition_dim..self.matrix.ncols()));
        self.matrix = matrix;
        self.transition_dim = transition.ncols();
    }

    /// Columns of `X`.
    pub fn common_dim(&self) -> usize {
        self.common_dim
    }

    /// Sets `X`, which has no columns.
    pub fn set_common(&mut self, common: &Dense) {
        let mut matrix = self.transition();
        matrix.append(common);
        matrix.append(&self.matrix.columns(self.transition_dim..self.matrix.ncols()));
        self.matrix = matrix;
        self.common_dim = common.ncols();
    }

    /// Takes `X` out.
    pub fn take_common(&mut self) -> Dense {
        let common = self.matrix.columns(self.columns_of_common());
        self.matrix.remove_columns(self.columns_of_common());
        self.common_dim = 0;
        common
    }

    /// `target += X Uᵀ`.
    pub fn add_common_times(&self, common: &Dense, target: &mut Dense) {
        let of_x = self.matrix.faer().subcols(self.transition_dim, self.common_dim);
        matmul(target.faer_mut(), Accum::Add, of_x, common.faer().transpose(), 1.0, Par::Seq);
    }

    fn columns_of_common(&self) -> Range<usize> {
        self.transition_dim..self.transition_dim + self.common_dim
    }

    fn columns_of(&self, slot: usize) -> Range<usize> {
        let begin = self.columns_of_common().end + KEYFRAME_DIM * slot;
        begin..begin + KEYFRAME_DIM
    }

    /// `← F [R | X | M]` for an `F` that touches only the IMU's rows, which are the first.
    pub fn propagate(&mut self, transition: &ImuMatrix) {
        self.product.reset(IMU_DIM, self.matrix.ncols());
        for column in 0..self.matrix.ncols() {
            self.product.column_mut(column).copy_from_slice(&self.matrix.column(column)[..IMU_DIM]);
        }
        let transition = MatRef::from_column_major_slice(transition.as_slice(), IMU_DIM, IMU_DIM);
        let imu = self.matrix.faer_mut().subrows_mut(0, IMU_DIM);
        matmul(imu, Accum::Replace, transition, self.product.faer(), 1.0, Par::Seq);
    }

    /// The rows become the old rows `source`, one range after the other.
    pub fn gather_rows(&mut self, source: &[Range<usize>]) {
        self.matrix.gather_rows(source, &mut self.spare);
    }

    /// `← T [R | X | M]` for a `T` that adds multiples of some rows to others.
    pub fn add_dependences<const R: usize, const C: usize>(&mut self, dependences: &[Dependence<R, C>]) {
        self.matrix.add_to_rows(dependences);
    }

    /// Inserts the rows `jacobian` times the rows of `blocks` at `at`.
    pub fn insert_rows(&mut self, at: usize, blocks: &StateBlocks, jacobian: &Dense) {
        times_blocks(&self.matrix, blocks, jacobian, &mut self.product);
        self.matrix.insert_rows(at, &self.product, &mut self.spare);
    }

    /// `M -= Wᵀ L⁻¹ H (M_C; scale E_T)`, `X -= Wᵀ L⁻¹ H (X_C; scale U_T)` and `R -= Wᵀ L⁻¹ H_C R_C`.
    ///
    /// # Arguments
    /// * `whitened`: `W`.
    /// * `innovation`: `L` in its lower triangle.
    /// * `scale`: inflation of the whole map.
    pub fn measurement_update(
        &mut self,
        measurement: &LinearizedMeasurement,
        whitened: &Dense,
        innovation: &Dense,
        scale: f64,
    ) {
        // L⁻¹ is applied to the few columns of H rather than to the many of the product.
        self.factor.copy_from(&measurement.jacobian);
        self.factor.solve_lower(innovation);
        times_blocks(&self.matrix, &measurement.blocks, &self.factor, &mut self.product);
        let first = measurement.blocks.active_len();
        for (k, &slot) in measurement.blocks.keyframes.iter().enumerate() {
            for (j, column) in self.columns_of(slot).enumerate() {
                let numbers = self.factor.column(first + KEYFRAME_DIM * k + j);
                let target = self.product.column_mut(column);
                target.iter_mut().zip(numbers).for_each(|(sum, number)| *sum += scale * number);
            }
            let common = &self.keyframes[slot].common;
            if common.ncols() > 0 {
                let of_keyframe = self.factor.faer().subcols(first + KEYFRAME_DIM * k, KEYFRAME_DIM);
                let target = self.product.faer_mut().subcols_mut(self.transition_dim, self.common_dim);
                matmul(target, Accum::Add, of_keyframe, common.faer(), scale, Par::Seq);
            }
        }
        let gain = whitened.faer().transpose();
        matmul(self.matrix.faer_mut(), Accum::Add, gain, self.product.faer(), -1.0, Par::Seq);
    }

    /// Bytes on the heap.
    pub fn heap_bytes(&self) -> usize {
        let matrices = [&self.matrix, &self.factor, &self.product, &self.spare];
        self.keyframes.capacity() * size_of::<HeldKeyframe>()
            + self.keyframes.iter().map(|keyframe| keyframe.common.heap_bytes()).sum::<usize>()
            + matrices.iter().map(|matrix| matrix.heap_bytes()).sum::<usize>()
    }
}

/// `J [R | X | M]_C` into `product`.
fn times_blocks(matrix: &Dense, blocks: &StateBlocks, jacobian: &Dense, product: &mut Dense) {
    product.reset(jacobian.nrows(), matrix.ncols());
    for (rows, columns) in blocks.ranges() {
        product.add_product(jacobian, columns, matrix, rows, Rectangular);
    }
}
