//! The normal equations of all states and landmarks, and their solution with the landmarks eliminated (Schur complement).
//!
//! ```text
//! | H  W | | x |   | g |        S x = g - W V^-1 l,   S = H - W V^-1 W^T
//! | W' V | | y | = | l |        y = V^-1 (l - W^T x)
//! ```
//! `x` holds 6 numbers a pose, and with an IMU 9 more for each pose (`layout`); `y` holds 3 a landmark, `V` is
//! block-diagonal. `S` is sparse: two poses share a block where they observe a common landmark.
//!
//! Source: Triggs, McLauchlan, Hartley & Fitzgibbon, "Bundle adjustment: a modern synthesis", 2000, section 6.

use std::collections::BTreeMap;

use nalgebra::allocator::Allocator;
use nalgebra::{DMatrix, DVector, DefaultAllocator, Dim, Matrix6, OMatrix, OVector, Vector3};

use crate::covariance::StateCovariance;
use crate::landmark_equations::{EliminatedLandmarks, LandmarkEquations};
use crate::layout::StateLayout;
use crate::parallel;
use crate::sparse_system::{SparseCholesky, SparseSystem};

/// Normal equations of the states and landmarks of a bundle.
pub struct NormalEquations {
    layout: StateLayout,
    /// Diagonal blocks of H from landmarks.
    diagonal: Vec<Matrix6<f64>>,
    /// g.
    gradient: DVector<f64>,
    /// `W V^-1 l`.
    eliminated_gradient: DVector<f64>,
    /// Blocks (a, b), `a <= b`, of S that landmarks cause, without the diagonal of H.
    blocks: BTreeMap<(usize, usize), Matrix6<f64>>,
    /// Further terms of H, summed.
    terms: SparseSystem,
    /// Their diagonal.
    diagonal_of_terms: DVector<f64>,
    /// The landmarks, in runs.
    landmarks: Vec<EliminatedLandmarks>,
}

/// The solution.
pub struct Step {
    /// Error of all states, as the layout says.
    pub states: DVector<f64>,
    /// `[ray, inverse depth]` of each landmark.
    pub landmarks: Vec<Vector3<f64>>,
}

impl NormalEquations {
    /// Equations without terms.
    pub fn new(layout: StateLayout) -> NormalEquations {
        NormalEquations {
            layout,
            diagonal: vec![Matrix6::zeros(); layout.views],
            gradient: DVector::zeros(layout.dim()),
            eliminated_gradient: DVector::zeros(layout.dim()),
            blocks: BTreeMap::new(),
            terms: SparseSystem::new(layout.dim()),
            diagonal_of_terms: DVector::zeros(layout.dim()),
            landmarks: Vec::new(),
        }
    }

    /// Where the unknowns are.
    pub fn layout(&self) -> StateLayout {
        self.layout
    }

    /// The negative gradient of the cost by the states.
    pub fn gradient(&self) -> &DVector<f64> {
        &self.gradient
    }

    /// Adds a residual of unknowns at any indices.
    ///
    /// # Arguments
    /// * `jacobian`: of the residual, a column for each of `indices`.
    /// * `information`: inverse covariance of the residual.
    pub fn add_residual<R: Dim, C: Dim>(
        &mut self,
        indices: impl IntoIterator<Item = usize>,
        jacobian: &OMatrix<f64, R, C>,
        information: &OMatrix<f64, R, R>,
        residual: &OVector<f64, R>,
    ) where
        DefaultAllocator: Allocator<R, C> + Allocator<C, R> + Allocator<R, R> + Allocator<C, C>,
        DefaultAllocator: Allocator<R> + Allocator<C>,
    {
        let weighted = jacobian.tr_mul(information);
        let of_indices = &weighted * jacobian;
        let size = of_indices.nrows();
        let of_indices = DMatrix::from_column_slice(size, size, of_indices.as_slice());
        let gradient = -(weighted * residual);
        self.add_information(indices, &of_indices, gradient.as_slice());
    }

    /// Adds information on unknowns at any indices.
    ///
    /// # Arguments
    /// * `gradient`: negative gradient of the cost, a number for each of `indices`.
    pub fn add_information(
        &mut self,
        indices: impl IntoIterator<Item = usize>,
        information: &DMatrix<f64>,
        gradient: &[f64],
    ) {
        let indices: Vec<usize> = indices.into_iter().collect();
        for (&index, value) in indices.iter().zip(gradient) {
            self.gradient[index] += value;
        }
        for (&index, value) in indices.iter().zip(information.diagonal().iter()) {
            self.diagonal_of_terms[index] += value;
        }
        self.terms.add(&indices, &indices, information);
    }

    /// The product of H without landmarks and a vector of the states.
    pub(crate) fn terms_times(&self, vector: &DVector<f64>) -> DVector<f64> {
        self.terms.times(vector)
    }

    /// Adds a run of landmarks, with what their pixels say of the poses.
    pub fn add_landmarks(&mut self, run: LandmarkEquations) {
        for (view, diagonal, gradient, eliminated) in run.of_views() {
            self.diagonal[view] += diagonal;
            let begin = self.layout.pose(view).start;
            let mut rows = self.gradient.fixed_rows_mut::<6>(begin);
            rows += gradient;
            let mut rows = self.eliminated_gradient.fixed_rows_mut::<6>(begin);
            rows += eliminated;
        }
        for (views, block) in run.blocks() {
            *self.blocks.entry(views).or_default() += block;
        }
        self.landmarks.push(run.into_landmarks());
    }

    /// Solves the equations with the diagonal of H multiplied by `1 + damping`. (That of V is damped before it is added.)
    ///
    /// # Returns
    /// `None` where S is not positive definite.
    pub fn solve(&self, damping: f64) -> Option<Step> {
        self.solve_with(&mut SparseCholesky::default(), damping)
    }

    /// As [`NormalEquations::solve`], by the factorization of the step before.
    pub(crate) fn solve_with(&self, cholesky: &mut SparseCholesky, damping: f64) -> Option<Step> {
        let mut system = self.system();
        self.damp(&mut system, damping);
        let states = cholesky.factor(&system)?.solve(&(&self.gradient - &self.eliminated_gradient));
        let of_run = |run: usize| self.landmarks[run].errors(self.layout, &states);
        let landmarks = parallel::map(self.landmarks.len(), of_run, |_| ()).concat();
        Some(Step { states, landmarks })
    }

    fn damp(&self, system: &mut SparseSystem, damping: f64) {
        for (view, block) in self.diagonal.iter().enumerate() {
            for (index, value) in self.layout.pose(view).zip(block.diagonal().iter()) {
                system.add_diagonal(index, damping * value);
            }
        }
        for (index, value) in self.diagonal_of_terms.iter().enumerate().filter(|(_, value)| **value != 0.0) {
            system.add_diagonal(index, damping * value);
        }
    }

    /// The covariance of the states; `None` where S is not positive definite.
    pub fn covariance(&self) -> Option<StateCovariance> {
        Some(StateCovariance::new(self.system().factor()?, self.layout))
    }

    /// S: the information matrix of the states.
    fn system(&self) -> SparseSystem {
        let mut system = self.terms.clone();
        let indices = |view: usize| -> Vec<usize> { self.layout.pose(view).collect() };
        for (view, block) in self.diagonal.iter().enumerate() {
            system.add(&indices(view), &indices(view), block);
        }
        for (&(a, b), block) in &self.blocks {
            // The block (b, a), below the diagonal.
            system.add(&indices(b), &indices(a), &block.transpose());
        }
        system
    }
}
