//! What changed from one release to the next, for robots that hold keyframes.
//!
//! A server of some cells does not know the others, and robots hold keyframes of several cells: who publishes a release says what
//! changed in all of them.

use crate::cells::CellView;
use map::difference::{Motion, has_moved, is_recorrelated, with_other_common_errors};
use map::file::Segment;
use map::{CommonError, Keyframe, KeyframeCrossCovariance, Landmark};
use nalgebra::Matrix6;
use protocol::{KeyframeId, StatedChange};
use serde::{Deserialize, Serialize};
use std::collections::hash_map::DefaultHasher;
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{Hash as _, Hasher as _};

/// What changed since the version before.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReleasedChange {
    /// The version before.
    pub from_version: u64,
    /// Keyframes whose pose, covariance, camera or landmarks changed.
    pub changed: Vec<KeyframeId>,
    /// Those of them whose pose, covariance or cross-covariances changed.
    pub moved: Vec<KeyframeId>,
    /// Keyframes that are gone.
    pub removed: Vec<KeyframeId>,
    /// Size of the map's motion; `None` where it is not known, so that robots keep nothing of the version before.
    pub stated_change: Option<StatedChange>,
}

impl ReleasedChange {
    /// Where it is not known what changed: robots keep nothing of the version before.
    pub(crate) fn unknown(from_version: u64) -> Self {
        Self { from_version, ..Self::default() }
    }

    /// Of the cells that are not the same in both releases.
    ///
    /// # Arguments
    /// * `unmoved`: number of keyframes in all others.
    pub(crate) fn between(
        from_version: u64,
        before: &ChangedCells<'_>,
        now: &ChangedCells<'_>,
        unmoved: usize,
    ) -> Self {
        let (mut moved, mut changed) = (BTreeSet::new(), BTreeSet::new());
        let mut removed = Vec::new();
        let mut motion = Motion::default();
        motion.add_unmoved(unmoved);
        for (id, former) in &before.keyframes {
            let Some(present) = now.keyframes.get(id) else {
                removed.push(*id);
                continue;
            };
            motion.add(&former.global_from_keyframe.pose, &present.global_from_keyframe.pose);
            if has_moved(former, present) {
                moved.insert(*id);
            }
            if former.camera != present.camera || former.stamp_ns != present.stamp_ns {
                changed.insert(*id);
            }
        }
        let in_both =
            before.keyframes.values().copied().filter(|former| now.keyframes.contains_key(&former.id));
        let common = |id| [before, now].map(|cells| cells.common_errors.get(&id).copied());
        moved.extend(with_other_common_errors(in_both, common));
        // Nobody holds one that is new.
        let is_new = |id: &KeyframeId| now.keyframes.contains_key(id) && !before.keyframes.contains_key(id);
        let is_gone = |id: &KeyframeId| before.keyframes.contains_key(id) && !now.keyframes.contains_key(id);
        let blocks = [before, now].map(ChangedCells::blocks);
        for pair in blocks[0].keys().chain(blocks[1].keys()) {
            let ends = [pair.0, pair.1];
            if ends.iter().any(|end| is_gone(end) || is_new(end)) {
                continue;
            }
            let [former, present] = [0, 1].map(|at| blocks[at].get(pair).copied().unwrap_or_default());
            let differs = match ends.map(|end| now.keyframes.get(&end)) {
                [Some(a), Some(b)] => is_recorrelated(&former, &present, [a, b]),
                // One end is in a cell that is the same in both.
                _ => former != present,
            };
            if differs {
                moved.extend(ends);
            }
        }
        let observed = [before, now].map(ChangedCells::observed);
        for id in observed[0].keys().chain(observed[1].keys()) {
            if !is_new(id) && !is_gone(id) && observed[0].get(id) != observed[1].get(id) {
                changed.insert(*id);
            }
        }
        changed.extend(&moved);
        Self {
            from_version,
            changed: changed.into_iter().collect(),
            moved: moved.into_iter().collect(),
            removed,
            stated_change: motion.size(),
        }
    }

    /// This change, and after it another.
    #[must_use]
    pub(crate) fn then(self, later: &Self) -> Self {
        let joined = |before: &[KeyframeId], now: &[KeyframeId]| {
            before.iter().chain(now).copied().collect::<BTreeSet<_>>().into_iter().collect()
        };
        let both = self.stated_change.zip(later.stated_change);
        Self {
            from_version: self.from_version,
            changed: joined(&self.changed, &later.changed),
            moved: joined(&self.moved, &later.moved),
            removed: joined(&self.removed, &later.removed),
            // The sum of both motions: they need not be independent.
            stated_change: both.map(|(first, second)| StatedChange {
                sigma_theta_rad: first.sigma_theta_rad + second.sigma_theta_rad,
                sigma_p_m: first.sigma_p_m + second.sigma_p_m,
            }),
        }
    }
}

/// What a release has in the cells that are not the same in another one.
#[derive(Default)]
pub(crate) struct ChangedCells<'a> {
    keyframes: BTreeMap<KeyframeId, &'a Keyframe>,
    landmarks: Vec<&'a Landmark>,
    cross_covariances: Vec<&'a KeyframeCrossCovariance>,
    common_errors: BTreeMap<KeyframeId, &'a CommonError>,
}

impl<'a> ChangedCells<'a> {
    pub(crate) fn of(cells: &'a [Segment]) -> Self {
        let mut changed = Self::default();
        for cell in cells {
            changed.keyframes.extend(cell.keyframes.iter().map(|keyframe| (keyframe.id, keyframe)));
            changed.landmarks.extend(&cell.landmarks);
            changed.cross_covariances.extend(&cell.cross_covariances);
            changed.common_errors.extend(cell.common_errors.iter().map(|common| (common.keyframe, common)));
        }
        changed
    }

    pub(crate) fn add(&mut self, cell: &'a CellView<'_>) {
        self.keyframes.extend(cell.keyframes.iter().map(|keyframe| (keyframe.id, keyframe.as_ref())));
        self.landmarks.extend(&cell.landmarks);
        self.cross_covariances.extend(&cell.cross_covariances);
        self.common_errors.extend(cell.common_errors.iter().map(|common| (common.keyframe, *common)));
    }

    /// A digest of what each keyframe observes of these landmarks, whatever their order.
    fn observed(&self) -> BTreeMap<KeyframeId, u64> {
        let mut digests: BTreeMap<KeyframeId, u64> = BTreeMap::new();
        for landmark in &self.landmarks {
            for seen in &landmark.observations {
                let mut hasher = DefaultHasher::new();
                (landmark.id, landmark.anchor).hash(&mut hasher);
                landmark.position_in_anchor.iter().for_each(|value| value.to_bits().hash(&mut hasher));
                seen.pixel.iter().for_each(|value| value.to_bits().hash(&mut hasher));
                let digest = digests.entry(seen.keyframe).or_default();
                *digest = digest.wrapping_add(hasher.finish());
            }
        }
        digests
    }

    fn blocks(&self) -> BTreeMap<(KeyframeId, KeyframeId), Matrix6<f64>> {
        let ordered = self.cross_covariances.iter().map(|cross| cross.ordered());
        ordered.map(|cross| ((cross.a, cross.b), cross.block)).collect()
    }
}
