//! Eviction: keyframes beyond the limit are dropped, least recently used first, and the filter stays conservative.
//!
//! The state's error is `e_A = sum of M_k e_k + u`, with `u` independent of all keyframes. Dropping `M_j` and inserting `j`
//! again as if it were new would treat one error as two independent ones and count its information twice. Instead the
//! joint covariance of the state and *all* keyframes of the map is enlarged by a positive semidefinite matrix after which
//! the state does not depend on `e_j` any more: for any `x > 0`
//! ```text
//! D = [ x M_j P_j M_jᵀ      -M_j P_jN           ]          P_NN: all of the map, held or not
//!     [ -P_Nj M_jᵀ           P_Nj P_j⁻¹ P_jN / x ]
//! ```
//!
//! **Independent keyframes.** The lower corner is `P_j / x` for `j` itself and zero elsewhere (split covariance
//! intersection with `w = 1 / (1 + x)`). The state's covariance grows by `x M_j P_j M_jᵀ`; when `j` is inserted again, its
//! covariance is `1 + 1/x` times what it was.
//!
//! **Correlated keyframes.** The lower corner is unknown, since keyframes correlated with `j` may be inserted later, but it
//! is at most `P_NN / x`: the covariance of the whole map is inflated by `1 + 1/x` from then on. To keep that small,
//! several keyframes are evicted with one `D`, and before that the part of `e_j` that its neighbours predict moves to them:
//! with `e_j = G e_k + rest`, `M_k += M_j G`, and only `M_j rest` is dropped. That is valid for any `G`. What all keyframes err
//! together stays: `X` does not change, and all of this is of the errors beyond it.
//!
//! **Choice of `x`.** With the relative information `s = tr(P_AA⁻¹ M_j P_j M_jᵀ)` the state grows by less than `x s` in any
//! direction and the keyframe by `1/x`; `x = sqrt(weight / s)` minimizes `x s + weight / x`. A keyframe of which the state
//! has hardly any information left returns hardly inflated.
//!
//! Source of the bound: Julier & Uhlmann, "Using covariance intersection for SLAM", RAS 2007.

use super::HeldKeyframes;
use super::inflation::{MAP_WEIGHT, MIN_RELATIVE_INFORMATION, regularized};
use super::keyframe::{HeldKeyframe, KEYFRAME_DIM};
use crate::KeyframeId;
use crate::linear_algebra::dense::{Dense, Factorization};
use nalgebra::DMatrix;

/// Evicted together: they share the transitions to now and one factorization of `P_AA`.
const EVICTED_AT_ONCE: usize = 16;
/// Neighbours to which the predictable part of an evicted keyframe moves.
const NEIGHBOURS: usize = 2;
/// Weight of one keyframe's inflation against growth of the state's covariance: a robot depends on some hundred keyframes
/// of a place at a time, and each of them returns.
const KEYFRAME_WEIGHT: f64 = 0.01;

impl HeldKeyframes {
    /// Evicts the inactive keyframes that were not used for longest when more than `max_held` are held.
    ///
    /// # Arguments
    /// * `max_held`: active keyframes are never evicted.
    /// * `covariance`: `P_AA`, which grows.
    ///
    /// # Returns
    /// How many were evicted.
    pub fn evict(&mut self, max_held: usize, covariance: &mut Dense) -> usize {
        let excess = self.len().saturating_sub(max_held);
        if excess == 0 {
            return 0;
        }
        let oldest = self.inactive.least_recently_used(excess.max(EVICTED_AT_ONCE));
        let (evicted, sensitivity) = self.inactive.remove(&oldest, &mut self.active);
        let growth = if self.inflation.is_map_correlated() {
            self.evict_correlated(&evicted, &sensitivity, covariance)
        } else {
            self.evict_independent(&evicted, &sensitivity, covariance)
        };
        let transposed = growth.transpose();
        covariance.view_mut().gemm(1.0, &growth, &transposed, 1.0);
        covariance.mirror_lower();
        for keyframe in &evicted {
            self.correlations.remove(keyframe.id);
        }
        evicted.len()
    }

    /// Each with its own `x`. Returns a square root of what the state's covariance grows by.
    fn evict_independent(
        &mut self,
        evicted: &[HeldKeyframe],
        sensitivity: &Dense,
        covariance: &Dense,
    ) -> DMatrix<f64> {
        let mut growth = sensitivity.view().into_owned();
        for (k, keyframe) in evicted.iter().enumerate() {
            let root = square_root(Dense::from_columns(KEYFRAME_DIM, keyframe.covariance().as_slice()));
            let mut part = growth.columns_mut(KEYFRAME_DIM * k, KEYFRAME_DIM);
            let product = &part * root.view();
            part.copy_from(&product);
        }
        let information = column_information(&growth, covariance);
        for (k, (keyframe, columns)) in evicted.iter().zip(information.chunks_exact(KEYFRAME_DIM)).enumerate()
        {
            let relative = columns.iter().sum::<f64>().max(MIN_RELATIVE_INFORMATION);
            let x = (KEYFRAME_WEIGHT / relative).sqrt();
            growth.columns_mut(KEYFRAME_DIM * k, KEYFRAME_DIM).scale_mut(x.sqrt());
            self.inflation.set_evicted(keyframe.id, keyframe.inflation * (1.0 + 1.0 / x));
        }
        growth
    }

    /// All with one `x`, after their predictable part moved to neighbours. Returns as above.
    fn evict_correlated(
        &mut self,
        evicted: &[HeldKeyframe],
        sensitivity: &Dense,
        covariance: &Dense,
    ) -> DMatrix<f64> {
        let remaining = self.move_to_neighbours(evicted, sensitivity);
        let before = self.inflation.of_map();
        let root = square_root(Dense::from(remaining / before));
        let mut growth = sensitivity.view() * root.view();
        let relative: f64 = column_information(&growth, covariance).iter().sum();
        let x = (MAP_WEIGHT / relative.max(MIN_RELATIVE_INFORMATION)).sqrt();
        growth.scale_mut(x.sqrt());
        self.inflation.inflate_map(1.0 + 1.0 / x);
        for keyframe in evicted {
            self.inflation.set_evicted(keyframe.id, keyframe.inflation);
        }
        growth
    }

    /// Moves what the nearest neighbours predict of the evicted errors to the sensitivities of these neighbours.
    ///
    /// # Returns
    /// Covariance of the evicted errors that is not predicted.
    fn move_to_neighbours(&mut self, evicted: &[HeldKeyframe], sensitivity: &Dense) -> DMatrix<f64> {
        let neighbours_of: Vec<Vec<KeyframeId>> =
            evicted.iter().map(|keyframe| self.nearest_neighbours(keyframe.id, evicted)).collect();
        let mut neighbours: Vec<KeyframeId> = neighbours_of.iter().flatten().copied().collect();
        neighbours.sort_unstable();
        neighbours.dedup();
        self.activate(&neighbours);
        neighbours.retain(|id| self.slot_of(*id).is_some());

        // Joint covariance of the evicted errors and, behind them, their neighbours'; rows of `rest` are the part of each
        // evicted error that is not predicted.
        let slots = neighbours.iter().filter_map(|id| self.slot_of(*id)).map(|slot| self.get(slot));
        let all: Vec<&HeldKeyframe> = evicted.iter().chain(slots).collect();
        let joint = self.covariance_of_rests(&all);
        let (own, dim) = (KEYFRAME_DIM * evicted.len(), joint.nrows());
        let mut rest = DMatrix::identity(own, dim);
        for (k, neighbours_of) in neighbours_of.iter().enumerate() {
            let columns: Vec<usize> = neighbours_of
                .iter()
                .filter_map(|id| neighbours.binary_search(id).ok())
                .flat_map(|at| (0..KEYFRAME_DIM).map(move |j| own + KEYFRAME_DIM * at + j))
                .collect();
            let among = joint.select_rows(&columns).select_columns(&columns);
            let cross = joint.columns(KEYFRAME_DIM * k, KEYFRAME_DIM).into_owned().select_rows(&columns);
            // Neighbours that are known exactly predict nothing.
            let Some(factor) = among.cholesky() else { continue };
            let predicted = factor.solve(&cross).transpose();
            for (j, column) in columns.iter().enumerate() {
                rest.view_mut((KEYFRAME_DIM * k, *column), (KEYFRAME_DIM, 1))
                    .copy_from(&-predicted.column(j));
            }
        }
        let moved = -(sensitivity.view() * rest.columns(own, dim - own));
        let width = KEYFRAME_DIM * sensitivity.nrows();
        for (id, increase) in neighbours.iter().zip(moved.as_slice().chunks_exact(width)) {
            if let Some(slot) = self.slot_of(*id) {
                self.active.add_to_sensitivity(slot, increase);
            }
        }
        &rest * joint * rest.transpose()
    }

    /// The held keyframes with the largest cross-covariance, other than the evicted ones.
    fn nearest_neighbours(&self, id: KeyframeId, evicted: &[HeldKeyframe]) -> Vec<KeyframeId> {
        let is_evicted = |id: KeyframeId| evicted.iter().any(|keyframe| keyframe.id == id);
        let mut others: Vec<(f64, KeyframeId)> =
            self.correlations.with(id).map(|(other, block)| (block.norm(), other)).collect();
        others.retain(|(_, other)| !is_evicted(*other));
        others.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        others.iter().take(NEIGHBOURS).map(|(_, other)| *other).collect()
    }
}

/// Lower-triangular square root of a positive semidefinite matrix; zero for one with NaN.
fn square_root(mut matrix: Dense) -> Dense {
    if Factorization::default().semidefinite_cholesky(&mut matrix).is_err() {
        matrix.view_mut().fill(0.0);
    }
    matrix.view_mut().fill_upper_triangle(0.0, 1);
    matrix
}

/// `fᵀ P_AA⁻¹ f` for each column `f`.
fn column_information(columns: &DMatrix<f64>, covariance: &Dense) -> Vec<f64> {
    let mut root = regularized(covariance);
    let mut solved = Dense::from(columns.clone());
    if Factorization::default().cholesky(&mut root).is_err() {
        return vec![1.0; columns.ncols()];
    }
    solved.solve_lower(&root);
    (0..solved.ncols()).map(|k| solved.column(k).iter().map(|value| value * value).sum()).collect()
}
