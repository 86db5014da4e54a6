//! Which tracked points are recorded: few, and those that are seen for long.

use estimator::TrackObservation;
use std::collections::{BTreeMap, BTreeSet};

/// Most points of an image.
const MOST_POINTS: usize = 80;

/// The points that are recorded of image after image.
#[derive(Debug, Default)]
pub(super) struct TrackedPoints {
    chosen: BTreeSet<u64>,
}

impl TrackedPoints {
    /// Begins anew.
    pub(super) fn clear(&mut self) {
        self.chosen.clear();
    }

    /// The points of an image that are recorded: those that were recorded before, then others that are seen later, too.
    ///
    /// # Arguments
    /// * `later`: the points of a later image; without one all are taken to be seen there.
    pub(super) fn choose(
        &mut self,
        tracks: &[TrackObservation],
        later: Option<&[TrackObservation]>,
    ) -> Vec<TrackObservation> {
        let seen_later: Option<BTreeSet<u64>> =
            later.map(|later| later.iter().map(|track| track.feature_id).collect());
        // By the number of cameras: points that are seen in stereo tell the scale.
        let mut cameras: BTreeMap<u64, usize> = BTreeMap::new();
        for track in tracks {
            *cameras.entry(track.feature_id).or_default() += 1;
        }
        self.chosen.retain(|id| cameras.contains_key(id));
        let lasts = |id: &u64| seen_later.as_ref().is_none_or(|seen| seen.contains(id));
        let mut others: Vec<(usize, u64)> = cameras
            .iter()
            .filter(|(id, _)| !self.chosen.contains(id) && lasts(id))
            .map(|(id, count)| (*count, *id))
            .collect();
        others.sort_unstable_by_key(|&(count, id)| (std::cmp::Reverse(count), id));
        let missing = MOST_POINTS.saturating_sub(self.chosen.len());
        self.chosen.extend(others.into_iter().take(missing).map(|(_, id)| id));
        tracks.iter().filter(|track| self.chosen.contains(&track.feature_id)).copied().collect()
    }
}
