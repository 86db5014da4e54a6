//! How much of a place is kept: a bounded number of keyframes of each of its appearances.
//!
//! A *place* is a cube of space and a sector of headings. Keyframes of a place that share landmarks are one *appearance* of it: by day and by
//! night a camera finds other landmarks. Of each appearance those keyframes stay that show most of what is there.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

use map::{Keyframe, LandmarkExistence, MapContents};
use mapping::BuildReport;
use nalgebra::Vector3;
use protocol::{KeyframeId, LandmarkId};

use crate::existence::probability;
use crate::gone::AssumedExistence;
use crate::settings::Settings;

/// Two keyframes of a place are of one appearance where they share this part of the landmarks of the one that has fewer.
const SHARED: f64 = 0.2;
/// A keyframe of the session replaces one of the map where it shows more by this factor: otherwise the older one stays.
const REPLACEMENT: f64 = 1.25;
/// Keyframes whose optical axis is steeper have no heading: sine of the elevation.
const STEEP: f64 = 0.9;

/// The keyframes that are to be taken out.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Surplus {
    /// Others show their place and appearance.
    pub(crate) replaced: BTreeSet<KeyframeId>,
    /// Their appearance was not seen for long.
    pub(crate) unused: BTreeSet<KeyframeId>,
}

/// The cube and the sector of headings of a keyframe; `i64::MAX` for those that look up, `i64::MIN` for those that look down.
type Place = [i64; 4];

/// The keyframes that a map does not need.
///
/// # Arguments
/// * `session`: ids of the keyframes that are new.
/// * `stamp_ns`: when the session ended.
pub(crate) fn surplus(
    contents: &MapContents,
    session: &RangeInclusive<KeyframeId>,
    stamp_ns: i64,
    settings: &Settings,
) -> Surplus {
    let shown = Shown::of(contents, stamp_ns, settings);
    let mut places: BTreeMap<Place, Vec<usize>> = BTreeMap::new();
    for (at, keyframe) in contents.keyframes.iter().enumerate() {
        places.entry(place_of(keyframe, settings)).or_default().push(at);
    }
    let id = |keyframe: &usize| contents.keyframes[*keyframe].id;
    let mut surplus = Surplus::default();
    for keyframes in places.values() {
        let appearances = shown.appearances(keyframes);
        let (mut used, unused): (Vec<_>, Vec<_>) =
            appearances.into_iter().partition(|appearance| shown.is_used(appearance));
        if used.is_empty() {
            // Nobody was here: what there was may still be there.
            used = unused;
        } else {
            surplus.unused.extend(unused.iter().flatten().map(id));
        }
        used.sort_by_key(|appearance| std::cmp::Reverse(shown.last_seen_ns(appearance)));
        let beyond = used.iter().skip(settings.appearances_a_place).flatten();
        surplus.unused.extend(beyond.map(id));
        for appearance in used.iter().take(settings.appearances_a_place) {
            let kept = shown
                .chosen(appearance, settings.keyframes_a_place, |keyframe| session.contains(&id(&keyframe)));
            let let_go = appearance.iter().filter(|keyframe| !kept.contains(keyframe));
            surplus.replaced.extend(let_go.map(id));
        }
    }
    surplus
}

fn place_of(keyframe: &Keyframe, settings: &Settings) -> Place {
    let pose = &keyframe.global_from_keyframe.pose;
    let cube = pose.translation.map(|coordinate| (coordinate / settings.place_m).floor() as i64);
    let axis = pose.rotation * Vector3::z();
    let heading = if axis.z.abs() > STEEP {
        if axis.z > 0.0 { i64::MAX } else { i64::MIN }
    } else {
        (axis.y.atan2(axis.x) / settings.place_rad).floor() as i64
    };
    [cube.x, cube.y, cube.z, heading]
}

/// What each keyframe of a map shows.
struct Shown {
    /// Its landmarks, by position in the map.
    landmarks: Vec<BTreeSet<usize>>,
    /// Of each landmark, the probability that it is there.
    existence: Vec<f64>,
    /// Of each landmark, when it was seen last (ns).
    seen_ns: Vec<i64>,
    /// Landmarks that were not seen since then are unused (ns).
    unused_before_ns: i64,
}

impl Shown {
    fn of(contents: &MapContents, stamp_ns: i64, settings: &Settings) -> Shown {
        let keyframes: BTreeMap<KeyframeId, usize> =
            contents.keyframes.iter().map(|keyframe| keyframe.id).zip(0..).collect();
        let stated: BTreeMap<LandmarkId, &LandmarkExistence> =
            contents.existence.iter().map(|existence| (existence.landmark, existence)).collect();
        let assumed = AssumedExistence::of(contents, stamp_ns, settings);
        let unused_before_ns =
            stamp_ns.saturating_sub((settings.unused_half_lives * settings.half_life_ns()) as i64);
        let mut shown = Shown {
            landmarks: vec![BTreeSet::new(); contents.keyframes.len()],
            existence: Vec::with_capacity(contents.landmarks.len()),
            seen_ns: Vec::with_capacity(contents.landmarks.len()),
            unused_before_ns,
        };
        for (at, landmark) in contents.landmarks.iter().enumerate() {
            let existence = stated.get(&landmark.id).map(|existence| **existence);
            let existence = existence.unwrap_or_else(|| assumed.of_landmark(landmark));
            shown.existence.push(probability(existence.log_odds));
            shown.seen_ns.push(existence.seen_ns);
            for observation in &landmark.observations {
                if let Some(keyframe) = keyframes.get(&observation.keyframe) {
                    shown.landmarks[*keyframe].insert(at);
                }
            }
        }
        shown
    }

    /// Parts of some keyframes that share landmarks.
    fn appearances(&self, keyframes: &[usize]) -> Vec<Vec<usize>> {
        let mut appearances: Vec<Vec<usize>> = Vec::new();
        for &keyframe in keyframes {
            let own = &self.landmarks[keyframe];
            let is_alike = |other: &usize| {
                let other = &self.landmarks[*other];
                let shared = own.intersection(other).count() as f64;
                shared >= SHARED * own.len().min(other.len()) as f64
            };
            let (alike, others): (Vec<_>, Vec<_>) =
                appearances.into_iter().partition(|appearance| appearance.iter().any(is_alike));
            appearances = others;
            let mut joined: Vec<usize> = alike.into_iter().flatten().collect();
            joined.push(keyframe);
            appearances.push(joined);
        }
        appearances
    }

    /// Whether a keyframe of an appearance shows enough that was seen of late.
    fn is_used(&self, appearance: &[usize]) -> bool {
        appearance.iter().any(|&keyframe| {
            let seen = |landmark: &&usize| self.seen_ns[**landmark] >= self.unused_before_ns;
            self.landmarks[keyframe].iter().filter(seen).count() >= BuildReport::FEW_LANDMARKS
        })
    }

    /// When what an appearance shows was seen last (ns).
    fn last_seen_ns(&self, appearance: &[usize]) -> i64 {
        let landmarks = appearance.iter().flat_map(|&keyframe| &self.landmarks[keyframe]);
        landmarks.map(|&landmark| self.seen_ns[landmark]).max().unwrap_or(i64::MIN)
    }

    /// So many keyframes of an appearance, one after the other the one that adds most to those before it: each landmark counts with the
    /// probability that it is there, and half of that for each that shows it already.
    fn chosen(&self, appearance: &[usize], most: usize, is_new: impl Fn(usize) -> bool) -> BTreeSet<usize> {
        let mut chosen = BTreeSet::new();
        let mut weights: BTreeMap<usize, f64> = BTreeMap::new();
        while chosen.len() < most {
            let added = |keyframe: usize| -> f64 {
                let landmarks = self.landmarks[keyframe].iter();
                let sum: f64 = landmarks
                    .map(|landmark| self.existence[*landmark] * weights.get(landmark).copied().unwrap_or(1.0))
                    .sum();
                sum * if is_new(keyframe) { 1.0 } else { REPLACEMENT }
            };
            let others = appearance.iter().copied().filter(|keyframe| !chosen.contains(keyframe));
            let Some((_, best)) = others
                .map(|keyframe| (added(keyframe), keyframe))
                .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))
            else {
                break;
            };
            chosen.insert(best);
            for &landmark in &self.landmarks[best] {
                *weights.entry(landmark).or_insert(1.0) *= 0.5;
            }
        }
        chosen
    }
}
