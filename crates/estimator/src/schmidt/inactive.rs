//! Inactive keyframes: their sensitivities stay as they were and are brought up to date when they are activated.
//!
//! Keyframes deactivated together form a *level*; levels are ordered by that time. Between two of them lies one matrix,
//! the product of all steps of the filter from the one time to the other. Behind the newest lies the transition that is
//! still growing, the only one that a step touches (`R` in `ActiveKeyframes`):
//! ```text
//! level 0 --S0--> level 1 --S1--> ... --S(k-1)--> level k --R--> now        M now = R S(k-1) ... S(i) M of level i
//! ```
//! A level at most 1.5 times as large as the next one is moved into it, a few keyframes a step, each multiplied by the
//! transition. An empty level leaves the product of the transitions beside it. So the number of levels is logarithmic in
//! the number of keyframes, each keyframe is moved logarithmically often, and no single step moves many.
//!
//! The sensitivity `X` to the errors common to keyframes is a member of the newest level, unless it is active.

use super::active::ActiveKeyframes;
use super::keyframe::{HeldKeyframe, KEYFRAME_DIM};
use super::level::{InactiveKeyframe, Level};
use super::rank_factorization::rank_factorization;
use crate::KeyframeId;
use crate::linear_algebra::dense::Dense;
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::BlockStructure::Rectangular;
use faer::{Accum, Par};
use nalgebra::Matrix6;
use std::collections::{BTreeMap, BTreeSet};

/// A level moves into the next one while it is at most this ratio as large. A larger ratio makes fewer levels and more
/// moves.
const LEVEL_RATIO: (usize, usize) = (3, 2);
/// Keyframes moved in one step: enough columns for an efficient product.
const MOVED_AT_ONCE: usize = 12;

/// All inactive keyframes.
#[derive(Clone, Debug, Default)]
pub struct InactiveKeyframes {
    /// Oldest first. None is empty.
    levels: Vec<Level>,
    keyframes: BTreeMap<KeyframeId, InactiveKeyframe>,
    /// `X` at the time of the newest level; without columns where it is active or the map states nothing of it.
    common: Dense,
    next_serial: u64,
}

impl InactiveKeyframes {
    /// How many.
    pub fn len(&self) -> usize {
        self.keyframes.len()
    }

    /// All identities.
    pub fn ids(&self) -> impl Iterator<Item = KeyframeId> + '_ {
        self.keyframes.keys().copied()
    }

    /// An inactive keyframe.
    pub fn get(&self, id: KeyframeId) -> Option<&HeldKeyframe> {
        self.keyframes.get(&id).map(|inactive| &inactive.keyframe)
    }

    /// All of them.
    pub fn keyframes(&self) -> impl Iterator<Item = &HeldKeyframe> {
        self.keyframes.values().map(|inactive| &inactive.keyframe)
    }

    /// The `count` keyframes whose last use is longest ago.
    pub fn least_recently_used(&self, count: usize) -> Vec<KeyframeId> {
        let by_last_use = |inactive: &InactiveKeyframe| (inactive.keyframe.last_used, inactive.keyframe.id);
        let mut ids: Vec<_> = self.keyframes.values().map(by_last_use).collect();
        ids.sort_unstable();
        ids.into_iter().take(count).map(|(_, id)| id).collect()
    }

    /// Adds keyframes with their present sensitivities, as a new level; `R` starts anew.
    ///
    /// # Arguments
    /// * `common`: `X`, which none of the levels has; without columns where the map states nothing of it.
    pub fn deactivate(
        &mut self,
        members: Vec<(HeldKeyframe, Dense)>,
        common: Dense,
        active: &mut ActiveKeyframes,
    ) {
        self.common = common;
        if let Some(newest) = self.levels.last_mut() {
            newest.transition_to_next = active.transition();
        }
        active.set_transition(&Dense::identity(active.dim()));
        self.levels.push(Level::new(self.next_serial));
        self.next_serial += 1;
        for (keyframe, sensitivity) in members {
            self.insert(self.levels.len() - 1, keyframe, sensitivity);
        }
    }

    /// Columns of `X`.
    pub fn common_dim(&self) -> usize {
        self.common.ncols()
    }

    /// `X Uᵀ` now.
    pub fn common_times(&self, common: &Dense, active: &ActiveKeyframes) -> Dense {
        let mut product = Dense::zeros(self.common.nrows(), common.nrows());
        let (of_x, factor) = (self.common.faer(), common.faer().transpose());
        matmul(product.faer_mut(), Accum::Add, of_x, factor, 1.0, Par::Seq);
        active.transition_times(&product)
    }

    /// Takes out `X` as it is now.
    pub fn take_common(&mut self, active: &mut ActiveKeyframes) -> Dense {
        let common = active.transition_times(&std::mem::take(&mut self.common));
        self.remove_empty_levels(active);
        common
    }

    /// Removes a few keyframes.
    ///
    /// # Arguments
    /// * `ids`: those that are not inactive are ignored.
    ///
    /// # Returns
    /// The keyframes and their present sensitivities, six columns each in the same order.
    pub fn remove(&mut self, ids: &[KeyframeId], active: &mut ActiveKeyframes) -> (Vec<HeldKeyframe>, Dense) {
        let mut keyframes = Vec::with_capacity(ids.len());
        let mut sensitivity = Dense::default();
        for (level, (removed, own)) in self.remove_by_level(ids).into_iter().enumerate() {
            keyframes.extend(removed);
            sensitivity.append(&own);
            if !keyframes.is_empty() {
                sensitivity = self.transition_times(level, &sensitivity, active);
            }
        }
        self.remove_empty_levels(active);
        (keyframes, sensitivity)
    }

    /// The same for very many keyframes: the transitions are multiplied with each other first.
    pub fn remove_many(
        &mut self,
        ids: &[KeyframeId],
        active: &mut ActiveKeyframes,
    ) -> (Vec<HeldKeyframe>, Dense) {
        let mut keyframes = Vec::with_capacity(ids.len());
        let mut sensitivity = Dense::default();
        let mut to_now = active.transition();
        for (level, (removed, own)) in self.remove_by_level(ids).into_iter().enumerate().rev() {
            if level + 1 < self.levels.len() {
                to_now = to_now.times(&self.levels[level].transition_to_next);
            }
            if !removed.is_empty() {
                sensitivity.append(&to_now.times(&own));
                keyframes.extend(removed);
            }
        }
        self.remove_empty_levels(active);
        (keyframes, sensitivity)
    }

    /// The present value of `sum of M_k B_k` over those of `terms` that are inactive; `None` where none is.
    pub fn weighted_sum<'a>(
        &self,
        terms: impl Iterator<Item = (KeyframeId, &'a Matrix6<f64>)>,
        active: &ActiveKeyframes,
    ) -> Option<Dense> {
        let mut by_level: BTreeMap<usize, Dense> = BTreeMap::new();
        for (id, block) in terms {
            let Some(inactive) = self.keyframes.get(&id) else { continue };
            let sensitivity = &inactive.sensitivity;
            let sum = by_level
                .entry(self.level_of(inactive)?)
                .or_insert_with(|| Dense::zeros(sensitivity.nrows(), KEYFRAME_DIM));
            let block = Dense::from_columns(KEYFRAME_DIM, block.as_slice());
            sum.add_product(sensitivity, 0..KEYFRAME_DIM, &block, 0..KEYFRAME_DIM, Rectangular);
        }
        let (first, mut sum) = by_level.pop_first()?;
        for level in first..self.levels.len() {
            if let Some(own) = by_level.remove(&level) {
                sum.view_mut().zip_apply(&own.view(), |total, number| *total += number);
            }
            sum = self.transition_times(level, &sum, active);
        }
        Some(sum)
    }

    /// Limits the number of levels, and the rows of their members. To be called in every step, takes about as long as the
    /// step itself.
    pub fn compact(&mut self, active: &mut ActiveKeyframes) {
        // The newest level is no target: its members are few until its transition is complete.
        let complete = self.levels.len().saturating_sub(1);
        let size = |level: usize| self.levels[level].members.len();
        let is_crowded = |older: &usize| LEVEL_RATIO.1 * size(*older) <= LEVEL_RATIO.0 * size(older + 1);
        let crowded = (0..complete.saturating_sub(1)).rev().find(is_crowded);
        if let Some(level) = self.levels[..complete].iter().position(|level| !level.is_reduced) {
            self.reduce(level);
        } else if let Some(older) = crowded {
            self.move_some(older);
            self.remove_empty_levels(active);
        }
    }

    /// Moves some keyframes of a level into the next one.
    fn move_some(&mut self, level: usize) {
        let ids: Vec<KeyframeId> = self.levels[level].members.iter().take(MOVED_AT_ONCE).copied().collect();
        for id in ids {
            if let Some(InactiveKeyframe { keyframe, sensitivity, .. }) = self.remove_one(id) {
                let moved = self.levels[level].transition_to_next.times(&sensitivity);
                self.insert(level + 1, keyframe, moved);
            }
        }
    }

    /// Factors the transition behind a level as `S = Q C`: its members become `C M`, the transition `Q`.
    fn reduce(&mut self, level: usize) {
        let (left, right) = rank_factorization(&self.levels[level].transition_to_next);
        for id in &self.levels[level].members {
            if let Some(member) = self.keyframes.get_mut(id) {
                member.sensitivity = right.times(&member.sensitivity);
            }
        }
        if let Some(before) = level.checked_sub(1).map(|before| &mut self.levels[before]) {
            before.transition_to_next = right.times(&before.transition_to_next);
        }
        self.levels[level].transition_to_next = left;
        self.levels[level].is_reduced = true;
    }

    fn remove_empty_levels(&mut self, active: &mut ActiveKeyframes) {
        while let Some(empty) = self.empty_level() {
            let removed = self.levels.remove(empty);
            let is_newest = empty == self.levels.len();
            let before = empty.checked_sub(1).map(|before| &mut self.levels[before]);
            match before {
                None if is_newest => active.set_transition(&Dense::zeros(active.dim(), 0)),
                None => {}
                Some(before) if is_newest => {
                    let transition = std::mem::take(&mut before.transition_to_next);
                    active.set_transition(&active.transition_times(&transition));
                }
                Some(before) => {
                    before.transition_to_next = removed.transition_to_next.times(&before.transition_to_next);
                }
            }
        }
    }

    /// A level without members; the newest one has `X`, where that is not active.
    fn empty_level(&self) -> Option<usize> {
        let without_common = self.levels.len() - usize::from(self.common.ncols() > 0);
        self.levels[..without_common].iter().position(|level| level.members.is_empty())
    }

    /// From the time of a level to that of the next one, or to now.
    fn transition_times(&self, level: usize, sensitivity: &Dense, active: &ActiveKeyframes) -> Dense {
        if level + 1 == self.levels.len() {
            active.transition_times(sensitivity)
        } else {
            self.levels[level].transition_to_next.times(sensitivity)
        }
    }

    fn insert(&mut self, level: usize, keyframe: HeldKeyframe, sensitivity: Dense) {
        let Level { serial, members, .. } = &mut self.levels[level];
        members.insert(keyframe.id);
        self.keyframes.insert(keyframe.id, InactiveKeyframe { keyframe, sensitivity, level: *serial });
    }

    fn remove_one(&mut self, id: KeyframeId) -> Option<InactiveKeyframe> {
        let removed = self.keyframes.remove(&id)?;
        let level = self.level_of(&removed)?;
        self.levels[level].members.remove(&id);
        Some(removed)
    }

    /// Removes keyframes; of each level, those that it held and their sensitivities at its time.
    fn remove_by_level(&mut self, ids: &[KeyframeId]) -> Vec<(Vec<HeldKeyframe>, Dense)> {
        let mut removed = vec![(Vec::new(), Dense::default()); self.levels.len()];
        for &id in ids.iter().collect::<BTreeSet<_>>() {
            let Some(inactive) = self.remove_one(id) else { continue };
            let Some(level) = self.level_of(&inactive) else { continue };
            let (keyframes, sensitivity) = &mut removed[level];
            sensitivity.append(&inactive.sensitivity);
            keyframes.push(inactive.keyframe);
        }
        removed
    }

    fn level_of(&self, inactive: &InactiveKeyframe) -> Option<usize> {
        self.levels.binary_search_by_key(&inactive.level, |level| level.serial).ok()
    }

    /// Of each level, oldest first: its members, and the rows of their sensitivities.
    pub fn levels(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.levels.iter().map(|level| {
            let first = level.members.first().and_then(|id| self.keyframes.get(id));
            (level.members.len(), first.map_or(self.common.nrows(), |member| member.sensitivity.nrows()))
        })
    }

    /// Bytes on the heap, without the trees' own bookkeeping.
    pub fn heap_bytes(&self) -> usize {
        let member = size_of::<(KeyframeId, InactiveKeyframe)>() + size_of::<KeyframeId>();
        let sensitivities = self
            .keyframes
            .values()
            .map(|inactive| inactive.sensitivity.heap_bytes() + inactive.keyframe.common.heap_bytes());
        let transitions =
            self.levels.iter().map(|level| size_of::<Level>() + level.transition_to_next.heap_bytes());
        self.common.heap_bytes()
            + self.keyframes.len() * member
            + sensitivities.sum::<usize>()
            + transitions.sum::<usize>()
    }
}
