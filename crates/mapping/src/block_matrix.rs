//! Symmetric matrices of 6x6 blocks and their sparse Cholesky factor.
//!
//! The reduced normal equations `S` are sparse (two keyframes share a block where they observe a common landmark), their
//! inverse is not: the factor `S = L D L^T` is computed once, with the poses in an order that keeps `L` sparse, and the
//! inverse is solved for column by column.
//!
//! Source: George & Liu, "The evolution of the minimum degree ordering algorithm", SIAM Review 1989.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Matrix6;

/// A symmetric matrix of 6x6 blocks.
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

/// The part of the matrix that is not eliminated yet.
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
