//! Landmarks that are added to the state, from all pixels of their tracks.
//!
//! Source: Li & Mourikis, "Optimization-based estimator design for vision-aided inertial navigation", RSS 2012.

use crate::linear_algebra::dense::Dense;
use nalgebra::{Matrix3, Vector3};

/// Delayed initialization of landmarks in the state: `e_f = J e + n` for each.
#[derive(Clone, Debug, Default)]
pub struct DelayedInitialization {
    /// Correction of each linearization point, metres in L.
    pub shifts: Vec<Vector3<f64>>,
    /// Covariance of each `n`, m^2.
    pub noises: Vec<Matrix3<f64>>,
    /// `Jᵀ` of each over the columns of the layout; the same number of entries for each landmark.
    pub(crate) jacobians: Vec<[f64; 3]>,
}

impl DelayedInitialization {
    /// Removes all landmarks.
    pub fn clear(&mut self) {
        self.shifts.clear();
        self.noises.clear();
        self.jacobians.clear();
    }

    /// `J` of all landmarks, three rows each, into `target`.
    pub fn jacobian(&self, target: &mut Dense) {
        let count = self.shifts.len();
        let width = self.jacobians.len() / count.max(1);
        target.reset(3 * count, width);
        for (index, jacobian) in self.jacobians.chunks_exact(width.max(1)).enumerate() {
            for (column, values) in jacobian.iter().enumerate() {
                target.column_mut(column)[3 * index..3 * index + 3].copy_from_slice(values);
            }
        }
    }
}
