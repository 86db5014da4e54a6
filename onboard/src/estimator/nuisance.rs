//! The keyframes that the filter holds: `P_AN` and `P_NN`, exact for as long as a keyframe is held.
//!
//! Dropping a keyframe and pulling it again as if it were new would count its information twice. So
//! a keyframe stays. Those used lately are *active*: their columns of `P_AN` are touched by every
//! step. The others are *parked* in groups. In a step that does not use them all their columns only
//! undergo `P_Aj ← F P_Aj`; a group accumulates the product of these `F` (its *influence*) and its
//! columns are worked out again when one of its keyframes is matched. Groups of similar size are
//! merged, so that there are only logarithmically many. Exact for keyframes that are independent of
//! each other; keyframes with a cross-covariance to another held one are never parked.

use super::covariance::Columns;
use geometry::PoseWithCovariance;
use nalgebra::{DMatrix, Matrix6};
use protocol::KeyframeId;
use std::collections::BTreeMap;

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
    /// `P_Aj` at the time when the group was last brought up to date.
    columns: DMatrix<f64>,
}

#[derive(Clone, Debug)]
struct ParkedGroup {
    /// Product of all that happened to the rows of `P_Aj` since.
    influence: DMatrix<f64>,
    members: Vec<ParkedKeyframe>,
}

impl ParkedGroup {
    fn bring_up_to_date(&mut self) {
        for member in &mut self.members {
            member.columns = &self.influence * &member.columns;
        }
        let n = self.influence.nrows();
        self.influence = DMatrix::identity(n, n);
    }
}

/// All held keyframes and their covariance with the active state and each other.
#[derive(Clone, Debug)]
pub struct HeldKeyframes {
    active: Vec<HeldKeyframe>,
    /// `P_AN` of the active ones, 6 columns each.
    cross: DMatrix<f64>,
    /// `P_NN` off its diagonal, keys in ascending order.
    correlations: BTreeMap<(KeyframeId, KeyframeId), Matrix6<f64>>,
    parked: Vec<ParkedGroup>,
    max_active: usize,
    uses: u64,
}

impl HeldKeyframes {
    /// None held, beside an active error of `rows` numbers.
    pub fn new(rows: usize, max_active: usize) -> Self {
        Self {
            active: Vec::new(),
            cross: DMatrix::zeros(rows, 0),
            correlations: BTreeMap::new(),
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
        }
        self.correlations.retain(|(a, b), _| !ids.contains(a) && !ids.contains(b));
    }

    /// `P_Aj` of an active slot.
    pub fn cross(&self, slot: usize) -> DMatrix<f64> {
        self.cross.columns(6 * slot, 6).into_owned()
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
        if first.id < second.id {
            self.correlations.get(&(first.id, second.id)).copied()
        } else {
            self.correlations.get(&(second.id, first.id)).map(nalgebra::Matrix::transpose)
        }
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
        if let Some((mut keyframe, columns)) = self.take_parked(id) {
            keyframe.last_used = self.uses;
            return self.append(keyframe, &columns);
        }
        for (other, block) in cross {
            if *other == id || !self.ids().any(|held| held == *other) {
                continue;
            }
            self.activate_parked(*other);
            let entry = if id < *other { ((id, *other), *block) } else { ((*other, id), block.transpose()) };
            self.correlations.insert(entry.0, entry.1);
        }
        let columns = self.entering_columns(id);
        let keyframe = HeldKeyframe { id, global_from_keyframe: *global_from_keyframe, last_used: self.uses };
        self.append(keyframe, &columns)
    }

    /// Parks the keyframes that were not used for longest, until few enough are active.
    ///
    /// Slots change; call it when no slot is in use.
    pub fn park_unused(&mut self) {
        if self.active.len() <= self.max_active {
            return;
        }
        let correlated = |id: KeyframeId| self.correlations.keys().any(|(a, b)| *a == id || *b == id);
        let mut candidates: Vec<(u64, KeyframeId)> = self
            .active
            .iter()
            .filter(|keyframe| !correlated(keyframe.id))
            .map(|keyframe| (keyframe.last_used, keyframe.id))
            .collect();
        candidates.sort_unstable();
        // Half of them at once, so that groups are worth their influence matrix.
        let surplus = self.active.len() - self.max_active / 2;
        let members: Vec<ParkedKeyframe> =
            candidates.iter().take(surplus).filter_map(|(_, id)| self.take_active(*id)).collect();
        if members.is_empty() {
            return;
        }
        let rows = self.cross.nrows();
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
        *self = Self::new(self.cross.nrows(), self.max_active);
    }

    /// `P_AN ← F P_AN` for an `F` that touches only the first rows.
    pub fn transform_rows(&mut self, transition: &DMatrix<f64>) {
        let n = transition.nrows();
        let transform = |matrix: &mut DMatrix<f64>| {
            let rows = transition * matrix.rows(0, n);
            matrix.rows_mut(0, n).copy_from(&rows);
        };
        transform(&mut self.cross);
        self.parked.iter_mut().for_each(|group| transform(&mut group.influence));
    }

    /// New row `i` is old row `source[i]`.
    pub fn gather_rows(&mut self, source: &[usize]) {
        self.cross = self.cross.select_rows(source);
        for group in &mut self.parked {
            group.influence = group.influence.select_rows(source);
        }
    }

    /// The active error grew by `count` independent numbers at `at`.
    pub fn insert_zero_rows(&mut self, at: usize, count: usize) {
        let grow = |matrix: &mut DMatrix<f64>| {
            let old = std::mem::replace(matrix, DMatrix::zeros(0, 0));
            *matrix = old.insert_rows(at, count, 0.0);
        };
        grow(&mut self.cross);
        self.parked.iter_mut().for_each(|group| grow(&mut group.influence));
    }

    /// `P_AN -= G P_CN`.
    pub fn measurement_update(&mut self, gain: &DMatrix<f64>, columns: &Columns) {
        let n_active = columns.active.len();
        let of_state = gain.columns(0, n_active);
        let mut other = DMatrix::zeros(columns.len(), self.cross.ncols());
        other.rows_mut(0, n_active).copy_from(&self.cross.select_rows(&columns.active));
        for (k, &slot) in columns.keyframes.iter().enumerate() {
            for column in 0..self.active.len() {
                if let Some(block) = self.block(slot, column) {
                    other.fixed_view_mut::<6, 6>(n_active + 6 * k, 6 * column).copy_from(&block);
                }
            }
        }
        self.cross.gemm(-1.0, gain, &other, 1.0);
        for group in &mut self.parked {
            let touched = group.influence.select_rows(&columns.active);
            group.influence.gemm(-1.0, &of_state, &touched, 1.0);
        }
    }

    fn append(&mut self, keyframe: HeldKeyframe, columns: &DMatrix<f64>) -> usize {
        let slot = self.active.len();
        let old = std::mem::replace(&mut self.cross, DMatrix::zeros(0, 0));
        self.cross = old.insert_columns(6 * slot, 6, 0.0);
        self.cross.columns_mut(6 * slot, 6).copy_from(columns);
        self.active.push(keyframe);
        slot
    }

    fn take_active(&mut self, id: KeyframeId) -> Option<ParkedKeyframe> {
        let slot = self.slot_of(id)?;
        let columns = self.cross(slot);
        let old = std::mem::replace(&mut self.cross, DMatrix::zeros(0, 0));
        self.cross = old.remove_columns(6 * slot, 6);
        Some(ParkedKeyframe { keyframe: self.active.remove(slot), columns })
    }

    fn take_parked(&mut self, id: KeyframeId) -> Option<(HeldKeyframe, DMatrix<f64>)> {
        for place in 0..self.parked.len() {
            let group = &mut self.parked[place];
            if let Some(member) = group.members.iter().position(|member| member.keyframe.id == id) {
                let taken = group.members.swap_remove(member);
                let columns = &group.influence * taken.columns;
                if group.members.is_empty() {
                    self.parked.remove(place);
                }
                return Some((taken.keyframe, columns));
            }
        }
        None
    }

    /// `P_AN P_NN⁻¹ C_Nj`: what the state shares with a new keyframe through those that are held. Zero
    /// where the map says that they are independent.
    ///
    /// The filter that had `j` from the start has both `P_AN = M P_NN` and `P_Aj = M C_Nj`, with one `M`
    /// that propagation and Schmidt's update change alike. Zero instead makes the joint covariance
    /// indefinite where both correlations are strong.
    fn entering_columns(&self, id: KeyframeId) -> DMatrix<f64> {
        let mut with_held = DMatrix::zeros(6 * self.active.len(), 6);
        let mut independent = true;
        for (slot, held) in self.active.iter().enumerate() {
            let block = if held.id < id {
                self.correlations.get(&(held.id, id)).copied()
            } else {
                self.correlations.get(&(id, held.id)).map(nalgebra::Matrix::transpose)
            };
            if let Some(block) = block {
                with_held.fixed_view_mut::<6, 6>(6 * slot, 0).copy_from(&block);
                independent = false;
            }
        }
        let none = DMatrix::zeros(self.cross.nrows(), 6);
        if independent {
            return none;
        }
        let mut of_held = self.covariance_of(&(0..self.active.len()).collect::<Vec<_>>());
        for k in 0..of_held.nrows() {
            of_held[(k, k)] += 1e-12 * of_held[(k, k)] + 1e-18; // a keyframe may be known exactly
        }
        of_held.cholesky().map_or(none, |factor| &self.cross * factor.solve(&with_held))
    }

    fn activate_parked(&mut self, id: KeyframeId) {
        if let Some((keyframe, columns)) = self.take_parked(id) {
            self.append(keyframe, &columns);
        }
    }
}
