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

/// The points of a camera.
#[derive(Debug, Default)]
struct Share {
    /// How many of them are recorded.
    chosen: usize,
    /// Those that could be, with the number of cameras that see them; the best one last.
    others: Vec<(usize, u64)>,
}

impl TrackedPoints {
    /// Begins anew.
    pub(super) fn clear(&mut self) {
        self.chosen.clear();
    }

    /// The points of an image that are recorded: those that were recorded before, then others that are seen later, too, of the camera
    /// that has fewest; of each camera first those that others see as well, which tell the scale.
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
        let mut cameras_of: BTreeMap<u64, Vec<u8>> = BTreeMap::new();
        for track in tracks {
            cameras_of.entry(track.feature_id).or_default().push(track.camera);
        }
        self.chosen.retain(|id| cameras_of.contains_key(id));
        let lasts = |id: &u64| seen_later.as_ref().is_none_or(|seen| seen.contains(id));
        let mut shares: BTreeMap<u8, Share> = BTreeMap::new();
        for (id, cameras) in &cameras_of {
            for &camera in cameras {
                let share = shares.entry(camera).or_default();
                if self.chosen.contains(id) {
                    share.chosen += 1;
                } else if lasts(id) {
                    share.others.push((cameras.len(), *id));
                }
            }
        }
        for share in shares.values_mut() {
            share.others.sort_unstable_by_key(|&(cameras, id)| (cameras, std::cmp::Reverse(id)));
        }
        while self.chosen.len() < MOST_POINTS {
            let open = shares.values_mut().filter(|share| !share.others.is_empty());
            let Some((_, id)) = open.min_by_key(|share| share.chosen).and_then(|share| share.others.pop())
            else {
                break;
            };
            if self.chosen.insert(id) {
                for camera in &cameras_of[&id] {
                    shares.entry(*camera).or_default().chosen += 1;
                }
            }
        }
        tracks.iter().filter(|track| self.chosen.contains(&track.feature_id)).copied().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track(camera: u8, feature_id: u64) -> TrackObservation {
        TrackObservation { camera, feature_id, pixel: [1.0, 2.0].into() }
    }

    /// How many points of each camera are recorded.
    fn recorded<const N: usize>(tracks: &[TrackObservation]) -> [usize; N] {
        let chosen = TrackedPoints::default().choose(tracks, None);
        std::array::from_fn(|camera| {
            chosen.iter().filter(|track| usize::from(track.camera) == camera).count()
        })
    }

    #[test]
    fn a_stereo_pair_leaves_other_cameras_their_share() {
        let pair = (0..200).flat_map(|id| [track(0, id), track(1, id)]);
        let back = (1000..1100).map(|id| track(2, id));
        assert_eq!(recorded(&pair.clone().chain(back).collect::<Vec<_>>()), [40, 40, 40]);
        let few = (1000..1010).map(|id| track(2, id));
        assert_eq!(recorded(&pair.clone().chain(few).collect::<Vec<_>>()), [70, 70, 10]);
        assert_eq!(recorded(&pair.collect::<Vec<_>>()), [80, 80]);
    }

    #[test]
    fn points_that_both_cameras_see_come_first_and_points_stay() {
        let of_both = (500..560).flat_map(|id| [track(0, id), track(1, id)]);
        let tracks: Vec<TrackObservation> = (0..100).map(|id| track(0, id)).chain(of_both).collect();
        let mut points = TrackedPoints::default();
        let first = points.choose(&tracks, None);
        assert_eq!(first.iter().filter(|track| track.camera == 1).count(), 60);
        let again = points.choose(&tracks, None);
        assert_eq!(first, again);
    }
}
