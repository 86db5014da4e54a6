//! The normal equations of all poses and landmarks, and their solution with the landmarks eliminated (Schur complement).
//!
//! ```text
//! | H  W | | x |   | g |        S x = g - W V^-1 l,   S = H - W V^-1 W^T
//! | W' V | | y | = | l |        y = V^-1 (l - W^T x)
//! ```
//! `x` holds 6 numbers a pose, `y` 3 a landmark, `V` is block-diagonal. `S` is never formed: conjugate gradients only
//! need its product with a vector, whose cost is linear in the number of observations. The prior on every pose keeps `S`
//! well-conditioned.
//!
//! Source: Agarwal, Snavely, Seitz & Szeliski, "Bundle adjustment in the large", ECCV 2010.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Matrix6, Matrix6x3, Vector3, Vector6};

use super::block_matrix::BlockMatrix;

/// Conjugate gradients stop when the residual has fallen by this factor (inexact Newton): the outer iteration corrects
/// the rest.
const TOLERANCE: f64 = 1e-3;
/// Or after this many iterations.
const MAX_STEPS: usize = 100;

/// Normal equations of the poses and landmarks of a bundle.
pub(super) struct NormalEquations {
    /// Diagonal blocks of H.
    diagonal: Vec<Matrix6<f64>>,
    /// g.
    gradient: Vec<Vector6<f64>>,
    /// The blocks of each landmark.
    landmarks: Vec<LandmarkBlocks>,
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

/// The solution: an error for each pose and each landmark.
pub(super) struct Step {
    /// `[δθ, δp]` of each pose.
    pub(super) poses: Vec<Vector6<f64>>,
    /// `[ray, inverse depth]` of each landmark.
    pub(super) landmarks: Vec<Vector3<f64>>,
}

impl NormalEquations {
    /// Equations without terms for a number of poses.
    pub(super) fn new(poses: usize) -> NormalEquations {
        NormalEquations {
            diagonal: vec![Matrix6::zeros(); poses],
            gradient: vec![Vector6::zeros(); poses],
            landmarks: Vec::new(),
        }
    }

    /// Adds information on one pose.
    pub(super) fn add_pose(&mut self, pose: usize, information: &Matrix6<f64>, gradient: &Vector6<f64>) {
        self.diagonal[pose] += information;
        self.gradient[pose] += gradient;
    }

    /// Adds a landmark. One whose V is singular is held constant.
    pub(super) fn add_landmark(&mut self, mut landmark: LandmarkBlocks) {
        landmark.information = landmark.information.try_inverse().unwrap_or_else(Matrix3::zeros);
        self.landmarks.push(landmark);
    }

    /// Multiplies the diagonal of H by `1 + damping`. (That of V is damped before it is added.)
    pub(super) fn damp(&mut self, damping: f64) {
        for block in &mut self.diagonal {
            for index in 0..6 {
                block[(index, index)] *= 1.0 + damping;
            }
        }
    }

    /// Solves the equations.
    pub(super) fn solve(&self) -> Step {
        let poses = self.solve_poses();
        let landmarks = self
            .landmarks
            .iter()
            .map(|landmark| {
                let known = landmark.couplings.iter().fold(Vector3::zeros(), |sum, (view, coupling)| {
                    sum + coupling.transpose() * poses[*view]
                });
                landmark.information * (landmark.gradient - known)
            })
            .collect();
        Step { poses, landmarks }
    }

    /// S in blocks.
    pub(super) fn reduced(&self) -> BlockMatrix {
        let mut reduced = BlockMatrix { diagonal: self.diagonal.clone(), upper: BTreeMap::new() };
        for landmark in &self.landmarks {
            for (a, b, block) in &landmark.pairs {
                reduced.add(*a, *b, block);
            }
            for (index, (a, by_a)) in landmark.couplings.iter().enumerate() {
                let eliminated = by_a * landmark.information;
                reduced.add(*a, *a, &-(eliminated * by_a.transpose()));
                for (b, by_b) in &landmark.couplings[index + 1..] {
                    let block = -(eliminated * by_b.transpose());
                    reduced.add(*a, *b, &block);
                    if a == b {
                        reduced.add(*a, *b, &block.transpose());
                    }
                }
            }
        }
        reduced
    }

    /// S times a vector.
    fn product(&self, x: &[Vector6<f64>]) -> Vec<Vector6<f64>> {
        let mut y: Vec<Vector6<f64>> = self.diagonal.iter().zip(x).map(|(block, x)| block * x).collect();
        for landmark in &self.landmarks {
            for (a, b, block) in &landmark.pairs {
                y[*a] += block * x[*b];
                y[*b] += block.tr_mul(&x[*a]);
            }
            let mut sum = Vector3::zeros();
            for (view, coupling) in &landmark.couplings {
                sum += coupling.tr_mul(&x[*view]);
            }
            let eliminated = landmark.information * sum;
            for (view, coupling) in &landmark.couplings {
                y[*view] -= coupling * eliminated;
            }
        }
        y
    }

    /// Conjugate gradients, preconditioned with the inverses of the diagonal blocks of S.
    fn solve_poses(&self) -> Vec<Vector6<f64>> {
        let mut right = self.gradient.clone();
        let mut blocks = self.diagonal.clone();
        for landmark in &self.landmarks {
            let eliminated = landmark.information * landmark.gradient;
            for (view, coupling) in &landmark.couplings {
                right[*view] -= coupling * eliminated;
                blocks[*view] -= coupling * landmark.information * coupling.transpose();
            }
        }
        let preconditioner: Vec<Matrix6<f64>> =
            blocks.iter().map(|block| block.try_inverse().unwrap_or_else(Matrix6::identity)).collect();
        let precondition = |vector: &[Vector6<f64>]| -> Vec<Vector6<f64>> {
            preconditioner.iter().zip(vector).map(|(inverse, x)| inverse * x).collect()
        };
        let mut solution = vec![Vector6::zeros(); right.len()];
        let mut residual = right;
        let mut preconditioned = precondition(&residual);
        let mut direction = preconditioned.clone();
        let mut size = dot(&residual, &preconditioned);
        let goal = size * TOLERANCE * TOLERANCE;
        for _ in 0..MAX_STEPS {
            if size <= goal || size <= 0.0 {
                break;
            }
            let product = self.product(&direction);
            let curvature = dot(&direction, &product);
            if curvature <= 0.0 {
                break;
            }
            let length = size / curvature;
            add_scaled(&mut solution, &direction, length);
            add_scaled(&mut residual, &product, -length);
            preconditioned = precondition(&residual);
            let next = dot(&residual, &preconditioned);
            for (direction, new) in direction.iter_mut().zip(&preconditioned) {
                *direction = new + *direction * (next / size);
            }
            size = next;
        }
        solution
    }
}

fn dot(a: &[Vector6<f64>], b: &[Vector6<f64>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(b)).sum()
}

fn add_scaled(target: &mut [Vector6<f64>], direction: &[Vector6<f64>], scale: f64) {
    for (target, direction) in target.iter_mut().zip(direction) {
        *target += direction * scale;
    }
}
