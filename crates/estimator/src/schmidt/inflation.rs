//! Inflation of the map's covariance: what the filter must remember of evicted and invalidated keyframes.
//!
//! `P_NN` as the filter uses it is the stated one, times one number for the whole map, times one number for a keyframe.

use crate::KeyframeId;
use crate::linear_algebra::dense::Dense;
use std::collections::HashMap;

/// See the module's documentation. All factors multiply covariances.
#[derive(Clone, Debug)]
pub struct MapInflation {
    /// Of the whole map.
    map: f64,
    /// Of each evicted keyframe when it enters again.
    evicted: HashMap<KeyframeId, f64>,
    /// The largest of these.
    largest: f64,
    /// Whether errors of entering keyframes may depend on those of any evicted one.
    correlated: bool,
}

impl Default for MapInflation {
    fn default() -> Self {
        Self { map: 1.0, evicted: HashMap::new(), largest: 1.0, correlated: false }
    }
}

impl MapInflation {
    /// Factor on the covariance of the whole map. Sensitivities refer to the stated covariance and scale with it.
    pub fn of_map(&self) -> f64 {
        self.map
    }

    /// Factor on the covariance of a keyframe that enters, beside [`Self::of_map`].
    pub fn of_entering(&self, id: KeyframeId) -> f64 {
        if self.correlated { self.largest } else { self.evicted.get(&id).copied().unwrap_or(1.0) }
    }

    /// Whether the map has stated cross-covariances.
    pub fn is_map_correlated(&self) -> bool {
        self.correlated
    }

    /// The map has stated cross-covariances.
    pub fn set_map_correlated(&mut self) {
        self.correlated = true;
    }

    /// Errors of the new map version may depend on those of any evicted keyframe.
    pub fn note_new_version(&mut self) {
        self.correlated |= self.largest > 1.0;
    }

    /// Multiplies the covariance of the whole map.
    pub fn inflate_map(&mut self, factor: f64) {
        self.map *= factor;
    }

    /// An evicted keyframe enters again with this factor.
    pub fn set_evicted(&mut self, id: KeyframeId, factor: f64) {
        self.evicted.insert(id, factor);
        self.largest = self.largest.max(factor);
    }

    /// Bytes on the heap.
    pub fn heap_bytes(&self) -> usize {
        self.evicted.capacity() * size_of::<(KeyframeId, f64)>()
    }
}

/// Weight of the map's inflation against that of the state, where `x` balances them: both count the same.
pub const MAP_WEIGHT: f64 = 1.0;
/// A smaller relative information is rounding.
pub const MIN_RELATIVE_INFORMATION: f64 = 1e-12;
/// Relative increase of the diagonal in [`regularized`].
const REGULARIZATION: f64 = 1e-9;

/// `P_AA` with a slightly larger diagonal, so that it has a Cholesky factor: the newest clone is a copy of the IMU's pose.
pub fn regularized(covariance: &Dense) -> Dense {
    let mut regularized = covariance.clone();
    for k in 0..regularized.nrows() {
        regularized[(k, k)] *= 1.0 + REGULARIZATION;
    }
    regularized
}
