//! What changed from one release to another: for robots that hold keyframes, and for people.
//!
//! A server of some cells does not know the others, and robots hold keyframes of several cells: who publishes a release says what
//! changed in all of them.

use crate::cells::BorderedCell;
use crate::error::{ReleaseError, with_causes};
use crate::fetch::cell_contents;
use crate::partition::CellId;
use crate::release::{Release, ReleasedCell};
use crate::store::ReleaseStore;
use geometry::Pose;
use map::difference::{Compared, KeyframeDifference, MapDifference, VersionChange};
use map::file::Segment;
use protocol::{KeyframeId, KeyframeMotion, StatedChange};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

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
    /// How far the moved keyframes moved, where that is known.
    #[serde(default)]
    pub keyframe_motions: Vec<KeyframeMotion>,
}

impl ReleasedChange {
    /// Since the version before.
    pub(crate) fn since(from_version: u64, change: VersionChange) -> Self {
        let VersionChange { changed, moved, removed, stated_change, keyframe_motions, .. } = change;
        Self { from_version, changed, moved, removed, stated_change, keyframe_motions }
    }

    /// This change, and after it another.
    #[must_use]
    pub(crate) fn then(self, later: &Self) -> Self {
        let joined = |before: &[KeyframeId], now: &[KeyframeId]| {
            before.iter().chain(now).copied().collect::<BTreeSet<_>>().into_iter().collect()
        };
        let both = self.stated_change.zip(later.stated_change);
        let keyframe_motions = self.motions_with(later);
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
            keyframe_motions,
        }
    }

    /// The same with the largest motion of a keyframe in place of all motions: robots take all that moved to have moved by so much.
    #[must_use]
    pub(crate) fn without_motions(self) -> Self {
        let stated_change = self.stated_change.map(|stated| with_largest(stated, &self.keyframe_motions));
        Self { keyframe_motions: Vec::new(), stated_change, ..self }
    }

    /// The motions of both changes, one after the other; of a keyframe that one of them removed, or moved by an unknown amount, none.
    fn motions_with(&self, later: &Self) -> Vec<KeyframeMotion> {
        let by_keyframe = |change: &Self| -> BTreeMap<KeyframeId, KeyframeMotion> {
            change.keyframe_motions.iter().map(|motion| (motion.keyframe, *motion)).collect()
        };
        let (first, second) = (by_keyframe(self), by_keyframe(later));
        let unknown: BTreeSet<KeyframeId> = [(self, &first), (later, &second)]
            .into_iter()
            .flat_map(|(change, motions)| {
                let ids = change.moved.iter().chain(&change.removed).copied();
                ids.filter(|id| !motions.contains_key(id))
            })
            .collect();
        let ids: BTreeSet<KeyframeId> = first.keys().chain(second.keys()).copied().collect();
        ids.difference(&unknown)
            .filter_map(|id| match (first.get(id), second.get(id)) {
                (Some(first), Some(second)) => Some(one_after_the_other(first, second)),
                (first, second) => first.or(second).copied(),
            })
            .collect()
    }
}

/// The size of a change that no motion of a keyframe exceeds: the map as a whole moves by far less than a corner of it.
pub fn with_largest(stated: StatedChange, motions: &[KeyframeMotion]) -> StatedChange {
    let norm = |vector: &[f32; 3]| vector.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt();
    StatedChange {
        sigma_theta_rad: motions.iter().map(|of| norm(&of.theta_rad)).fold(stated.sigma_theta_rad, f64::max),
        sigma_p_m: motions.iter().map(|of| norm(&of.translation_m)).fold(stated.sigma_p_m, f64::max),
    }
}

/// A motion of a keyframe, and after it another.
fn one_after_the_other(first: &KeyframeMotion, second: &KeyframeMotion) -> KeyframeMotion {
    let origin = Pose::identity();
    let both = origin.local(&origin.retract(&first.to_vector()).retract(&second.to_vector()));
    KeyframeMotion::from_vector(first.keyframe, &both)
}

/// How one release differs from another: keyframes, landmarks and places.
///
/// Only the cells that are not the same in both are fetched.
///
/// # Errors
/// As [`fetch`](crate::fetch()).
pub async fn difference(
    store: &ReleaseStore,
    before: &Release,
    now: &Release,
) -> Result<MapDifference, ReleaseError> {
    let cells = differing_cells(store, before, now).await?;
    let [before, now] = cells.each_ref().map(|cells| Compared::of_segments(cells));
    Ok(MapDifference::between(&before, &now))
}

/// Which keyframes differ from one release to another, and where they are and were.
///
/// Only the cells that are not the same in both are fetched.
///
/// # Errors
/// As [`fetch`](crate::fetch()).
pub async fn keyframe_difference(
    store: &ReleaseStore,
    before: &Release,
    now: &Release,
) -> Result<KeyframeDifference, ReleaseError> {
    let cells = differing_cells(store, before, now).await?;
    let [before, now] = cells.each_ref().map(|cells| Compared::of_segments(cells));
    Ok(KeyframeDifference::between(&before, &now))
}

/// What changed since a release. Where its segments cannot be read, that is logged, and nothing is known.
///
/// # Arguments
/// * `cells`: those of the next release, in the order of its parts.
pub(crate) async fn change_since(
    store: &ReleaseStore,
    former: &Release,
    cells: &[ReleasedCell],
    parts: &BTreeMap<CellId, BorderedCell<'_>>,
) -> ReleasedChange {
    let version = former.map.version;
    let before = match cells_without(store, former, cells).await {
        Ok(before) => before,
        Err(error) => return unknown_for(version, &error),
    };
    let mut now = Compared::default();
    let mut unmoved = 0;
    for (cell, part) in cells.iter().zip(parts.values()) {
        if is_in(&former.cells, cell) {
            unmoved += cell.keyframes;
        } else {
            part.own.add_to(&mut now);
        }
    }
    ReleasedChange::since(version, VersionChange::between(&Compared::of_segments(&before), &now, unmoved))
}

/// What changes when the map of an earlier release takes the place of the newest one.
pub(crate) async fn change_back(store: &ReleaseStore, newest: &Release, earlier: &Release) -> ReleasedChange {
    let version = newest.map.version;
    let cells = match differing_cells(store, newest, earlier).await {
        Ok(cells) => cells,
        Err(error) => return unknown_for(version, &error),
    };
    let unmoved = newest.cells.iter().filter(|cell| is_in(&earlier.cells, cell)).map(|cell| cell.keyframes);
    let [before, now] = cells.each_ref().map(|cells| Compared::of_segments(cells));
    ReleasedChange::since(version, VersionChange::between(&before, &now, unmoved.sum()))
}

/// Robots keep nothing of the version before.
fn unknown_for(from_version: u64, error: &ReleaseError) -> ReleasedChange {
    let reason = with_causes(error);
    tracing::warn!(reason, "it is not known what changed: robots will begin anew with this release");
    ReleasedChange { from_version, ..ReleasedChange::default() }
}

fn is_in(cells: &[ReleasedCell], cell: &ReleasedCell) -> bool {
    cells.iter().any(|other| other.segment == cell.segment)
}

/// The cells of two releases that are not in the other one.
async fn differing_cells(
    store: &ReleaseStore,
    before: &Release,
    now: &Release,
) -> Result<[Vec<Segment>; 2], ReleaseError> {
    let former = cells_without(store, before, &now.cells).await?;
    Ok([former, cells_without(store, now, &before.cells).await?])
}

/// The cells of a release that are not among some others.
async fn cells_without(
    store: &ReleaseStore,
    release: &Release,
    others: &[ReleasedCell],
) -> Result<Vec<Segment>, ReleaseError> {
    let mut cells = Vec::new();
    for cell in release.cells.iter().filter(|cell| !is_in(others, cell)) {
        cells.push(cell_contents(store, &cell.segment, None).await?);
    }
    Ok(cells)
}
