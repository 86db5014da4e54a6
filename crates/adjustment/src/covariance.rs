//! The covariance of all states at the minimum, column by column.

use nalgebra::{DMatrix, DVector, Matrix6};

use crate::layout::{POSE, StateLayout};
use crate::sparse_system::SparseFactor;

/// The covariance of the states: the inverse of the normal equations with the landmarks eliminated, by their factor.
pub struct StateCovariance {
    factor: SparseFactor,
    layout: StateLayout,
}

impl StateCovariance {
    pub(crate) fn new(factor: SparseFactor, layout: StateLayout) -> StateCovariance {
        StateCovariance { factor, layout }
    }

    /// Columns of it: all rows, in the order of the layout.
    pub fn columns(&self, indices: impl IntoIterator<Item = usize>) -> DMatrix<f64> {
        self.factor.inverse_columns(&indices.into_iter().collect::<Vec<_>>())
    }

    /// The covariance of some poses with one: a block `E[e_row e_view^T]` for each row. A column is as long as the whole trajectory,
    /// and is dropped at once.
    pub fn blocks(&self, rows: impl IntoIterator<Item = usize>, view: usize) -> Vec<Matrix6<f64>> {
        let columns = self.columns(self.layout.pose(view));
        let block =
            |row: usize| columns.fixed_view::<POSE, POSE>(self.layout.pose(row).start, 0).into_owned();
        rows.into_iter().map(block).collect()
    }

    /// The covariance of the state of one view, pose and motion: 15 numbers.
    pub fn of_state(&self, view: usize) -> DMatrix<f64> {
        let state = self.layout.state(view);
        self.columns(state.clone()).rows(state.start, state.len()).into_owned()
    }

    /// The covariance times a vector of the states, in the order of the layout.
    pub fn times(&self, vector: &DVector<f64>) -> DVector<f64> {
        self.factor.solve(vector)
    }
}
