//! The keyframes that the filter holds: `P_AN` and `P_NN`, exact for as long as a keyframe is held.
//!
//! `P_AN` is not stored. With Schmidt's update `P_AN = M P_NN` always holds for a matrix `M`, the *loadings*: by how much
//! the state errs where a keyframe errs. All that happens to it is
//! ```text
//! propagation, cloning, marginalization   M ← F M
//! update with gain K on columns C         M ← M - K H (M_C; E_T)   E_T: the identity on the keyframes used
//! a keyframe enters                       M gets a column of zeros, whatever the map says of its correlations
//! ```
//! so a keyframe that is not used is only multiplied from the left, cross-covariances or not.
//!
//! Dropping a keyframe and pulling it again as if it were new would count its information twice. So
//! a keyframe stays. Those used lately are *active*: their loadings are touched by every step (`moving`). The others are
//! *parked*: one matrix, touched by every step, collects what happened since the last of them was parked, and one that
//! is matched again is brought up to date through a chain of such matrices (`parked`). The covariance `P_Aj` that an update
//! needs is the sum of `M_k P_kj` over the held keyframes that the map correlates with `j`: its cost depends on how many
//! these are, not on how many are held. More than a budget are not held: see `budget`. Those that the map changed are
//! given up: see `given_up`.

mod budget;
mod correlations;
mod given_up;
mod layer;
mod moving;
mod packed;
mod parked;
mod roomy;
mod waist;

use crate::KeyframeId;
use crate::linear_algebra::dense::Dense;
use crate::measurement::{LinearizedMeasurement, StateBlocks};
use crate::propagation::ImuMatrix;
use budget::Budget;
use correlations::Correlations;
use geometry::PoseWithCovariance;
use moving::{KEYFRAME_DIM, Moving};
use nalgebra::{DMatrix, Matrix6};
use parked::Parked;
use std::ops::Range;

/// A keyframe of the map in the nuisance state.
#[derive(Clone, Debug)]
pub struct HeldKeyframe {
    /// Its name in the map.
    pub id: KeyframeId,
    /// Pose and covariance as the map states them. Never changed by the filter.
    pub global_from_keyframe: PoseWithCovariance,
    /// The filter takes its covariance for this many times the stated one: 1, but for one that was dropped before.
    factor: f64,
    /// Number of the pull; no two are alike.
    last_used: u64,
}

/// All held keyframes and their covariance with the active state and each other.
#[derive(Clone, Debug)]
pub struct HeldKeyframes {
    active: Vec<HeldKeyframe>,
    /// The loadings of the active ones, in their order, and what the parked ones wait for.
    moving: Moving,
    correlations: Correlations,
    parked: Parked,
    budget: Budget,
    max_active: usize,
    uses: u64,
}

impl HeldKeyframes {
    /// None held, beside an active error of `rows` numbers.
    pub fn new(rows: usize, max_active: usize) -> Self {
        Self {
            active: Vec::new(),
            moving: Moving::new(rows),
            correlations: Correlations::default(),
            parked: Parked::default(),
            budget: Budget::default(),
            max_active,
            uses: 0,
        }
    }

    /// Whether none is held.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// How many are held, active and parked.
    pub fn len(&self) -> usize {
        self.active.len() + self.parked.len()
    }

    /// All names.
    pub fn ids(&self) -> impl Iterator<Item = KeyframeId> + '_ {
        self.active.iter().map(|keyframe| keyframe.id).chain(self.parked.ids())
    }

    /// The slot of an active keyframe.
    pub fn slot_of(&self, id: KeyframeId) -> Option<usize> {
        self.active.iter().position(|keyframe| keyframe.id == id)
    }

    /// A held keyframe by its slot.
    pub fn get(&self, slot: usize) -> &HeldKeyframe {
        &self.active[slot]
    }

    /// Covariance of a held keyframe, active or parked, as the map states it.
    pub fn map_covariance(&self, id: KeyframeId) -> Option<Matrix6<f64>> {
        let active = self.slot_of(id).map(|slot| &self.active[slot]);
        let keyframe = active.or_else(|| self.parked.get(id))?;
        Some(keyframe.global_from_keyframe.covariance)
    }

    /// Gives up keyframes that were just pulled and never used: nothing is lost.
    pub fn remove_unused(&mut self, ids: &[KeyframeId]) {
        for &id in ids {
            if let Some(slot) = self.slot_of(id) {
                self.moving.remove(slot);
                self.active.remove(slot);
            }
            self.correlations.remove(id);
        }
    }

    /// `P_Aj` of an active slot.
    pub fn cross_covariance(&self, slot: usize) -> DMatrix<f64> {
        let mut cross = Dense::zeros(self.moving.nrows(), KEYFRAME_DIM);
        let mut add = |of: usize, block: &Matrix6<f64>| {
            let block = Dense::from_columns(KEYFRAME_DIM, block.as_slice());
            self.moving.add_loadings_times(of, &block, &mut cross);
        };
        let keyframe = &self.active[slot];
        add(slot, &(keyframe.global_from_keyframe.covariance * keyframe.factor));
        if self.has_correlations() {
            for (of, other) in self.active.iter().enumerate().filter(|(of, _)| *of != slot) {
                if let Some(block) = self.correlations.between(other.id, keyframe.id) {
                    add(of, block);
                }
            }
        }
        let mut cross = DMatrix::from(cross.view());
        if let Some(parked) = self.parked.weighted_sum(self.correlations.with(keyframe.id), &self.moving) {
            cross += parked.view();
        }
        cross
    }

    /// Whether the map says of any held keyframe that its error depends on another's.
    pub fn has_correlations(&self) -> bool {
        !self.correlations.is_empty()
    }

    /// `P_NN` of some active slots, as the filter takes it.
    pub fn covariance_of(&self, slots: &[usize]) -> DMatrix<f64> {
        let mut covariance = DMatrix::zeros(KEYFRAME_DIM * slots.len(), KEYFRAME_DIM * slots.len());
        for (i, &a) in slots.iter().enumerate() {
            for (j, &b) in slots.iter().enumerate() {
                let (first, second) = (&self.active[a], &self.active[b]);
                let block = if a == b {
                    Some(first.global_from_keyframe.covariance * first.factor)
                } else {
                    self.correlations.between(first.id, second.id).copied()
                };
                if let Some(block) = block {
                    let scaled = block * self.budget.map_factor();
                    covariance.fixed_view_mut::<6, 6>(6 * i, 6 * j).copy_from(&scaled);
                }
            }
        }
        covariance
    }

    /// Makes parked keyframes active, all at once: cheaper than to [`Self::pull`] one after the other.
    ///
    /// # Arguments
    /// * `ids`: those that are not parked are passed over.
    pub fn activate(&mut self, ids: &[KeyframeId]) {
        let (revived, loadings) = self.parked.take(ids, &mut self.moving);
        self.moving.push(loadings.as_slice());
        self.active.extend(revived);
    }

    /// Makes a keyframe active and returns its slot.
    ///
    /// One that is held keeps its pose and its correlation with the state; a new one enters with the
    /// map's covariance and with `cross` (its covariance with other held keyframes, rows are its own error).
    pub fn activate_or_insert(
        &mut self,
        id: KeyframeId,
        global_from_keyframe: &PoseWithCovariance,
        cross: &[(KeyframeId, Matrix6<f64>)],
    ) -> usize {
        self.uses += 1;
        if self.slot_of(id).is_none() {
            self.activate(&[id]);
        }
        if let Some(slot) = self.slot_of(id) {
            self.active[slot].last_used = self.uses;
            return slot;
        }
        for (other, block) in cross {
            if *other != id && self.map_covariance(*other).is_some() {
                self.correlations.insert(id, *other, block);
                self.budget.note_correlated_map();
            }
        }
        let (factor, last_used) = (self.budget.factor_of_entering(id), self.uses);
        let global_from_keyframe = *global_from_keyframe;
        self.active.push(HeldKeyframe { id, global_from_keyframe, factor, last_used });
        self.moving.push_zeros();
        self.active.len() - 1
    }

    /// Parks the keyframes that were not used for longest, until few enough are active.
    ///
    /// Slots change; call it when no slot is in use.
    pub fn deactivate_unused(&mut self) {
        if self.active.len() > self.max_active {
            let mut candidates: Vec<(u64, KeyframeId)> =
                self.active.iter().map(|keyframe| (keyframe.last_used, keyframe.id)).collect();
            candidates.sort_unstable();
            // Half of them at once, so that a layer is worth the matrix behind it.
            let surplus = self.active.len() - self.max_active / 2;
            let mut members = Vec::with_capacity(surplus);
            for (_, id) in &candidates[..surplus] {
                let Some(slot) = self.slot_of(*id) else { continue };
                members.push((self.active.remove(slot), self.moving.loadings(slot)));
                self.moving.remove(slot);
            }
            self.parked.add(members, &mut self.moving);
        }
    }

    /// Drops the parked keyframes that were not used for longest when more than `max_held` are held; see `budget`.
    ///
    /// # Arguments
    /// * `max_held`: never drops an active one.
    /// * `active`: `P_AA`, which grows.
    ///
    /// # Returns
    /// How many were dropped.
    pub fn evict(&mut self, max_held: usize, active: &mut Dense) -> usize {
        budget::drop_surplus(self, max_held, active)
    }

    /// Gives up keyframes, active or parked, because the map changed and their errors are others from now on; see
    /// `given_up`. Slots change.
    ///
    /// # Arguments
    /// * `ids`: those that are not held are passed over.
    /// * `active`: `P_AA`, which grows.
    pub fn invalidate(&mut self, ids: &[KeyframeId], active: &mut Dense) {
        given_up::give_up(self, ids, active);
    }

    /// Brings a few of the parked keyframes nearer to now; once an image.
    pub fn compact(&mut self) {
        self.parked.compact(&mut self.moving);
    }

    /// `M ← F M` for an `F` that touches only the IMU's rows, which are the first.
    pub fn transform_rows(&mut self, transition: &ImuMatrix) {
        self.moving.transform_rows(transition);
    }

    /// The rows become the old rows `source`, one range after the other.
    pub fn gather_rows(&mut self, source: &[Range<usize>]) {
        self.moving.gather_rows(source);
    }

    /// The error at `begin` grew by `jacobian` times the error at `of`.
    pub fn add_dependence(&mut self, begin: usize, jacobian: &[f64], of: usize) {
        self.moving.add_dependence(begin, jacobian, of);
    }

    /// The active error grew at `at` by `jacobian` times its part `columns`, and something independent.
    pub fn insert_rows(&mut self, at: usize, columns: &StateBlocks, jacobian: &Dense) {
        self.moving.insert_rows(at, columns, jacobian);
    }

    /// `P_AN -= Wᵀ L⁻¹ H P_CN`, which is `M -= Wᵀ L⁻¹ H (M_C; E_T)`.
    ///
    /// # Arguments
    /// * `whitened`: `W`.
    /// * `innovation`: `L` in its lower triangle.
    pub fn measurement_update(&mut self, rows: &LinearizedMeasurement, whitened: &Dense, innovation: &Dense) {
        self.moving.measurement_update(rows, whitened, innovation, self.budget.map_factor());
    }

    /// Bytes that holding them takes, from the capacity of what is stored.
    pub fn heap_bytes(&self) -> usize {
        self.active.capacity() * size_of::<HeldKeyframe>()
            + self.moving.heap_bytes()
            + self.correlations.heap_bytes()
            + self.parked.heap_bytes()
            + self.budget.heap_bytes()
    }

    /// Of each layer of parked keyframes, oldest first: how many they are, and rows of their loadings.
    pub fn layers(&self) -> Vec<(usize, usize)> {
        self.parked.layers().collect()
    }
}
