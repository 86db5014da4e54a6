//! The off-diagonal blocks of `P_NN` as the map states them: sparse, 6x6 for a pair of keyframes.

use crate::KeyframeId;
use nalgebra::Matrix6;
use std::collections::BTreeMap;

/// By row and then column; both triangles.
#[derive(Clone, Debug, Default)]
pub struct Correlations {
    rows: BTreeMap<KeyframeId, BTreeMap<KeyframeId, Matrix6<f64>>>,
}

impl Correlations {
    /// Whether all keyframes are independent.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Sets the covariance between two keyframes; rows are the error of `a`.
    pub fn insert(&mut self, a: KeyframeId, b: KeyframeId, block: &Matrix6<f64>) {
        self.rows.entry(a).or_default().insert(b, *block);
        self.rows.entry(b).or_default().insert(a, block.transpose());
    }

    /// Removes all blocks of a keyframe.
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

    /// The keyframes correlated with `id`, each with its block; rows are the other's error.
    pub fn with(&self, id: KeyframeId) -> impl Iterator<Item = (KeyframeId, &Matrix6<f64>)> + Clone {
        let others = self.rows.get(&id).into_iter().flatten().map(|(other, _)| *other);
        others.filter_map(move |other| self.between(other, id).map(|block| (other, block)))
    }

    /// Bytes on the heap, without the trees' own bookkeeping.
    pub fn heap_bytes(&self) -> usize {
        let block = size_of::<(KeyframeId, Matrix6<f64>)>();
        let row = size_of::<(KeyframeId, BTreeMap<KeyframeId, Matrix6<f64>>)>();
        self.rows.values().map(|others| row + others.len() * block).sum()
    }
}
