//! What robots are told of a new version.

use std::collections::BTreeSet;

use protocol::{KeyframeId, KeyframeMotion, StatedChange};

use super::compared::Compared;
use super::criteria::{has_moved, is_recorrelated, with_other_common_errors};
use super::motion::Motion;

/// What changed from one version of a map to another, keyframe by keyframe; ids ascend.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VersionChange {
    /// Keyframes whose pose, covariance, camera or landmarks changed.
    pub changed: Vec<KeyframeId>,
    /// Those of them whose pose, covariance or cross-covariances changed.
    pub moved: Vec<KeyframeId>,
    /// Keyframes that are new.
    pub added: Vec<KeyframeId>,
    /// Keyframes that are gone.
    pub removed: Vec<KeyframeId>,
    /// Size of the map's motion; `None` where no keyframe is in both versions.
    pub stated_change: Option<StatedChange>,
    /// How far the moved ones moved; some only have another covariance.
    pub keyframe_motions: Vec<KeyframeMotion>,
}

impl VersionChange {
    /// # Arguments
    /// * `unmoved`: number of keyframes in the parts that are the same in both versions and were left out.
    pub fn between(before: &Compared<'_>, now: &Compared<'_>, unmoved: usize) -> Self {
        let (mut moved, mut changed) = (BTreeSet::new(), BTreeSet::new());
        let mut removed = Vec::new();
        let mut motion = Motion::default();
        motion.add_unmoved(unmoved);
        let pose_in = |version: &Compared<'_>, id| {
            version.keyframes.get(id).map(|keyframe| keyframe.global_from_keyframe.pose)
        };
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
        // Nobody holds one that is new.
        let is_new = |id: &KeyframeId| now.keyframes.contains_key(id) && !before.keyframes.contains_key(id);
        let is_gone = |id: &KeyframeId| before.keyframes.contains_key(id) && !now.keyframes.contains_key(id);
        moved.extend(with_other_correlations(before, now, |id| is_new(id) || is_gone(id)));
        for id in before.observed.keys().chain(now.observed.keys()) {
            if !is_new(id) && !is_gone(id) && before.observed.get(id) != now.observed.get(id) {
                changed.insert(*id);
            }
        }
        changed.extend(&moved);
        let keyframe_motions = moved
            .iter()
            .map(|id| match (pose_in(before, id), pose_in(now, id)) {
                (Some(before), Some(now)) => KeyframeMotion::from_vector(*id, &before.local(&now)),
                // In a part that is the same in both.
                _ => KeyframeMotion::unmoved(*id),
            })
            .collect();
        Self {
            changed: changed.into_iter().collect(),
            moved: moved.into_iter().collect(),
            added: now.keyframes.keys().filter(|id| is_new(id)).copied().collect(),
            removed,
            stated_change: motion.size(),
            keyframe_motions,
        }
    }
}

/// The keyframes whose errors are correlated differently with those of others.
///
/// # Arguments
/// * `is_in_one`: whether only one of the versions has a keyframe.
fn with_other_correlations(
    before: &Compared<'_>,
    now: &Compared<'_>,
    is_in_one: impl Fn(&KeyframeId) -> bool,
) -> BTreeSet<KeyframeId> {
    let in_both = before.keyframes.values().copied().filter(|former| now.keyframes.contains_key(&former.id));
    let common = |id| [before, now].map(|version| version.common_errors.get(&id).copied());
    let mut changed: BTreeSet<KeyframeId> = with_other_common_errors(in_both, common).into_iter().collect();
    for pair in before.pairs().chain(now.pairs()) {
        let ends = [pair.0, pair.1];
        if ends.iter().any(&is_in_one) {
            continue;
        }
        let [former, present] = [before, now].map(|version| version.block(pair));
        let differs = match ends.map(|end| now.keyframes.get(&end)) {
            [Some(a), Some(b)] => is_recorrelated(&former, &present, [a, b]),
            // One end is in a part that is the same in both.
            _ => former != present,
        };
        if differs {
            changed.extend(ends);
        }
    }
    changed
}
