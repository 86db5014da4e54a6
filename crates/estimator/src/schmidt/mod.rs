//! The keyframes that the filter holds as consider (nuisance) states: `P_AN` and `P_NN`, exact for as long as they are held.
//!
//! Derivation, complexity and tests: `docs/src/derivations/schmidt.md`.
//!
//! `P_AN` is not stored. Under Schmidt's update `P_AN = M P_NN` holds for a matrix `M`, the *consider sensitivity*
//! `P_AN P_NN⁻¹`: by how much the state errs where a keyframe errs. All that happens to it is
//! ```text
//! propagation, cloning, marginalization   M ← F M
//! update with gain K on blocks C, T       M ← M - K H (M_C; E_T)    E_T: identity on the keyframes used
//! a keyframe is inserted                  M gets columns of zeros, whatever cross-covariances the map states
//! ```
//! so a keyframe that is not used is only multiplied from the left, with or without cross-covariances.
//!
//! The errors common to all keyframes of a large map, `e_k = U_k x + rest`, are one more consider state `x`, of which the
//! sensitivity `X` is kept: `M` and `P_NN` above are those of the rests then, and `P_Aj = X U_jᵀ + sum of M_k P_kj`.
//!
//! | module | |
//! |---|---|
//! | `active` | keyframes used lately: every step of the filter applies to their sensitivities |
//! | `inactive`, `level` | the others: brought up to date when they are activated again |
//! | `rank_factorization` | fewer rows for the sensitivities of inactive keyframes |
//! | `eviction` | no more keyframes than `max_held_keyframes` |
//! | `invalidation` | keyframes that a new version of the map changes |
//! | `inflation` | factors on the map's covariance that eviction and invalidation leave behind |
//! | `correlations` | cross-covariances that the map states |
//!
//! The covariance `P_Aj` that an update needs is the sum of `M_k P_kj` over the held keyframes correlated with `j`: its cost
//! depends on their number, not on how many are held.

mod active;
mod correlations;
mod eviction;
mod inactive;
mod inflation;
mod invalidation;
mod keyframe;
mod level;
mod rank_factorization;

pub use keyframe::HeldKeyframe;

use crate::KeyframeId;
use crate::linear_algebra::dense::Dense;
use crate::linear_algebra::dependence::Dependence;
use crate::measurement::{LinearizedMeasurement, StateBlocks};
use crate::propagation::ImuMatrix;
use active::ActiveKeyframes;
use correlations::Correlations;
use geometry::PoseWithCovariance;
use inactive::InactiveKeyframes;
use inflation::MapInflation;
use keyframe::KEYFRAME_DIM;
use nalgebra::{DMatrix, Matrix6, Matrix6xX};
use std::ops::Range;
use std::sync::Arc;

/// All held keyframes and their covariance with the active state and each other.
#[derive(Clone, Debug)]
pub struct HeldKeyframes {
    active: ActiveKeyframes,
    inactive: InactiveKeyframes,
    correlations: Correlations,
    inflation: MapInflation,
    max_active: usize,
    uses: u64,
}

impl HeldKeyframes {
    /// No keyframes, beside an active error state of `dim` numbers.
    pub fn new(dim: usize, max_active: usize) -> Self {
        Self {
            active: ActiveKeyframes::new(dim),
            inactive: InactiveKeyframes::default(),
            correlations: Correlations::default(),
            inflation: MapInflation::default(),
            max_active,
            uses: 0,
        }
    }

    /// Whether none is held.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// How many are held, active and inactive.
    pub fn len(&self) -> usize {
        self.active.keyframes().len() + self.inactive.len()
    }

    /// Identities of all held keyframes, the active ones first.
    pub fn ids(&self) -> impl Iterator<Item = KeyframeId> + '_ {
        self.active.keyframes().iter().map(|keyframe| keyframe.id).chain(self.inactive.ids())
    }

    /// The slot of an active keyframe. Slots are valid until keyframes are deactivated, removed or invalidated.
    pub fn slot_of(&self, id: KeyframeId) -> Option<usize> {
        self.active.keyframes().iter().position(|keyframe| keyframe.id == id)
    }

    /// An active keyframe.
    pub fn get(&self, slot: usize) -> &HeldKeyframe {
        &self.active.keyframes()[slot]
    }

    /// Whether a keyframe is held, active or inactive.
    pub fn contains(&self, id: KeyframeId) -> bool {
        self.find(id).is_some()
    }

    /// Covariance of a held keyframe as the map states it: of its error, and of what of it is beyond the `U x` of
    /// [`Self::activate_or_insert`].
    pub fn map_covariance(&self, id: KeyframeId) -> Option<[Matrix6<f64>; 2]> {
        let keyframe = self.find(id)?;
        let covariance = keyframe.global_from_keyframe.covariance;
        Some([covariance, covariance - keyframe.common_with(keyframe)])
    }

    fn find(&self, id: KeyframeId) -> Option<&HeldKeyframe> {
        let active = self.slot_of(id).map(|slot| self.get(slot));
        active.or_else(|| self.inactive.get(id))
    }

    /// Whether the map states cross-covariances between any held keyframes.
    pub fn has_correlations(&self) -> bool {
        !self.correlations.is_empty() || self.common_dim().is_some()
    }

    /// How many numbers `x` has; `None` where the map states no errors common to its keyframes.
    pub fn common_dim(&self) -> Option<usize> {
        Some(self.active.common_dim().max(self.inactive.common_dim())).filter(|dim| *dim > 0)
    }

    /// `P_Aj` of an active slot, state x 6.
    pub fn cross_covariance(&self, slot: usize) -> DMatrix<f64> {
        let keyframe = self.get(slot);
        let own = keyframe.covariance_of_rest();
        let correlated = self.correlations.with(keyframe.id);
        let mut cross = self.weighted_sensitivity(std::iter::once((keyframe.id, &own)).chain(correlated));
        if keyframe.common.ncols() > 0 && self.active.common_dim() > 0 {
            self.active.add_common_times(&keyframe.common, &mut cross);
        }
        let mut cross = DMatrix::from(cross.view());
        if keyframe.common.ncols() > 0 && self.inactive.common_dim() > 0 {
            cross += self.inactive.common_times(&keyframe.common, &self.active).view();
        }
        cross
    }

    /// By how much the state errs where each held keyframe `k` errs by `B_k` times the same six numbers, state x 6: `sum of M_k B_k`
    /// divided by the inflation of the map, to whose stated covariance `M` refers.
    ///
    /// # Arguments
    /// * `terms`: keyframes with their `B_k`; those that are not held are ignored.
    pub fn error_by_keyframes<'a>(
        &self,
        terms: impl Iterator<Item = (KeyframeId, &'a Matrix6<f64>)> + Clone,
    ) -> Dense {
        let mut sum = self.weighted_sensitivity(terms);
        let inflation = self.inflation.of_map();
        sum.view_mut().iter_mut().for_each(|number| *number /= inflation);
        sum
    }

    /// `sum of M_k B_k` over held keyframes, state x 6.
    fn weighted_sensitivity<'a>(
        &self,
        terms: impl Iterator<Item = (KeyframeId, &'a Matrix6<f64>)> + Clone,
    ) -> Dense {
        let mut sum = Dense::zeros(self.active.dim(), KEYFRAME_DIM);
        for (id, block) in terms.clone() {
            if let Some(slot) = self.slot_of(id) {
                let block = Dense::from_columns(KEYFRAME_DIM, block.as_slice());
                self.active.add_sensitivity_times(slot, &block, &mut sum);
            }
        }
        if let Some(of_inactive) = self.inactive.weighted_sum(terms, &self.active) {
            sum.view_mut().zip_apply(&of_inactive.view(), |total, number| *total += number);
        }
        sum
    }

    /// All held keyframes, the active ones first.
    pub fn keyframes(&self) -> impl Iterator<Item = &HeldKeyframe> {
        self.active.keyframes().iter().chain(self.inactive.keyframes())
    }

    /// `P_NN` of some active slots as the filter uses it, with all inflation.
    pub fn covariance_of(&self, slots: &[usize]) -> DMatrix<f64> {
        let keyframes: Vec<&HeldKeyframe> = slots.iter().map(|&slot| self.get(slot)).collect();
        self.covariance_between(&keyframes) * self.inflation.of_map()
    }

    /// `P_NN` of some keyframes, without the inflation of the whole map.
    fn covariance_between(&self, keyframes: &[&HeldKeyframe]) -> DMatrix<f64> {
        self.blocks_between(keyframes, HeldKeyframe::covariance, HeldKeyframe::common_with)
    }

    /// The same of their errors beyond what all have in common.
    fn covariance_of_rests(&self, keyframes: &[&HeldKeyframe]) -> DMatrix<f64> {
        self.blocks_between(keyframes, HeldKeyframe::covariance_of_rest, |_, _| Matrix6::zeros())
    }

    /// The covariance of some keyframes by blocks.
    ///
    /// # Arguments
    /// * `together`: of two keyframes, what is added to the cross-covariance that the map lists.
    fn blocks_between(
        &self,
        keyframes: &[&HeldKeyframe],
        own: impl Fn(&HeldKeyframe) -> Matrix6<f64>,
        together: impl Fn(&HeldKeyframe, &HeldKeyframe) -> Matrix6<f64>,
    ) -> DMatrix<f64> {
        let dim = KEYFRAME_DIM * keyframes.len();
        let mut covariance = DMatrix::zeros(dim, dim);
        for (i, a) in keyframes.iter().enumerate() {
            for (j, b) in keyframes.iter().enumerate() {
                let listed = || self.correlations.between(a.id, b.id).copied().unwrap_or_default();
                let block = if i == j { own(a) } else { together(a, b) + listed() };
                covariance.fixed_view_mut::<6, 6>(KEYFRAME_DIM * i, KEYFRAME_DIM * j).copy_from(&block);
            }
        }
        covariance
    }

    /// Activates inactive keyframes, all at once.
    ///
    /// # Arguments
    /// * `ids`: those that are not inactive are ignored.
    pub fn activate(&mut self, ids: &[KeyframeId]) {
        let (keyframes, sensitivity) = self.inactive.remove(ids, &mut self.active);
        self.active.push(keyframes, &sensitivity);
    }

    /// Makes a keyframe active, as most recently used, and returns its slot.
    ///
    /// A keyframe that is held keeps its pose and its correlation with the state. Any other is inserted with the map's
    /// covariance, uncorrelated with the state.
    ///
    /// # Arguments
    /// * `common`: `U` of its error `U x + rest`, without columns where the map states none; of all keyframes equally many.
    /// * `cross`: covariances of the rest with other held keyframes; rows are its own error. Others are ignored.
    pub fn activate_or_insert(
        &mut self,
        id: KeyframeId,
        global_from_keyframe: &PoseWithCovariance,
        common: &Matrix6xX<f64>,
        cross: &[(KeyframeId, Matrix6<f64>)],
    ) -> usize {
        self.uses += 1;
        if self.slot_of(id).is_none() {
            self.activate(&[id]);
        }
        if let Some(slot) = self.slot_of(id) {
            self.active.keyframes_mut()[slot].last_used = self.uses;
            return slot;
        }
        for (other, block) in cross {
            if *other != id && self.contains(*other) {
                self.correlations.insert(id, *other, block);
                self.inflation.set_map_correlated();
            }
        }
        if common.ncols() > 0 {
            if self.common_dim().is_none() {
                self.active.set_common(&Dense::zeros(self.active.dim(), common.ncols()));
            }
            self.inflation.set_map_correlated();
        }
        let keyframe = HeldKeyframe {
            id,
            global_from_keyframe: *global_from_keyframe,
            common: Arc::new(Dense::from_columns(KEYFRAME_DIM, common.as_slice())),
            inflation: self.inflation.of_entering(id),
            last_used: self.uses,
        };
        self.active.push([keyframe], &Dense::zeros(self.active.dim(), KEYFRAME_DIM));
        self.active.keyframes().len() - 1
    }

    /// Removes keyframes that were inserted but not used in any update: no information is lost.
    pub fn remove_unused(&mut self, ids: &[KeyframeId]) {
        for &id in ids {
            if let Some(slot) = self.slot_of(id) {
                self.active.remove(slot);
            }
            self.correlations.remove(id);
        }
        // Nothing depends on `x` where no keyframe that depends on it was used.
        if self.common_dim().is_some() && !self.any_has_common_error() {
            self.take_common();
        }
    }

    /// `X` as it is now, which is zero from then on; without columns where the map states nothing of it.
    fn take_common(&mut self) -> Dense {
        self.activate_common();
        self.active.take_common()
    }

    /// Steps apply to `X` as to the active keyframes, until [`Self::deactivate_unused`].
    fn activate_common(&mut self) {
        if self.inactive.common_dim() > 0 {
            let common = self.inactive.take_common(&mut self.active);
            self.active.set_common(&common);
        }
    }

    /// Whether the error of any held keyframe depends on `x`.
    fn any_has_common_error(&self) -> bool {
        let mut held = self.active.keyframes().iter().chain(self.inactive.keyframes());
        held.any(|keyframe| keyframe.common.ncols() > 0)
    }

    /// Deactivates the least recently used keyframes when more than `max_active` are active. Slots change.
    pub fn deactivate_unused(&mut self) {
        let members = self.remove_least_recently_used();
        if !members.is_empty() || self.active.common_dim() > 0 {
            let common = self.take_common();
            self.inactive.deactivate(members, common, &mut self.active);
        }
    }

    /// Removes the least recently used active keyframes when more than `max_active` are active.
    fn remove_least_recently_used(&mut self) -> Vec<(HeldKeyframe, Dense)> {
        let count = self.active.keyframes().len();
        if count <= self.max_active {
            return Vec::new();
        }
        let mut by_last_use: Vec<(u64, KeyframeId)> =
            self.active.keyframes().iter().map(|keyframe| (keyframe.last_used, keyframe.id)).collect();
        by_last_use.sort_unstable();
        // Half of them at once: each level costs a transition matrix.
        let oldest = &by_last_use[..count - self.max_active / 2];
        let slots = oldest.iter().map(|(_, id)| *id);
        slots.filter_map(|id| self.slot_of(id).map(|slot| self.active.remove(slot))).collect()
    }

    /// Background work on inactive keyframes, once an image: bounded by about the cost of a step.
    pub fn compact(&mut self) {
        self.inactive.compact(&mut self.active);
    }

    /// `M ← F M` for an `F` that touches only the IMU's rows, which are the first.
    pub fn propagate(&mut self, transition: &ImuMatrix) {
        self.active.propagate(transition);
    }

    /// The rows become the old rows `source`, one range after the other.
    pub fn gather_rows(&mut self, source: &[Range<usize>]) {
        self.active.gather_rows(source);
    }

    /// Some active errors grew by multiples of others.
    pub fn add_dependences<const R: usize, const C: usize>(&mut self, dependences: &[Dependence<R, C>]) {
        self.active.add_dependences(dependences);
    }

    /// The state was augmented at `at` by `jacobian` times its `blocks`, plus independent noise.
    pub fn insert_rows(&mut self, at: usize, blocks: &StateBlocks, jacobian: &Dense) {
        self.active.insert_rows(at, blocks, jacobian);
    }

    /// `P_AN -= Wᵀ L⁻¹ H P_CN`, which is `M -= Wᵀ L⁻¹ H (M_C; E_T)` and `X -= Wᵀ L⁻¹ H (X_C; U_T)`.
    ///
    /// # Arguments
    /// * `whitened`: `W`.
    /// * `innovation`: `L` in its lower triangle.
    pub fn measurement_update(
        &mut self,
        measurement: &LinearizedMeasurement,
        whitened: &Dense,
        innovation: &Dense,
    ) {
        if measurement.blocks.keyframes.iter().any(|&slot| self.get(slot).common.ncols() > 0) {
            self.activate_common();
        }
        self.active.measurement_update(measurement, whitened, innovation, self.inflation.of_map());
    }

    /// Bytes on the heap.
    pub fn heap_bytes(&self) -> usize {
        self.active.heap_bytes()
            + self.inactive.heap_bytes()
            + self.correlations.heap_bytes()
            + self.inflation.heap_bytes()
    }

    /// Of each level of inactive keyframes, oldest first: its members, and the rows of their sensitivities.
    pub fn levels(&self) -> Vec<(usize, usize)> {
        self.inactive.levels().collect()
    }
}
