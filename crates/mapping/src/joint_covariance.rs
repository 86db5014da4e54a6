//! How uncertain refined poses are, and how their errors depend on each other.
//!
//! The inverse of the reduced normal equations `S` is the joint covariance of all poses. `S` is sparse (two keyframes
//! share a block where they see a common landmark), its inverse is not: the factor `S = L D L^T` is computed once, in
//! blocks of 6x6 with the poses in an order that keeps `L` sparse, and the inverse is solved for column by column, of
//! which only the blocks that the map will state are kept.
//!
//! # Which blocks a map states
//! All, up to [`ALL_UP_TO`] keyframes. Beyond, those of keyframes near each other: leaving out the rest would in general
//! leave a matrix that is no covariance, so every block is multiplied with a correlation function of the distance
//! between the two keyframes that is exactly zero from some distance on. The product of two covariances, element by
//! element, is a covariance (Schur).
//!
//! Sources: George & Liu, "The evolution of the minimum degree ordering algorithm", SIAM Review 1989; Gaspari & Cohn,
//! "Construction of correlation functions in two and three dimensions", QJRMS 1999, eq. 4.10.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix6, Vector3};

/// Maps of up to so many keyframes state the covariance of every pair.
const ALL_UP_TO: usize = 100;
/// In larger maps a keyframe has blocks with about so many others, on average.
const MEAN_NEIGHBOURS: usize = 100;

/// The reduced normal equations of the poses, in blocks.
#[derive(Clone, Debug)]
pub(super) struct BlockMatrix {
    /// Diagonal blocks.
    pub(super) diagonal: Vec<Matrix6<f64>>,
    /// Blocks (i, j) with `i < j`.
    pub(super) upper: BTreeMap<(usize, usize), Matrix6<f64>>,
}

impl BlockMatrix {
    /// Adds to the block (i, j) and its transpose to (j, i); the diagonal gets the sum once.
    pub(super) fn add(&mut self, i: usize, j: usize, block: &Matrix6<f64>) {
        match i.cmp(&j) {
            std::cmp::Ordering::Equal => self.diagonal[i] += block,
            std::cmp::Ordering::Less => *self.upper.entry((i, j)).or_insert_with(Matrix6::zeros) += block,
            std::cmp::Ordering::Greater => {
                *self.upper.entry((j, i)).or_insert_with(Matrix6::zeros) += block.transpose();
            }
        }
    }
}

/// The factor `L D L^T` of a symmetric, positive definite block matrix.
pub(super) struct BlockCholesky {
    /// In the order of elimination.
    columns: Vec<Column>,
}

struct Column {
    pose: usize,
    /// Inverse of the block of D.
    inverse: Matrix6<f64>,
    /// Blocks of L below the diagonal: pose and block.
    below: Vec<(usize, Matrix6<f64>)>,
}

impl BlockCholesky {
    /// Factors a matrix, always eliminating the pose that has the fewest neighbours left.
    ///
    /// # Returns
    /// `None` where the matrix is not positive definite.
    pub(super) fn new(matrix: &BlockMatrix) -> Option<BlockCholesky> {
        let mut rest = Remaining::new(matrix);
        let mut columns = Vec::with_capacity(matrix.diagonal.len());
        while let Some(pose) = rest.next() {
            columns.push(rest.eliminate(pose)?);
        }
        Some(BlockCholesky { columns })
    }

    /// The blocks of one block column of the inverse, by pose.
    pub(super) fn inverse_column(&self, pose: usize) -> Vec<Matrix6<f64>> {
        let mut x = vec![Matrix6::zeros(); self.columns.len()];
        x[pose] = Matrix6::identity();
        for column in &self.columns {
            let known = x[column.pose];
            for (row, block) in &column.below {
                x[*row] -= block * known;
            }
            x[column.pose] = column.inverse * known;
        }
        for column in self.columns.iter().rev() {
            for (row, block) in &column.below {
                let known = block.tr_mul(&x[*row]);
                x[column.pose] -= known;
            }
        }
        x
    }
}

/// What is left to eliminate.
struct Remaining {
    diagonal: Vec<Matrix6<f64>>,
    /// Of each pose: the poses that it shares a block with, and the block (its rows are of this pose).
    neighbours: Vec<BTreeMap<usize, Matrix6<f64>>>,
    /// Number of neighbours and pose.
    queue: BTreeSet<(usize, usize)>,
}

impl Remaining {
    fn new(matrix: &BlockMatrix) -> Remaining {
        let mut neighbours = vec![BTreeMap::new(); matrix.diagonal.len()];
        for (&(i, j), block) in &matrix.upper {
            neighbours[i].insert(j, *block);
            neighbours[j].insert(i, block.transpose());
        }
        let queue = neighbours.iter().enumerate().map(|(pose, others)| (others.len(), pose)).collect();
        Remaining { diagonal: matrix.diagonal.clone(), neighbours, queue }
    }

    fn next(&mut self) -> Option<usize> {
        self.queue.pop_first().map(|(_, pose)| pose)
    }

    fn eliminate(&mut self, pose: usize) -> Option<Column> {
        let inverse = self.diagonal[pose].cholesky()?.inverse();
        let row = std::mem::take(&mut self.neighbours[pose]);
        let below: Vec<(usize, Matrix6<f64>)> =
            row.iter().map(|(&other, block)| (other, block.transpose() * inverse)).collect();
        for (a, _) in &below {
            self.queue.remove(&(self.neighbours[*a].len(), *a));
            self.neighbours[*a].remove(&pose);
        }
        for (index, (a, by_a)) in below.iter().enumerate() {
            self.diagonal[*a] -= by_a * row[a];
            for (b, _) in &below[index + 1..] {
                let change = by_a * row[b];
                *self.neighbours[*a].entry(*b).or_insert_with(Matrix6::zeros) -= change;
                *self.neighbours[*b].entry(*a).or_insert_with(Matrix6::zeros) -= change.transpose();
            }
        }
        self.queue.extend(below.iter().map(|(a, _)| (self.neighbours[*a].len(), *a)));
        Some(Column { pose, inverse, below })
    }
}

/// What a map states of its keyframes' errors.
pub(super) struct JointCovariance {
    /// Covariance of each pose.
    pub(super) own: Vec<Matrix6<f64>>,
    /// `E[e_i e_j^T]` with `i < j`; all others are zero.
    pub(super) cross: Vec<(usize, usize, Matrix6<f64>)>,
}

/// The joint covariance of poses at the given positions (m), from their reduced normal equations.
///
/// # Returns
/// `None` where the equations are not positive definite.
pub(super) fn joint_covariance(
    equations: &BlockMatrix,
    positions: &[Vector3<f64>],
    mut progress: impl FnMut(usize, usize),
) -> Option<JointCovariance> {
    let factor = BlockCholesky::new(equations)?;
    let support = (positions.len() > ALL_UP_TO).then(|| support(positions));
    let mut joint = JointCovariance { own: Vec::new(), cross: Vec::new() };
    for j in 0..positions.len() {
        progress(j, positions.len());
        let column = factor.inverse_column(j);
        joint.own.push((column[j] + column[j].transpose()) * 0.5);
        for (i, block) in column.iter().enumerate().take(j) {
            let distance = (positions[i] - positions[j]).norm();
            let kept = support.map_or(1.0, |support| gaspari_cohn(2.0 * distance / support));
            if kept > 0.0 {
                joint.cross.push((i, j, block * kept));
            }
        }
    }
    Some(joint)
}

/// The distance (m) within which a keyframe has [`MEAN_NEIGHBOURS`] others on average.
fn support(positions: &[Vector3<f64>]) -> f64 {
    let mut distances: Vec<f64> = Vec::new();
    for (index, position) in positions.iter().enumerate() {
        distances.extend(positions[..index].iter().map(|other| (position - other).norm()));
    }
    let wanted = (positions.len() * MEAN_NEIGHBOURS / 2).min(distances.len() - 1);
    let (_, support, _) = distances.select_nth_unstable_by(wanted, f64::total_cmp);
    support.max(f64::MIN_POSITIVE)
}

/// A correlation function in three dimensions: 1 at 0, falling, exactly 0 from 2 on.
fn gaspari_cohn(z: f64) -> f64 {
    let polynomial = |coefficients: [f64; 6]| coefficients.iter().rev().fold(0.0, |sum, c| sum * z + c);
    if z < 1.0 {
        polynomial([1.0, 0.0, -5.0 / 3.0, 5.0 / 8.0, 1.0 / 2.0, -1.0 / 4.0])
    } else if z < 2.0 {
        (polynomial([4.0, -5.0, 5.0 / 3.0, 5.0 / 8.0, -1.0 / 2.0, 1.0 / 12.0]) - 2.0 / (3.0 * z)).max(0.0)
    } else {
        0.0
    }
}
