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

use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Matrix6x3, Vector3, Vector6};

use super::layout::StateLayout;
use super::sparse_system::SparseSystem;

/// Normal equations of the states and landmarks of a bundle.
pub(super) struct NormalEquations {
    layout: StateLayout,
    /// Diagonal blocks of H from landmarks.
    diagonal: Vec<Matrix6<f64>>,
    /// g.
    gradient: DVector<f64>,
    /// Further terms of H.
    terms: Vec<Term>,
    /// The blocks of each landmark.
    landmarks: Vec<LandmarkBlocks>,
}

/// A term of H between a few unknowns.
struct Term {
    indices: Vec<usize>,
    information: DMatrix<f64>,
}

/// The blocks of one landmark.
#[derive(Default)]
pub(super) struct LandmarkBlocks {
    /// Off-diagonal blocks of H: view a, view b, `J_a^T J_b`.
    pub(super) pairs: Vec<(usize, usize, Matrix6<f64>)>,
    /// Blocks of W: view, `J_view^T J_point`.
    pub(super) couplings: Vec<(usize, Matrix6x3<f64>)>,
    /// V before, and its inverse after [`NormalEquations::add_landmark`].
    pub(super) information: Matrix3<f64>,
    /// l.
    pub(super) gradient: Vector3<f64>,
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
            terms: Vec::new(),
            landmarks: Vec::new(),
        }
    }

    /// The negative gradient of the cost by the states.
    #[cfg(test)]
    pub(super) fn gradient(&self) -> &DVector<f64> {
        &self.gradient
    }

    /// Adds information on one pose.
    pub(super) fn add_pose(&mut self, view: usize, information: &Matrix6<f64>, gradient: &Vector6<f64>) {
        self.diagonal[view] += information;
        let mut rows = self.gradient.fixed_rows_mut::<6>(self.layout.pose(view).start);
        rows += gradient;
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

    /// Adds a landmark. One whose V is singular is held constant.
    pub(super) fn add_landmark(&mut self, mut landmark: LandmarkBlocks) {
        landmark.information = landmark.information.try_inverse().unwrap_or_else(Matrix3::zeros);
        self.landmarks.push(landmark);
    }

    /// Solves the equations with the diagonal of H multiplied by `1 + damping`. (That of V is damped before it is added.)
    ///
    /// # Returns
    /// `None` where S is not positive definite.
    pub(super) fn solve(&self, damping: f64) -> Option<Step> {
        let mut right = self.gradient.clone();
        for landmark in &self.landmarks {
            let eliminated = landmark.information * landmark.gradient;
            for (view, coupling) in &landmark.couplings {
                let mut rows = right.fixed_rows_mut::<6>(self.layout.pose(*view).start);
                rows -= coupling * eliminated;
            }
        }
        let mut system = self.system();
        self.damp(&mut system, damping);
        let states = system.factor()?.solve(&right);
        let eliminated = |landmark: &LandmarkBlocks| {
            let known = landmark.couplings.iter().fold(Vector3::zeros(), |sum, (view, coupling)| {
                sum + coupling.tr_mul(&states.fixed_rows::<6>(self.layout.pose(*view).start))
            });
            landmark.information * (landmark.gradient - known)
        };
        let landmarks = self.landmarks.iter().map(eliminated).collect();
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
        for ((a, b), block) in self.eliminated() {
            // The block (b, a), below the diagonal.
            system.add(&indices(b), &indices(a), &block.transpose());
        }
        for term in &self.terms {
            system.add(&term.indices, &term.indices, &term.information);
        }
        system
    }

    /// The blocks (a, b) with `a <= b` that landmarks cause, after their elimination.
    fn eliminated(&self) -> BTreeMap<(usize, usize), Matrix6<f64>> {
        let mut blocks: BTreeMap<(usize, usize), Matrix6<f64>> = BTreeMap::new();
        let mut add = |a: usize, b: usize, block: &Matrix6<f64>| {
            if a <= b {
                *blocks.entry((a, b)).or_default() += block;
            } else {
                *blocks.entry((b, a)).or_default() += block.transpose();
            }
        };
        for (view, block) in self.diagonal.iter().enumerate() {
            add(view, view, block);
        }
        for landmark in &self.landmarks {
            for (a, b, block) in &landmark.pairs {
                add(*a, *b, block);
            }
            for (index, (a, by_a)) in landmark.couplings.iter().enumerate() {
                let eliminated = by_a * landmark.information;
                add(*a, *a, &-(eliminated * by_a.transpose()));
                for (b, by_b) in &landmark.couplings[index + 1..] {
                    let block = -(eliminated * by_b.transpose());
                    add(*a, *b, &block);
                    if a == b {
                        add(*a, *b, &block.transpose());
                    }
                }
            }
        }
        blocks
    }
}
