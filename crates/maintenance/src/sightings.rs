//! Which landmarks of a map a session saw, and which it should have seen.
//!
//! A keyframe of the session expects a landmark where all of this holds:
//!
//! - it is well located in the map: it shares enough landmarks with keyframes of the map, its *partners*, so that it is of their appearance,
//! - one of these partners sees the landmark from a similar direction and distance,
//! - the landmark is in its image, with a margin,
//! - it has features around there: a dark or blurred part of an image says nothing,
//! - nothing that it sees around there is much nearer: the landmark may be hidden.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

use map::{Keyframe, Landmark, MapContents};
use nalgebra::Vector2;
use protocol::{FeatureSet, KeyframeId};
use vision::{MatchOptions, distance, metric_of};

use crate::map_index::MapIndex;

/// Landmarks that a keyframe of the session shares with the map, at least, to be well located.
const MIN_SEEN: usize = 15;
/// Landmarks that it shares with a partner, at least.
const MIN_SHARED: usize = 8;
/// Around an expected pixel: within this angle (rad) ...
const AROUND: f64 = 0.15;
/// ... a keyframe has so many features, at least.
const MIN_FEATURES_AROUND: usize = 4;
/// A landmark may be hidden where most of what is seen within this angle of it (rad) ...
const HIDING: f64 = 0.08;
/// ... is nearer than this part of its distance.
const HIDDEN_BEYOND: f64 = 0.8;
/// A feature shows a landmark where it is within this angle of the expected pixel (rad), and its descriptor is similar.
const SEARCH: f64 = 0.02;

/// What a session shows of a landmark that the map had before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Sighting {
    /// Its position in the map.
    pub(crate) landmark: usize,
    /// How many keyframes of the session expected it.
    pub(crate) exposures: usize,
    /// Whether one of its keyframes saw it.
    pub(crate) seen: bool,
}

/// What a session shows of the landmarks that a map had before.
///
/// # Arguments
/// * `contents`: with the session.
/// * `session`: ids of its keyframes.
/// * `features`: all features of the image of each of these.
pub(crate) fn sightings(
    contents: &MapContents,
    session: &RangeInclusive<KeyframeId>,
    features: &BTreeMap<KeyframeId, &FeatureSet>,
) -> Vec<Sighting> {
    let map = View { index: MapIndex::of(contents), session };
    let mut found: BTreeMap<usize, Sighting> = BTreeMap::new();
    let own = contents.keyframes.iter().enumerate().filter(|(_, keyframe)| session.contains(&keyframe.id));
    for (at, keyframe) in own {
        let observed: BTreeSet<usize> = map.index.observed[at].iter().copied().collect();
        for &landmark in observed.iter().filter(|&&landmark| map.is_old(landmark)) {
            let entry = found.entry(landmark).or_insert(Sighting { landmark, exposures: 0, seen: false });
            entry.seen = true;
        }
        let partners = map.partners(&observed);
        let Some(features) = features.get(&keyframe.id).filter(|_| !partners.is_empty()) else {
            continue;
        };
        let image = SessionImage { keyframe, features, observed: &map.pixels(at) };
        let candidates: BTreeSet<usize> =
            partners.iter().flat_map(|&partner| map.index.observed[partner].iter().copied()).collect();
        for landmark in candidates {
            let is_seen = observed.contains(&landmark);
            let Some(pixel) = map.expected(&image, landmark, &partners) else { continue };
            let is_seen = is_seen || image.shows(&pixel, &contents.landmarks[landmark], contents);
            if !is_seen && !image.would_show(&pixel, map.index.distance(keyframe, landmark)) {
                continue;
            }
            let entry = found.entry(landmark).or_insert(Sighting { landmark, exposures: 0, seen: false });
            entry.exposures += 1;
            entry.seen |= is_seen;
        }
    }
    found.into_values().collect()
}

/// A map with a session.
struct View<'a> {
    index: MapIndex<'a>,
    session: &'a RangeInclusive<KeyframeId>,
}

impl View<'_> {
    fn is_of_session(&self, keyframe: usize) -> bool {
        self.session.contains(&self.index.contents.keyframes[keyframe].id)
    }

    /// Whether the map had a landmark before the session.
    fn is_old(&self, landmark: usize) -> bool {
        self.index.observers[landmark].iter().any(|&keyframe| !self.is_of_session(keyframe))
    }

    /// The keyframes of the map that share enough landmarks with what a keyframe of the session observes; none where that is not well
    /// located.
    fn partners(&self, observed: &BTreeSet<usize>) -> BTreeSet<usize> {
        let old = || observed.iter().filter(|&&landmark| self.is_old(landmark));
        if old().count() < MIN_SEEN {
            return BTreeSet::new();
        }
        let mut shared: BTreeMap<usize, usize> = BTreeMap::new();
        for &keyframe in old().flat_map(|&landmark| &self.index.observers[landmark]) {
            if !self.is_of_session(keyframe) {
                *shared.entry(keyframe).or_default() += 1;
            }
        }
        shared.into_iter().filter(|(_, count)| *count >= MIN_SHARED).map(|(keyframe, _)| keyframe).collect()
    }

    /// Pixels and distances (m) of what a keyframe observes.
    fn pixels(&self, keyframe: usize) -> Vec<(Vector2<f64>, f64)> {
        let contents = self.index.contents;
        let of = &contents.keyframes[keyframe];
        let pixel = |&landmark: &usize| {
            let observations = &contents.landmarks[landmark].observations;
            let seen = observations.iter().find(|seen| seen.keyframe == of.id)?;
            Some((Vector2::from(seen.pixel.map(f64::from)), self.index.distance(of, landmark)))
        };
        self.index.observed[keyframe].iter().filter_map(pixel).collect()
    }

    /// Where a keyframe of the session sees a landmark as one of its partners does; `None` where it does not.
    fn expected(
        &self,
        image: &SessionImage<'_>,
        landmark: usize,
        partners: &BTreeSet<usize>,
    ) -> Option<Vector2<f64>> {
        let pose = &image.keyframe.global_from_keyframe.pose;
        let mut observers = self.index.observers[landmark].iter();
        observers.find(|keyframe| {
            partners.contains(keyframe) && self.index.is_seen_alike(landmark, pose, **keyframe)
        })?;
        self.index.pixel_of(landmark, image.keyframe)
    }
}

/// An image of the session.
struct SessionImage<'a> {
    keyframe: &'a Keyframe,
    features: &'a FeatureSet,
    /// Pixels and distances (m) of the landmarks that it observes.
    observed: &'a [(Vector2<f64>, f64)],
}

impl SessionImage<'_> {
    /// An angle at the centre of the image, in pixels.
    fn pixels(&self, angle: f64) -> f64 {
        angle * self.keyframe.camera.focal[0]
    }

    /// The features within an angle of a pixel.
    fn around(&self, pixel: &Vector2<f64>, angle: f64) -> impl Iterator<Item = usize> {
        let (pixel, radius) = (*pixel, self.pixels(angle));
        let is_near = move |of: &[f32; 2]| (Vector2::from(of.map(f64::from)) - pixel).norm() <= radius;
        self.features.pixels.iter().enumerate().filter(move |(_, of)| is_near(of)).map(|(at, _)| at)
    }

    /// Whether a feature where a landmark is expected looks like it.
    fn shows(&self, pixel: &Vector2<f64>, landmark: &Landmark, contents: &MapContents) -> bool {
        let metric = metric_of(contents.info.descriptor_kind);
        let most = MatchOptions::for_metric(metric).max_distance;
        self.around(pixel, SEARCH).any(|feature| {
            let Some(descriptor) = self.features.descriptors.get(feature) else { return false };
            landmark.observations.iter().any(|seen| distance(metric, descriptor, &seen.descriptor) <= most)
        })
    }

    /// Whether a landmark at a pixel and a distance (m) would have been seen: there are features around, and nothing hides it.
    fn would_show(&self, pixel: &Vector2<f64>, distance: f64) -> bool {
        if self.around(pixel, AROUND).nth(MIN_FEATURES_AROUND - 1).is_none() {
            return false;
        }
        let radius = self.pixels(HIDING);
        let near = self.observed.iter().filter(|(of, _)| (*of - *pixel).norm() <= radius);
        let (nearer, others): (Vec<_>, Vec<_>) =
            near.map(|(_, of)| *of).partition(|of| *of < HIDDEN_BEYOND * distance);
        nearer.len() <= others.len()
    }
}
