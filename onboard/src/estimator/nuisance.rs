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
//! a keyframe stays. Those used lately are *active*: their loadings are touched by every step. The others are *parked*
//! in groups, which accumulate the product of what happened to their rows (their *influence*), and are worked out again
//! when a keyframe is matched. Groups of similar size are merged, so that there are only logarithmically many. The
//! covariance `P_Aj` that an update needs is the sum of `M_k P_kj` over the held keyframes that the map correlates with
//! `j`: its cost depends on how many these are, not on how many are held.

use super::dense::Dense;
use super::information::{Columns, Rows};
use super::propagation::{IMU_DIM, ImuMatrix};
use geometry::PoseWithCovariance;
use nalgebra::{DMatrix, DMatrixView, Matrix6};
use protocol::KeyframeId;
use std::collections::{HashMap, HashSet};
use std::ops::Range;

/// A keyframe of the map in the nuisance state.
#[derive(Clone, Debug)]
pub struct HeldKeyframe {
    /// Its name in the map.
    pub id: KeyframeId,
    /// Pose and covariance as the map states them. Never changed by the filter.
    pub global_from_keyframe: PoseWithCovariance,
    last_used: u64,
}

#[derive(Clone, Debug)]
struct ParkedKeyframe {
    keyframe: HeldKeyframe,
    /// `M_j` at the time when the group was last brought up to date.
    loadings: DMatrix<f64>,
}

#[derive(Clone, Debug)]
struct ParkedGroup {
    /// Product of all that happened to the rows of `M_j` since.
    influence: DMatrix<f64>,
    members: Vec<ParkedKeyframe>,
}

impl ParkedGroup {
    fn bring_up_to_date(&mut self) {
        for member in &mut self.members {
            member.loadings = &self.influence * &member.loadings;
        }
        let n = self.influence.nrows();
        self.influence = DMatrix::identity(n, n);
    }
}

/// All held keyframes and their covariance with the active state and each other.
#[derive(Clone, Debug)]
pub struct HeldKeyframes {
    active: Vec<HeldKeyframe>,
    /// `M` of the active ones, 6 columns each.
    loadings: DMatrix<f64>,
    /// `P_NN` off its diagonal, by row and then column.
    correlations: HashMap<KeyframeId, HashMap<KeyframeId, Matrix6<f64>>>,
    parked: Vec<ParkedGroup>,
    max_active: usize,
    uses: u64,
}

impl HeldKeyframes {
    /// None held, beside an active error of `rows` numbers.
    pub fn new(rows: usize, max_active: usize) -> Self {
        Self {
            active: Vec::new(),
            loadings: DMatrix::zeros(rows, 0),
            correlations: HashMap::new(),
            parked: Vec::new(),
            max_active,
            uses: 0,
        }
    }

    /// Whether none is held.
    pub fn is_empty(&self) -> bool {
        self.active.is_empty() && self.parked.is_empty()
    }

    /// How many are held, active and parked.
    pub fn len(&self) -> usize {
        self.active.len() + self.parked_len()
    }

    /// How many of them are parked.
    pub fn parked_len(&self) -> usize {
        self.parked.iter().map(|group| group.members.len()).sum()
    }

    /// All names.
    pub fn ids(&self) -> impl Iterator<Item = KeyframeId> + '_ {
        let parked =
            self.parked.iter().flat_map(|group| group.members.iter().map(|member| member.keyframe.id));
        self.active.iter().map(|keyframe| keyframe.id).chain(parked)
    }

    /// The slot of an active keyframe.
    pub fn slot_of(&self, id: KeyframeId) -> Option<usize> {
        self.active.iter().position(|keyframe| keyframe.id == id)
    }

    /// A held keyframe by its slot.
    pub fn get(&self, slot: usize) -> &HeldKeyframe {
        &self.active[slot]
    }

    /// Covariance of a held keyframe, active or parked.
    pub fn covariance_by_id(&self, id: KeyframeId) -> Option<Matrix6<f64>> {
        let parked = self.parked.iter().flat_map(|group| group.members.iter().map(|member| &member.keyframe));
        let mut all = self.active.iter().chain(parked);
        all.find(|keyframe| keyframe.id == id).map(|keyframe| keyframe.global_from_keyframe.covariance)
    }

    /// Gives up keyframes that were just pulled and never used: nothing is lost.
    pub fn forget(&mut self, ids: &[KeyframeId]) {
        for id in ids {
            self.take_active(*id);
            for other in self.correlations.remove(id).unwrap_or_default().into_keys() {
                if let Some(row) = self.correlations.get_mut(&other) {
                    row.remove(id);
                }
            }
        }
    }

    /// `P_Aj` of an active slot.
    pub fn cross(&self, slot: usize) -> DMatrix<f64> {
        let id = self.active[slot].id;
        let mut cross = DMatrix::zeros(self.loadings.nrows(), 6);
        for other in 0..self.active.len() {
            if let Some(block) = self.block(slot, other) {
                cross.gemm(1.0, &self.loadings.columns(6 * other, 6), &block.transpose(), 1.0);
            }
        }
        let Some(row) = self.correlations.get(&id) else { return cross };
        for group in &self.parked {
            let correlated = |member: &ParkedKeyframe| row.get(&member.keyframe.id).is_some();
            if !group.members.iter().any(correlated) {
                continue;
            }
            let mut sum = DMatrix::zeros(group.influence.ncols(), 6);
            for member in &group.members {
                if let Some(block) = row.get(&member.keyframe.id) {
                    sum.gemm(1.0, &member.loadings, &block.transpose(), 1.0);
                }
            }
            cross.gemm(1.0, &group.influence, &sum, 1.0);
        }
        cross
    }

    /// Whether the map says of any held keyframe that its error depends on another's.
    pub fn has_correlations(&self) -> bool {
        !self.correlations.is_empty()
    }

    /// `P_NN` of some active slots.
    pub fn covariance_of(&self, slots: &[usize]) -> DMatrix<f64> {
        let mut covariance = DMatrix::zeros(6 * slots.len(), 6 * slots.len());
        for (i, &a) in slots.iter().enumerate() {
            for (j, &b) in slots.iter().enumerate() {
                if let Some(block) = self.block(a, b) {
                    covariance.fixed_view_mut::<6, 6>(6 * i, 6 * j).copy_from(&block);
                }
            }
        }
        covariance
    }

    fn block(&self, a: usize, b: usize) -> Option<Matrix6<f64>> {
        let (first, second) = (&self.active[a], &self.active[b]);
        if a == b {
            return Some(first.global_from_keyframe.covariance);
        }
        self.correlations.get(&first.id)?.get(&second.id).copied()
    }

    /// Makes a keyframe active and returns its slot.
    ///
    /// One that is held keeps its pose and its correlation with the state; a new one enters with the
    /// map's covariance and with `cross` (its covariance with other held keyframes, rows are its own error).
    pub fn pull(
        &mut self,
        id: KeyframeId,
        global_from_keyframe: &PoseWithCovariance,
        cross: &[(KeyframeId, Matrix6<f64>)],
    ) -> usize {
        self.uses += 1;
        if let Some(slot) = self.slot_of(id) {
            self.active[slot].last_used = self.uses;
            return slot;
        }
        if let Some((mut keyframe, loadings)) = self.take_parked(id) {
            keyframe.last_used = self.uses;
            return self.append(keyframe, &loadings);
        }
        let held: HashSet<KeyframeId> = self.ids().collect();
        for (other, block) in cross.iter().filter(|(other, _)| *other != id && held.contains(other)) {
            self.correlations.entry(id).or_default().insert(*other, *block);
            self.correlations.entry(*other).or_default().insert(id, block.transpose());
        }
        let keyframe = HeldKeyframe { id, global_from_keyframe: *global_from_keyframe, last_used: self.uses };
        self.append(keyframe, &DMatrix::zeros(self.loadings.nrows(), 6))
    }

    /// Parks the keyframes that were not used for longest, until few enough are active.
    ///
    /// Slots change; call it when no slot is in use.
    pub fn park_unused(&mut self) {
        if self.active.len() <= self.max_active {
            return;
        }
        let mut candidates: Vec<(u64, KeyframeId)> =
            self.active.iter().map(|keyframe| (keyframe.last_used, keyframe.id)).collect();
        candidates.sort_unstable();
        // Half of them at once, so that groups are worth their influence matrix.
        let surplus = self.active.len() - self.max_active / 2;
        let members: Vec<ParkedKeyframe> =
            candidates.iter().take(surplus).filter_map(|(_, id)| self.take_active(*id)).collect();
        if members.is_empty() {
            return;
        }
        let rows = self.loadings.nrows();
        self.parked.push(ParkedGroup { influence: DMatrix::identity(rows, rows), members });
        while let [.., older, newer] = self.parked.as_slice()
            && older.members.len() <= 2 * newer.members.len()
        {
            self.merge_newest();
        }
    }

    fn merge_newest(&mut self) {
        let (Some(mut newer), Some(mut older)) = (self.parked.pop(), self.parked.pop()) else { return };
        newer.bring_up_to_date();
        older.bring_up_to_date();
        older.members.append(&mut newer.members);
        self.parked.push(older);
    }

    /// Forgets all of them.
    pub fn clear(&mut self) {
        *self = Self::new(self.loadings.nrows(), self.max_active);
    }

    /// `M ← F M` for an `F` that touches only the IMU's rows, which are the first.
    pub fn transform_rows(&mut self, transition: &ImuMatrix) {
        self.for_each_row_matrix(|matrix| {
            let rows = transition * matrix.fixed_rows::<IMU_DIM>(0);
            matrix.fixed_rows_mut::<IMU_DIM>(0).copy_from(&rows);
        });
    }

    /// The rows become the old rows `source`, one range after the other.
    pub fn gather_rows(&mut self, source: &[Range<usize>]) {
        self.for_each_row_matrix(|matrix| {
            let indices: Vec<usize> = source.iter().flat_map(Clone::clone).collect();
            *matrix = matrix.select_rows(&indices);
        });
    }

    /// The error at `begin` grew by `jacobian` times the error at `of`.
    pub fn add_dependence(&mut self, begin: usize, jacobian: &[f64], of: usize) {
        self.for_each_row_matrix(|matrix| {
            for (k, factor) in jacobian.iter().enumerate() {
                let grown = matrix.row(begin + k) + matrix.row(of) * *factor;
                matrix.row_mut(begin + k).copy_from(&grown);
            }
        });
    }

    /// The active error grew at `at` by `jacobian` times its part `columns`, and something independent.
    pub fn insert_rows(&mut self, at: usize, columns: &Columns, jacobian: DMatrixView<'_, f64>) {
        let count = jacobian.nrows();
        self.for_each_row_matrix(|matrix| {
            let mut new = DMatrix::zeros(count, matrix.ncols());
            for (range, here) in columns.runs() {
                let part = jacobian.columns(here.start, here.len());
                new.gemm(1.0, &part, &matrix.rows(range.start, range.len()), 1.0);
            }
            let old = std::mem::replace(matrix, DMatrix::zeros(0, 0));
            *matrix = old.insert_rows(at, count, 0.0);
            matrix.rows_mut(at, count).copy_from(&new);
        });
    }

    /// `P_AN -= Wᵀ L⁻¹ H P_CN`, which is `M -= Wᵀ L⁻¹ H (M_C; E_T)`.
    ///
    /// # Arguments
    /// * `whitened`: `W`.
    /// * `innovation`: `L` in its lower triangle.
    pub fn measurement_update(&mut self, rows: &Rows, whitened: &Dense, innovation: &Dense) {
        let jacobian = rows.jacobian.view();
        let gain = whitened.view().transpose();
        let slots = &rows.columns.keyframes;
        let own = rows.columns.active_len();
        let mut first = true;
        self.for_each_row_matrix(|matrix| {
            let mut touched = DMatrix::zeros(jacobian.nrows(), matrix.ncols());
            for (range, here) in rows.columns.runs() {
                let part = jacobian.columns(here.start, here.len());
                touched.gemm(1.0, &part, &matrix.rows(range.start, range.len()), 1.0);
            }
            // The loadings of the active keyframes come first.
            for (k, &slot) in slots.iter().enumerate().filter(|_| first) {
                let mut columns = touched.columns_mut(6 * slot, 6);
                columns += jacobian.columns(own + 6 * k, 6);
            }
            first = false;
            let mut solved = Dense::from(touched);
            solved.solve_lower(innovation);
            matrix.gemm(-1.0, &gain, &solved.view(), 1.0);
        });
    }

    /// Every matrix whose rows are those of the active error: the loadings, then each group's influence.
    fn for_each_row_matrix(&mut self, mut change: impl FnMut(&mut DMatrix<f64>)) {
        change(&mut self.loadings);
        self.parked.iter_mut().for_each(|group| change(&mut group.influence));
    }

    fn append(&mut self, keyframe: HeldKeyframe, loadings: &DMatrix<f64>) -> usize {
        let slot = self.active.len();
        let old = std::mem::replace(&mut self.loadings, DMatrix::zeros(0, 0));
        self.loadings = old.insert_columns(6 * slot, 6, 0.0);
        self.loadings.columns_mut(6 * slot, 6).copy_from(loadings);
        self.active.push(keyframe);
        slot
    }

    fn take_active(&mut self, id: KeyframeId) -> Option<ParkedKeyframe> {
        let slot = self.slot_of(id)?;
        let loadings = self.loadings.columns(6 * slot, 6).into_owned();
        let old = std::mem::replace(&mut self.loadings, DMatrix::zeros(0, 0));
        self.loadings = old.remove_columns(6 * slot, 6);
        Some(ParkedKeyframe { keyframe: self.active.remove(slot), loadings })
    }

    fn take_parked(&mut self, id: KeyframeId) -> Option<(HeldKeyframe, DMatrix<f64>)> {
        for place in 0..self.parked.len() {
            let group = &mut self.parked[place];
            if let Some(member) = group.members.iter().position(|member| member.keyframe.id == id) {
                let taken = group.members.swap_remove(member);
                let loadings = &group.influence * taken.loadings;
                if group.members.is_empty() {
                    self.parked.remove(place);
                }
                return Some((taken.keyframe, loadings));
            }
        }
        None
    }
}
