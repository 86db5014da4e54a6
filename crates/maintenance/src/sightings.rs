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

use geometry::Pose;
use map::{Keyframe, Landmark, MapContents};
use nalgebra::{Vector2, Vector3};
use protocol::{FeatureSet, KeyframeId};
use vision::{MatchOptions, distance, metric_of};

/// Landmarks that a keyframe of the session shares with the map, at least, to be well located.
const MIN_SEEN: usize = 15;
/// Landmarks that it shares with a partner, at least.
const MIN_SHARED: usize = 8;
/// A partner sees the landmark within this angle (rad) ...
const MAX_ANGLE: f64 = 0.35;
/// ... and this ratio of distances.
const MAX_DISTANCE_RATIO: f64 = 1.5;
/// Distance of an expected pixel from the border of the image (px).
const MARGIN_PX: f64 = 20.0;
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
/// * `features`: all features of its images, by time (ns).
pub(crate) fn sightings(
    contents: &MapContents,
    session: &RangeInclusive<KeyframeId>,
    features: &BTreeMap<i64, &FeatureSet>,
) -> Vec<Sighting> {
    let map = View::of(contents, session);
    let mut found: BTreeMap<usize, Sighting> = BTreeMap::new();
    let own = contents.keyframes.iter().enumerate().filter(|(_, keyframe)| session.contains(&keyframe.id));
    for (at, keyframe) in own {
        let observed: BTreeSet<usize> = map.observed[at].iter().copied().collect();
        for &landmark in observed.iter().filter(|&&landmark| map.is_old(landmark)) {
            let entry = found.entry(landmark).or_insert(Sighting { landmark, exposures: 0, seen: false });
            entry.seen = true;
        }
        let partners = map.partners(&observed);
        let Some(features) = features.get(&keyframe.stamp_ns).filter(|_| !partners.is_empty()) else {
            continue;
        };
        let image = SessionImage { keyframe, features, observed: &map.pixels(at) };
        let candidates: BTreeSet<usize> =
            partners.iter().flat_map(|&partner| map.observed[partner].iter().copied()).collect();
        for landmark in candidates {
            let is_seen = observed.contains(&landmark);
            let Some(pixel) = map.expected(&image, landmark, &partners) else { continue };
            let is_seen = is_seen || image.shows(&pixel, &contents.landmarks[landmark], contents);
            if !is_seen && !image.would_show(&pixel, map.distance(keyframe, landmark)) {
                continue;
            }
            let entry = found.entry(landmark).or_insert(Sighting { landmark, exposures: 0, seen: false });
            entry.exposures += 1;
            entry.seen |= is_seen;
        }
    }
    found.into_values().collect()
}

/// A map with a session, by the positions of keyframes and landmarks in it.
struct View<'a> {
    contents: &'a MapContents,
    session: &'a RangeInclusive<KeyframeId>,
    /// Of each landmark, in G (m).
    positions: Vec<Vector3<f64>>,
    /// Of each landmark, the keyframes that observe it.
    observers: Vec<Vec<usize>>,
    /// Of each keyframe, the landmarks that it observes.
    observed: Vec<Vec<usize>>,
}

impl<'a> View<'a> {
    fn of(contents: &'a MapContents, session: &'a RangeInclusive<KeyframeId>) -> View<'a> {
        let keyframes: BTreeMap<KeyframeId, usize> =
            contents.keyframes.iter().map(|keyframe| keyframe.id).zip(0..).collect();
        let mut view = View {
            contents,
            session,
            positions: contents.landmarks_in_global().map(|(_, position)| position).collect(),
            observers: Vec::with_capacity(contents.landmarks.len()),
            observed: vec![Vec::new(); contents.keyframes.len()],
        };
        for (at, landmark) in contents.landmarks.iter().enumerate() {
            let observers = landmark.observations.iter();
            let observers: Vec<usize> =
                observers.filter_map(|seen| keyframes.get(&seen.keyframe).copied()).collect();
            for &keyframe in &observers {
                view.observed[keyframe].push(at);
            }
            view.observers.push(observers);
        }
        view
    }

    fn is_of_session(&self, keyframe: usize) -> bool {
        self.session.contains(&self.contents.keyframes[keyframe].id)
    }

    /// Whether the map had a landmark before the session.
    fn is_old(&self, landmark: usize) -> bool {
        self.observers[landmark].iter().any(|&keyframe| !self.is_of_session(keyframe))
    }

    /// The keyframes of the map that share enough landmarks with what a keyframe of the session observes; none where that is not well
    /// located.
    fn partners(&self, observed: &BTreeSet<usize>) -> BTreeSet<usize> {
        let old = || observed.iter().filter(|&&landmark| self.is_old(landmark));
        if old().count() < MIN_SEEN {
            return BTreeSet::new();
        }
        let mut shared: BTreeMap<usize, usize> = BTreeMap::new();
        for &keyframe in old().flat_map(|&landmark| &self.observers[landmark]) {
            if !self.is_of_session(keyframe) {
                *shared.entry(keyframe).or_default() += 1;
            }
        }
        shared.into_iter().filter(|(_, count)| *count >= MIN_SHARED).map(|(keyframe, _)| keyframe).collect()
    }

    /// Pixels and distances (m) of what a keyframe observes.
    fn pixels(&self, keyframe: usize) -> Vec<(Vector2<f64>, f64)> {
        let of = &self.contents.keyframes[keyframe];
        let pixel = |&landmark: &usize| {
            let observations = &self.contents.landmarks[landmark].observations;
            let seen = observations.iter().find(|seen| seen.keyframe == of.id)?;
            Some((Vector2::from(seen.pixel.map(f64::from)), self.distance(of, landmark)))
        };
        self.observed[keyframe].iter().filter_map(pixel).collect()
    }

    fn distance(&self, keyframe: &Keyframe, landmark: usize) -> f64 {
        (self.positions[landmark] - keyframe.global_from_keyframe.pose.translation).norm()
    }

    /// Where a keyframe of the session sees a landmark as one of its partners does; `None` where it does not.
    fn expected(
        &self,
        image: &SessionImage<'_>,
        landmark: usize,
        partners: &BTreeSet<usize>,
    ) -> Option<Vector2<f64>> {
        let position = &self.positions[landmark];
        let from = |pose: &Pose| pose.translation - position;
        let own = from(image.pose());
        let is_similar = |&keyframe: &usize| {
            let other = from(&self.contents.keyframes[keyframe].global_from_keyframe.pose);
            let ratio = own.norm() / other.norm();
            own.angle(&other) <= MAX_ANGLE
                && (MAX_DISTANCE_RATIO.recip()..=MAX_DISTANCE_RATIO).contains(&ratio)
        };
        let observers = &self.observers[landmark];
        observers
            .iter()
            .filter(|keyframe| partners.contains(keyframe))
            .find(|keyframe| is_similar(keyframe))?;
        image.pixel_of(position)
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
    fn pose(&self) -> &Pose {
        &self.keyframe.global_from_keyframe.pose
    }

    /// An angle at the centre of the image, in pixels.
    fn pixels(&self, angle: f64) -> f64 {
        angle * self.keyframe.camera.focal[0]
    }

    /// Where it sees a position in G, with a margin; `None` where it is not in the image.
    fn pixel_of(&self, position: &Vector3<f64>) -> Option<Vector2<f64>> {
        let camera = &self.keyframe.camera;
        let pixel = camera.project(&self.pose().inverse_transform(position)).ok()?;
        let [width, height] = [camera.width, camera.height].map(f64::from);
        let is_inside = (MARGIN_PX..=width - MARGIN_PX).contains(&pixel.x)
            && (MARGIN_PX..=height - MARGIN_PX).contains(&pixel.y);
        is_inside.then_some(pixel)
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
