//! Dropping keyframes that were not used for long, so that memory stays bounded, and the filter conservative.
//!
//! The state errs by `e_A = sum of M_k e_k + u`, with `u` independent of all keyframes. To forget `M_j` and to pull `j` again
//! as if it were new takes one error for two independent ones. What follows only ever makes the stated covariance of
//! the state and *all* keyframes of the map larger, by a Gram matrix: for any `x > 0`
//! ```text
//! D = [ x M_j P_j M_jᵀ      -M_j P_jN           ]          P_NN: all of the map, held or not
//!     [ -P_Nj M_jᵀ           P_Nj P_j⁻¹ P_jN / x ]
//! ```
//! is positive semidefinite, and in the sum the state does not depend on `e_j` any more.
//!
//! **Independent keyframes.** The lower corner is `P_j / x` for `j` itself and zero else (split covariance intersection
//! with `w = 1 / (1 + x)`). So the state's covariance grows by `x M_j P_j M_jᵀ`, and a number is kept for `j`: pulled
//! again, it enters as new, `1 + 1/x` times as uncertain as it was taken for the last time.
//!
//! **Keyframes that depend on each other.** The lower corner is not known: keyframes that depend on `j` may come later. But
//! it is at most `P_NN / x`, so the whole map is taken for `1 + 1/x` times as uncertain from then on, by one number. (That
//! the error of `j` that its held neighbours do not predict would be independent of the rest is true only
//! of *all* keyframes that are linked with it; then still not of those to come.) To need little of it, several
//! are dropped at once, with one `D` for all, and before that `e_j = G e_k + rest` for the neighbours `k` that say
//! most about `j`: `M_k += M_j G`, and only `M_j rest` is dropped. That holds for any `G`.
//!
//! **The choice of `x`.** A large one burdens the state, a small one the map. With the *share* of `j` in the state
//! `s = tr(P_AA⁻¹ M_j P_j M_jᵀ)` the state grows by less than `x s` in any direction and the keyframe by `1/x`;
//! `x = sqrt(price / s)` minimizes `x s + price / x`. A keyframe that the state has nearly forgotten returns nearly new.
//!
//! Source of the bound: Julier & Uhlmann, "Using covariance intersection for SLAM", RAS 2007.

use super::moving::KEYFRAME_DIM;
use super::{HeldKeyframe, HeldKeyframes};
use crate::KeyframeId;
use crate::linear_algebra::dense::{Dense, Factorization};
use nalgebra::{DMatrix, Matrix6};
use std::collections::HashMap;

/// Dropped together, so that they share the way to now and one root of `P_AA`.
const DROPPED_AT_ONCE: usize = 16;
/// Neighbours that take over what they say about a dropped keyframe.
const NEIGHBOURS: usize = 2;
/// One keyframe twice as uncertain is worth this much growth of the state's covariance: some hundred keyframes of a
/// place carry a robot, and each of them returns.
const PRICE_OF_KEYFRAME: f64 = 0.01;
/// The same for all keyframes of the map together: they and the state are worth the same.
pub const PRICE_OF_MAP: f64 = 1.0;
/// A smaller share is rounding.
pub const LEAST_SHARE: f64 = 1e-12;
/// By how much the diagonal of `P_AA` is lifted for its root: the newest clone is a copy of the body's pose.
const LIFT: f64 = 1e-9;

/// What must be remembered of dropped keyframes.
#[derive(Clone, Debug)]
pub struct Budget {
    /// How uncertain each enters again, as a multiple of what the map states.
    returning: HashMap<KeyframeId, f64>,
    /// The largest of these.
    largest: f64,
    /// How uncertain the whole map is taken for, as a multiple of what it states.
    map_factor: f64,
    /// The map has told of keyframes that depend on each other.
    correlated: bool,
}

impl Default for Budget {
    fn default() -> Self {
        Self { returning: HashMap::new(), largest: 1.0, map_factor: 1.0, correlated: false }
    }
}

impl Budget {
    /// How uncertain the whole map is taken for, as a multiple of what it states. Loadings are scaled by it: they refer to
    /// the stated covariance.
    pub fn map_factor(&self) -> f64 {
        self.map_factor
    }

    /// From here on keyframes may depend on dropped ones.
    pub fn note_correlated_map(&mut self) {
        self.correlated = true;
    }

    /// How uncertain a keyframe enters, as a multiple of what the map states, beside [`Self::map_factor`].
    pub fn factor_of_entering(&self, id: KeyframeId) -> f64 {
        if self.correlated { self.largest } else { self.returning.get(&id).copied().unwrap_or(1.0) }
    }

    /// From here on the errors of keyframes are others, which may depend on those of dropped ones.
    pub fn note_other_errors(&mut self) {
        self.correlated |= self.largest > 1.0;
    }

    /// Takes the whole map for so many times as uncertain as before.
    pub fn enlarge_map(&mut self, factor: f64) {
        self.map_factor *= factor;
    }

    /// Bytes on the heap.
    pub fn heap_bytes(&self) -> usize {
        self.returning.capacity() * size_of::<(KeyframeId, f64)>()
    }

    fn note_dropped(&mut self, id: KeyframeId, factor: f64) {
        self.returning.insert(id, factor);
        self.largest = self.largest.max(factor);
    }
}

/// See [`HeldKeyframes::drop_surplus`].
pub fn drop_surplus(held: &mut HeldKeyframes, max_held: usize, active: &mut Dense) -> usize {
    let surplus = held.len().saturating_sub(max_held);
    if surplus == 0 {
        return 0;
    }
    let oldest = held.parked.least_recently_used(surplus.max(DROPPED_AT_ONCE));
    let (dropped, loadings) = held.parked.take(&oldest, &mut held.moving);
    let growth = if held.budget.correlated {
        drop_dependent(held, &dropped, &loadings, active)
    } else {
        drop_independent(held, &dropped, &loadings, active)
    };
    let transposed = growth.transpose();
    active.view_mut().gemm(1.0, &growth, &transposed, 1.0);
    active.mirror_lower();
    for keyframe in &dropped {
        held.correlations.remove(keyframe.id);
    }
    dropped.len()
}

/// Each with its own `x`. Returns a root of what the state's covariance grows by.
fn drop_independent(
    held: &mut HeldKeyframes,
    dropped: &[HeldKeyframe],
    loadings: &Dense,
    active: &Dense,
) -> DMatrix<f64> {
    let mut growth = loadings.view().into_owned();
    for (k, keyframe) in dropped.iter().enumerate() {
        let mut root = Dense::from_columns(KEYFRAME_DIM, own_covariance(keyframe).as_slice());
        lower_root(&mut root);
        let mut part = growth.columns_mut(KEYFRAME_DIM * k, KEYFRAME_DIM);
        let product = &part * root.view();
        part.copy_from(&product);
    }
    let shares = column_shares(&growth, active);
    for (k, (keyframe, shares)) in dropped.iter().zip(shares.chunks_exact(KEYFRAME_DIM)).enumerate() {
        let x = (PRICE_OF_KEYFRAME / shares.iter().sum::<f64>().max(LEAST_SHARE)).sqrt();
        growth.columns_mut(KEYFRAME_DIM * k, KEYFRAME_DIM).scale_mut(x.sqrt());
        held.budget.note_dropped(keyframe.id, keyframe.factor * (1.0 + 1.0 / x));
    }
    growth
}

/// All with one `x`, after their neighbours took over what they know. Returns as above.
fn drop_dependent(
    held: &mut HeldKeyframes,
    dropped: &[HeldKeyframe],
    loadings: &Dense,
    active: &Dense,
) -> DMatrix<f64> {
    let is_dropped = |id: KeyframeId| dropped.iter().any(|keyframe| keyframe.id == id);
    let neighbours: Vec<Vec<KeyframeId>> = dropped
        .iter()
        .map(|keyframe| {
            let mut others: Vec<(f64, KeyframeId)> =
                held.correlations.with(keyframe.id).map(|(other, block)| (block.norm(), other)).collect();
            others.retain(|(_, other)| !is_dropped(*other));
            others.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            others.iter().take(NEIGHBOURS).map(|(_, other)| *other).collect()
        })
        .collect();
    let mut heirs: Vec<KeyframeId> = neighbours.iter().flatten().copied().collect();
    heirs.sort_unstable();
    heirs.dedup();
    held.activate(&heirs);
    heirs.retain(|heir| held.slot_of(*heir).is_some());

    // Errors of the dropped ones and then of their heirs, and what of them is not predicted: `T e`.
    let slots = heirs.iter().filter_map(|heir| held.slot_of(*heir)).map(|slot| &held.active[slot]);
    let all: Vec<&HeldKeyframe> = dropped.iter().chain(slots).collect();
    let covariance = covariance_of(held, &all);
    let (own, dim) = (KEYFRAME_DIM * dropped.len(), covariance.nrows());
    let mut rest = DMatrix::zeros(own, dim);
    rest.fill_diagonal(1.0);
    for (k, neighbours) in neighbours.iter().enumerate() {
        let place = |id: &KeyframeId| heirs.iter().position(|heir| heir == id);
        let of_neighbours: Vec<usize> = neighbours
            .iter()
            .filter_map(place)
            .flat_map(|heir| (0..KEYFRAME_DIM).map(move |j| own + KEYFRAME_DIM * heir + j))
            .collect();
        let known = covariance.select_rows(&of_neighbours).select_columns(&of_neighbours);
        let common =
            covariance.columns(KEYFRAME_DIM * k, KEYFRAME_DIM).into_owned().select_rows(&of_neighbours);
        // Neighbours known exactly, or not at all, predict nothing.
        let Some(factor) = known.cholesky() else { continue };
        let predicted = factor.solve(&common).transpose();
        for (j, column) in of_neighbours.iter().enumerate() {
            rest.view_mut((KEYFRAME_DIM * k, *column), (KEYFRAME_DIM, 1)).copy_from(&-predicted.column(j));
        }
    }
    let inherited = -(loadings.view() * rest.columns(own, dim - own));
    let width = KEYFRAME_DIM * loadings.nrows();
    for (heir, increase) in heirs.iter().zip(inherited.as_slice().chunks_exact(width)) {
        if let Some(slot) = held.slot_of(*heir) {
            held.moving.add_to_loadings(slot, increase);
        }
    }

    let before = held.budget.map_factor;
    let mut root = Dense::from(&rest * covariance * rest.transpose() / before);
    lower_root(&mut root);
    let mut growth = loadings.view() * root.view();
    let share: f64 = column_shares(&growth, active).iter().sum();
    let x = (PRICE_OF_MAP / share.max(LEAST_SHARE)).sqrt();
    growth.scale_mut(x.sqrt());
    held.budget.map_factor = before * (1.0 + 1.0 / x);
    for keyframe in dropped {
        held.budget.note_dropped(keyframe.id, keyframe.factor);
    }
    growth
}

/// What the map states, as uncertain as the keyframe is taken for, without the factor of the whole map.
pub fn own_covariance(keyframe: &HeldKeyframe) -> Matrix6<f64> {
    keyframe.global_from_keyframe.covariance * keyframe.factor
}

/// `P_NN` of some keyframes, without the factor of the whole map.
fn covariance_of(held: &HeldKeyframes, keyframes: &[&HeldKeyframe]) -> DMatrix<f64> {
    let dim = KEYFRAME_DIM * keyframes.len();
    let mut covariance = DMatrix::zeros(dim, dim);
    for (i, a) in keyframes.iter().enumerate() {
        for (j, b) in keyframes.iter().enumerate() {
            let own = (i == j).then(|| own_covariance(a));
            if let Some(block) = own.or_else(|| held.correlations.between(a.id, b.id).copied()) {
                covariance.fixed_view_mut::<6, 6>(KEYFRAME_DIM * i, KEYFRAME_DIM * j).copy_from(&block);
            }
        }
    }
    covariance
}

/// A root of a positive semidefinite matrix, lower triangular. Of a broken one nothing is left.
fn lower_root(matrix: &mut Dense) {
    if Factorization::default().semidefinite_cholesky(matrix).is_err() {
        matrix.view_mut().fill(0.0);
    }
    matrix.view_mut().fill_upper_triangle(0.0, 1);
}

/// `f P_AA⁻¹ fᵀ` for each column `f`.
fn column_shares(columns: &DMatrix<f64>, active: &Dense) -> Vec<f64> {
    let mut root = lifted(active);
    let mut solved = Dense::from(columns.clone());
    if Factorization::default().cholesky(&mut root).is_err() {
        return vec![1.0; columns.ncols()];
    }
    solved.solve_lower(&root);
    (0..solved.ncols()).map(|k| solved.column(k).iter().map(|value| value * value).sum()).collect()
}

/// `P_AA` with a diagonal that is a little larger, so that it has a root.
pub fn lifted(active: &Dense) -> Dense {
    let mut lifted = active.clone();
    for k in 0..lifted.nrows() {
        lifted[(k, k)] *= 1.0 + LIFT;
    }
    lifted
}
