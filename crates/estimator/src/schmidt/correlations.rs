//! `P_NN` off its diagonal, as the map states it: sparse, 6x6 a pair.

use crate::KeyframeId;
use nalgebra::Matrix6;
use std::collections::HashMap;

/// By row and then column; both triangles.
#[derive(Clone, Debug, Default)]
pub struct Correlations {
    rows: HashMap<KeyframeId, HashMap<KeyframeId, Matrix6<f64>>>,
}

impl Correlations {
    /// Whether no keyframe depends on another.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// States the covariance between two keyframes; rows are the error of `a`.
    pub fn insert(&mut self, a: KeyframeId, b: KeyframeId, block: &Matrix6<f64>) {
        self.rows.entry(a).or_default().insert(b, *block);
        self.rows.entry(b).or_default().insert(a, block.transpose());
    }

    /// Forgets all blocks of a keyframe.
    pub fn remove(&mut self, id: KeyframeId) {
        for other in self.rows.remove(&id).unwrap_or_default().into_keys() {
            if let Some(row) = self.rows.get_mut(&other) {
                row.remove(&id);
            }
        }
    }

    /// The block between two keyframes; rows are the error of `a`.
    pub fn between(&self, a: KeyframeId, b: KeyframeId) -> Option<&Matrix6<f64>> {
        self.rows.get(&a)?.get(&b)
    }

    /// The keyframes that one depends on, each with its block; rows are the other's error.
    pub fn with(&self, id: KeyframeId) -> impl Iterator<Item = (KeyframeId, &Matrix6<f64>)> {
        let others = self.rows.get(&id).into_iter().flatten().map(|(other, _)| *other);
        others.filter_map(move |other| self.between(other, id).map(|block| (other, block)))
    }

    /// Bytes on the heap, but for unused room.
    pub fn heap_bytes(&self) -> usize {
        let block = size_of::<(KeyframeId, Matrix6<f64>)>();
        let row = size_of::<(KeyframeId, HashMap<KeyframeId, Matrix6<f64>>)>();
        self.rows.values().map(|others| row + others.capacity() * block).sum()
    }
}
