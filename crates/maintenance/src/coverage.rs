//! How much of a place is kept: a bounded number of keyframes of each of its appearances, and of landmarks.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

use map::MapContents;
use mapping::BuildReport;
use protocol::{KeyframeId, LandmarkId};

use crate::appearance::Shown;
use crate::places::{Place, places};
use crate::settings::Settings;

/// A keyframe of the session replaces one of the map where it shows more by this factor: otherwise the older one stays.
const REPLACEMENT: f64 = 1.25;
/// The same for the middle of a place: places stay where they are.
const REPLACEMENT_OF_MIDDLE: f64 = 2.0;

/// What is to be taken out.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Surplus {
    /// Keyframes: others show their place and appearance.
    pub(crate) replaced: BTreeSet<KeyframeId>,
    /// Keyframes: their appearance was not seen for long.
    pub(crate) unused: BTreeSet<KeyframeId>,
    /// Landmarks: their place has enough of them.
    pub(crate) landmarks: BTreeSet<LandmarkId>,
}

/// What a map does not need of the places that a session has come to. The others stay as they are.
///
/// # Arguments
/// * `session`: ids of the keyframes that are new.
/// * `outside`: landmarks that stay in any case: keyframes outside of `contents` observe them, where that is a part of a map.
/// * `stamp_ns`: when the session ended.
pub(crate) fn surplus(
    contents: &MapContents,
    session: &RangeInclusive<KeyframeId>,
    outside: &BTreeSet<LandmarkId>,
    stamp_ns: i64,
    settings: &Settings,
) -> Surplus {
    let unused_before_ns =
        stamp_ns.saturating_sub((settings.unused_half_lives * settings.half_life_ns()) as i64);
    let coverage = Coverage { shown: Shown::of(contents, stamp_ns, settings), unused_before_ns };
    let id = |keyframe: &usize| contents.keyframes[*keyframe].id;
    let is_new = |keyframe: usize| session.contains(&id(&keyframe));
    let (visited, others): (Vec<Place>, Vec<Place>) = places(&contents.keyframes, settings)
        .into_iter()
        .partition(|place| place.keyframes.iter().any(|keyframe| is_new(*keyframe)));
    let mut surplus = Surplus::default();
    let mut kept: Vec<BTreeSet<usize>> = Vec::new();
    for Place { middle, keyframes } in visited {
        let lead = |keyframe: usize| match keyframe {
            _ if keyframe == middle => REPLACEMENT_OF_MIDDLE,
            _ if is_new(keyframe) => 1.0,
            _ => REPLACEMENT,
        };
        let appearances = coverage.shown.appearances(&keyframes);
        let (mut used, unused): (Vec<_>, Vec<_>) =
            appearances.into_iter().partition(|appearance| coverage.is_used(appearance));
        if used.is_empty() {
            // Nobody was here: what there was may still be there.
            used = unused;
        } else {
            surplus.unused.extend(unused.iter().flatten().map(id));
        }
        used.sort_by_key(|appearance| std::cmp::Reverse(coverage.last_seen_ns(appearance)));
        let beyond = used.iter().skip(settings.appearances_a_place).flatten();
        surplus.unused.extend(beyond.map(id));
        let mut of_place = BTreeSet::new();
        for appearance in used.iter().take(settings.appearances_a_place) {
            let chosen = coverage.chosen(appearance, settings, lead);
            let let_go = appearance.iter().filter(|keyframe| !chosen.contains(keyframe));
            surplus.replaced.extend(let_go.map(id));
            of_place.extend(chosen);
        }
        kept.push(of_place);
    }
    surplus.landmarks = coverage.surplus_landmarks(&kept, &others, settings.landmarks_a_place);
    surplus.landmarks.retain(|landmark| !outside.contains(landmark));
    surplus
}

/// What keyframes show, of which some was not seen for long.
struct Coverage<'a> {
    shown: Shown<'a>,
    /// Landmarks that were not seen since then are unused (ns).
    unused_before_ns: i64,
}

impl Coverage<'_> {
    fn landmarks_of(&self, keyframe: usize) -> &[usize] {
        &self.shown.index.observed[keyframe]
    }

    /// Whether a keyframe of an appearance shows enough that was seen of late.
    fn is_used(&self, appearance: &[usize]) -> bool {
        appearance.iter().any(|&keyframe| {
            let seen = |landmark: &&usize| self.shown.seen_ns[**landmark] >= self.unused_before_ns;
            self.landmarks_of(keyframe).iter().filter(seen).count() >= BuildReport::FEW_LANDMARKS
        })
    }

    /// When what an appearance shows was seen last (ns).
    fn last_seen_ns(&self, appearance: &[usize]) -> i64 {
        let landmarks = appearance.iter().flat_map(|&keyframe| self.landmarks_of(keyframe));
        landmarks.map(|&landmark| self.shown.seen_ns[landmark]).max().unwrap_or(i64::MIN)
    }

    /// The keyframes of an appearance that are kept, one after the other the one that adds most to those before it, until there are enough
    /// or it adds little of what it shows. Each landmark counts with the probability that it is there, and half of that for each keyframe
    /// that shows it already.
    ///
    /// # Arguments
    /// * `lead`: factor of what a keyframe adds.
    fn chosen(
        &self,
        appearance: &[usize],
        settings: &Settings,
        lead: impl Fn(usize) -> f64,
    ) -> BTreeSet<usize> {
        let mut chosen = BTreeSet::new();
        let mut weights: BTreeMap<usize, f64> = BTreeMap::new();
        let shown = |keyframe: usize, weight: &dyn Fn(&usize) -> f64| -> f64 {
            let landmarks = self.landmarks_of(keyframe).iter();
            landmarks.map(|landmark| self.shown.existence[*landmark] * weight(landmark)).sum()
        };
        while chosen.len() < settings.keyframes_a_place {
            let weight = |landmark: &usize| weights.get(landmark).copied().unwrap_or(1.0);
            let others = appearance.iter().copied().filter(|keyframe| !chosen.contains(keyframe));
            let worth_it = others.filter_map(|keyframe| {
                let added = shown(keyframe, &weight);
                let is_enough = chosen.is_empty() || added >= settings.min_added * shown(keyframe, &|_| 1.0);
                is_enough.then(|| (added * lead(keyframe), keyframe))
            });
            let Some((_, best)) = worth_it.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1))) else {
                break;
            };
            chosen.insert(best);
            for &landmark in self.landmarks_of(best) {
                *weights.entry(landmark).or_insert(1.0) *= 0.5;
            }
        }
        chosen
    }

    /// The landmarks that places have beyond so many, and that no other place of these shows.
    ///
    /// # Arguments
    /// * `visited`: the keyframes of each place that stay.
    /// * `others`: those of places that need not be thinned.
    fn surplus_landmarks(
        &self,
        visited: &[BTreeSet<usize>],
        others: &[Place],
        most: usize,
    ) -> BTreeSet<LandmarkId> {
        let mut needed: BTreeSet<usize> = BTreeSet::new();
        let mut beyond: BTreeSet<usize> = BTreeSet::new();
        for keyframes in visited {
            let all: BTreeSet<usize> =
                keyframes.iter().flat_map(|&keyframe| self.landmarks_of(keyframe)).copied().collect();
            if all.len() <= most {
                needed.extend(all);
            } else {
                let best = self.best_landmarks(keyframes, most);
                beyond.extend(all.difference(&best));
                needed.extend(best);
            }
        }
        if beyond.is_empty() {
            return BTreeSet::new();
        }
        let others = others.iter().flat_map(|place| &place.keyframes);
        needed.extend(others.flat_map(|&keyframe| self.landmarks_of(keyframe)));
        beyond.difference(&needed).map(|&landmark| self.shown.index.contents.landmarks[landmark].id).collect()
    }

    /// So many landmarks of a place: its keyframes name one after the other the one, of those that are left, which most others of them show,
    /// as likely as it is there.
    fn best_landmarks(&self, keyframes: &BTreeSet<usize>, most: usize) -> BTreeSet<usize> {
        let worth = |landmark: usize| {
            let observers = &self.shown.index.observers[landmark];
            let count = observers.iter().filter(|observer| keyframes.contains(observer)).count();
            self.shown.existence[landmark] * count as f64
        };
        let mut ranked: Vec<std::vec::IntoIter<usize>> = Vec::with_capacity(keyframes.len());
        for &keyframe in keyframes {
            let mut landmarks: Vec<(f64, usize)> =
                self.landmarks_of(keyframe).iter().map(|&landmark| (worth(landmark), landmark)).collect();
            landmarks.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            let landmarks: Vec<usize> = landmarks.into_iter().map(|(_, landmark)| landmark).collect();
            ranked.push(landmarks.into_iter());
        }
        let mut best = BTreeSet::new();
        while best.len() < most && !ranked.is_empty() {
            ranked.retain_mut(|landmarks| {
                let next = landmarks.find(|landmark| !best.contains(landmark));
                if let Some(next) = next.filter(|_| best.len() < most) {
                    best.insert(next);
                }
                next.is_some()
            });
        }
        best
    }
}
