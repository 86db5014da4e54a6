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

use nalgebra::{DMatrix, DVector, Matrix6, Vector3};

use super::landmark_equations::{EliminatedLandmarks, LandmarkEquations};
use super::layout::StateLayout;
use super::parallel;
use super::sparse_system::SparseSystem;

/// Normal equations of the states and landmarks of a bundle.
pub(super) struct NormalEquations {
    layout: StateLayout,
    /// Diagonal blocks of H from landmarks.
    diagonal: Vec<Matrix6<f64>>,
    /// g.
    gradient: DVector<f64>,
    /// `W V^-1 l`.
    eliminated_gradient: DVector<f64>,
    /// Blocks (a, b), `a <= b`, of S that landmarks cause, without the diagonal of H.
    blocks: BTreeMap<(usize, usize), Matrix6<f64>>,
    /// Further terms of H.
    terms: Vec<Term>,
    /// The landmarks, in runs.
    landmarks: Vec<EliminatedLandmarks>,
}

/// A term of H between a few unknowns.
struct Term {
    indices: Vec<usize>,
    information: DMatrix<f64>,
}

/// The solution.
pub(super) struct Step {
    /// Error of all states, as the layout says.
    pub(super) states: DVector<f64>,
    /// `[ray, inverse depth]` of each landmark.
    pub(super) landmarks: Vec<Vector3<f64>>,
}

impl NormalEquations {
    /// Equations without terms.
    pub(super) fn new(layout: StateLayout) -> NormalEquations {
        NormalEquations {
            layout,
            diagonal: vec![Matrix6::zeros(); layout.views],
            gradient: DVector::zeros(layout.dim()),
            eliminated_gradient: DVector::zeros(layout.dim()),
            blocks: BTreeMap::new(),
            terms: Vec::new(),
            landmarks: Vec::new(),
        }
    }

    /// The negative gradient of the cost by the states.
    #[cfg(test)]
    pub(super) fn gradient(&self) -> &DVector<f64> {
        &self.gradient
    }

    /// Adds a residual of unknowns at any indices.
    ///
    /// # Arguments
    /// * `jacobian`: of the residual, a column for each of `indices`.
    pub(super) fn add_residual(
        &mut self,
        indices: Vec<usize>,
        jacobian: &DMatrix<f64>,
        information: &DMatrix<f64>,
        residual: &DVector<f64>,
    ) {
        let weighted = jacobian.tr_mul(information);
        let gradient = &weighted * residual;
        for (&index, value) in indices.iter().zip(gradient.iter()) {
            self.gradient[index] -= value;
        }
        self.terms.push(Term { indices, information: weighted * jacobian });
    }

    /// Adds information on unknowns at any indices.
    ///
    /// # Arguments
    /// * `gradient`: negative gradient of the cost.
    pub(super) fn add_information(
        &mut self,
        indices: Vec<usize>,
        information: DMatrix<f64>,
        gradient: &DVector<f64>,
    ) {
        for (&index, value) in indices.iter().zip(gradient.iter()) {
            self.gradient[index] += value;
        }
        self.terms.push(Term { indices, information });
    }

    /// Adds a run of landmarks, with what their pixels say of the poses.
    pub(super) fn add_landmarks(&mut self, run: LandmarkEquations) {
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
    pub(super) fn solve(&self, damping: f64) -> Option<Step> {
        let mut system = self.system();
        self.damp(&mut system, damping);
        let states = system.factor()?.solve(&(&self.gradient - &self.eliminated_gradient));
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
        for term in &self.terms {
            for (&index, value) in term.indices.iter().zip(term.information.diagonal().iter()) {
                system.add_diagonal(index, damping * value);
            }
        }
    }

    /// S: the information matrix of the states.
    pub(super) fn system(&self) -> SparseSystem {
        let mut system = SparseSystem::new(self.layout.dim());
        let indices = |view: usize| -> Vec<usize> { self.layout.pose(view).collect() };
        for (view, block) in self.diagonal.iter().enumerate() {
            system.add(&indices(view), &indices(view), block);
        }
        for (&(a, b), block) in &self.blocks {
            // The block (b, a), below the diagonal.
            system.add(&indices(b), &indices(a), &block.transpose());
        }
        for term in &self.terms {
            system.add(&term.indices, &term.indices, &term.information);
        }
        system
    }
}
