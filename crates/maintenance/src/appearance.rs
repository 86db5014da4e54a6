//! Appearances of a place: by day and by night, before and after racks were moved, a camera finds other landmarks there.

use map::{Landmark, LandmarkExistence, MapContents};
use protocol::LandmarkId;

use crate::existence::probability;
use crate::gone::AssumedExistence;
use crate::map_index::MapIndex;
use crate::settings::Settings;

/// Two keyframes of a place are of one appearance where one of them observes this part of what it would see of the other one.
const SHARED: f64 = 0.2;
/// So many landmarks of one keyframe must be in view of another one for the two to be compared.
const MIN_COMPARED: f64 = 15.0;

/// What each keyframe of a map shows, and how much of it is there.
pub(crate) struct Shown<'a> {
    pub(crate) index: MapIndex<'a>,
    /// Of each landmark, the probability that it is there.
    pub(crate) existence: Vec<f64>,
    /// Of each landmark, when it was seen last (ns).
    pub(crate) seen_ns: Vec<i64>,
}

impl<'a> Shown<'a> {
    /// # Arguments
    /// * `stamp_ns`: when landmarks were seen of which no time is known.
    pub(crate) fn of(contents: &'a MapContents, stamp_ns: i64, settings: &Settings) -> Shown<'a> {
        let stated = |landmark: LandmarkId| {
            let at = contents.existence.binary_search_by_key(&landmark, |existence| existence.landmark);
            at.ok().map(|at| contents.existence[at])
        };
        let assumed = AssumedExistence::of(contents, stamp_ns, settings);
        let existence =
            |landmark: &Landmark| stated(landmark.id).unwrap_or_else(|| assumed.of_landmark(landmark));
        let existence: Vec<LandmarkExistence> = contents.landmarks.iter().map(existence).collect();
        Shown {
            index: MapIndex::of(contents),
            existence: existence.iter().map(|existence| probability(existence.log_odds)).collect(),
            seen_ns: existence.iter().map(|existence| existence.seen_ns).collect(),
        }
    }

    /// The keyframes of a place, parted into appearances.
    pub(crate) fn appearances(&self, keyframes: &[usize]) -> Vec<Vec<usize>> {
        let mut appearances: Vec<Vec<usize>> = Vec::new();
        for &keyframe in keyframes {
            let likeness = |appearance: &Vec<usize>| {
                let of_each = appearance.iter().filter_map(|&other| self.likeness(keyframe, other));
                of_each.max_by(f64::total_cmp)
            };
            let of_each: Vec<Option<f64>> = appearances.iter().map(likeness).collect();
            let best = (0..of_each.len()).max_by(|&a, &b| {
                let [a, b] = [a, b].map(|at| of_each[at].unwrap_or(SHARED));
                a.total_cmp(&b)
            });
            match best.filter(|&best| of_each[best].unwrap_or(SHARED) >= SHARED) {
                Some(best) => appearances[best].push(keyframe),
                None => appearances.push(vec![keyframe]),
            }
        }
        appearances
    }

    /// The part that two keyframes share of what both would see, each landmark with the probability that it is there.
    ///
    /// A keyframe with few features observes a small part of what one with many does, so the larger part counts, of what one of them would
    /// see of the other's.
    ///
    /// # Returns
    /// `None` where they have too little in view together.
    fn likeness(&self, a: usize, b: usize) -> Option<f64> {
        let parts = [self.part(a, b), self.part(b, a)];
        parts.into_iter().flatten().max_by(f64::total_cmp)
    }

    /// The part that a keyframe observes of what it would see of another one's landmarks.
    fn part(&self, keyframe: usize, other: usize) -> Option<f64> {
        let of = &self.index.contents.keyframes[keyframe];
        let own = &self.index.observed[keyframe];
        let (mut shared, mut expected) = (0.0, 0.0);
        for landmark in &self.index.observed[other] {
            let existence = self.existence[*landmark];
            if own.binary_search(landmark).is_ok() {
                shared += existence;
                expected += existence;
            } else if self.index.is_seen_alike(*landmark, &of.global_from_keyframe.pose, other)
                && self.index.pixel_of(*landmark, of).is_some()
            {
                expected += existence;
            }
        }
        (expected >= MIN_COMPARED).then(|| shared / expected)
    }
}
