//! How many elements are new, gone or moved, by how much, and where.

use std::collections::BTreeMap;

use geometry::median;
use nalgebra::Vector3;
use serde::Serialize;

use super::compared::Compared;
use super::criteria::MIN_MOTION;

/// Side of the cubes of G into which changes are sorted (m): about a room.
pub const PLACE_SIZE_M: f64 = 10.0;

/// What is different between two versions of a map, in numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MapDifference {
    /// Keyframes. Those moved whose pose changed by more than rounding.
    pub keyframes: ElementCounts,
    /// Landmarks. Those moved whose position in G changed by more than rounding.
    pub landmarks: ElementCounts,
    /// Where something changed, the largest motion first, then the most elements.
    pub places: Vec<ChangedPlace>,
}

/// How many elements of one kind changed.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ElementCounts {
    /// Those of the second version only.
    pub added: usize,
    /// Those of the first version only.
    pub removed: usize,
    /// Those of both that moved.
    pub moved: usize,
    /// How far they moved; `None` where none did.
    pub motion: Option<MotionSize>,
}

/// Size of some motions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MotionSize {
    /// Their median (m).
    pub median_m: f64,
    /// The largest one (m).
    pub largest_m: f64,
}

/// A cube of [`PLACE_SIZE_M`] in which something changed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChangedPlace {
    /// Mean position in G of what changed there (m): where it is now, or was before it was removed.
    pub centre_m: [f64; 3],
    /// Keyframes there.
    pub keyframes: ElementCounts,
    /// Landmarks there.
    pub landmarks: ElementCounts,
}

/// One element of two versions: where it was, and where it is.
#[derive(Clone, Copy)]
struct Element {
    before: Option<Vector3<f64>>,
    now: Option<Vector3<f64>>,
    /// Whether its orientation changed.
    turned: bool,
}

/// Elements of one kind, while they are counted.
#[derive(Default)]
struct Counting {
    added: usize,
    removed: usize,
    motions: Vec<f64>,
}

/// A place, while its elements are counted.
#[derive(Default)]
struct PlaceCounting {
    sum: Vector3<f64>,
    count: usize,
    keyframes: Counting,
    landmarks: Counting,
}

impl MapDifference {
    /// From one version to another; parts that are the same in both may be left out of both.
    pub fn between(before: &Compared<'_>, now: &Compared<'_>) -> Self {
        let mut all = PlaceCounting::default();
        let mut places: BTreeMap<[i64; 3], PlaceCounting> = BTreeMap::new();
        let mut add = |element: Element, of: fn(&mut PlaceCounting) -> &mut Counting| {
            let Some(at) = element.changed_at() else { return };
            let place = places.entry(cube_of(&at)).or_default();
            place.sum += at;
            place.count += 1;
            of(place).add(&element);
            of(&mut all).add(&element);
        };
        let ids = before
            .keyframes
            .keys()
            .chain(now.keyframes.keys().filter(|id| !before.keyframes.contains_key(id)));
        for id in ids {
            let poses = [before, now]
                .map(|version| version.keyframes.get(id).map(|keyframe| keyframe.global_from_keyframe.pose));
            let [position_before, position_now] = poses.map(|pose| pose.map(|pose| pose.translation));
            let turned = matches!(poses, [Some(one), Some(other)] if one.rotation.angle_to(&other.rotation) > MIN_MOTION);
            let element = Element { before: position_before, now: position_now, turned };
            add(element, |place| &mut place.keyframes);
        }
        let ids = before
            .landmarks
            .keys()
            .chain(now.landmarks.keys().filter(|id| !before.landmarks.contains_key(id)));
        for id in ids {
            let [position_before, position_now] =
                [before, now].map(|version| version.landmark_in_global(*id));
            let element = Element { before: position_before, now: position_now, turned: false };
            add(element, |place| &mut place.landmarks);
        }
        let mut places: Vec<ChangedPlace> = places.into_values().map(PlaceCounting::finish).collect();
        places.sort_by(|one, other| {
            let rank = |place: &ChangedPlace| {
                (place.largest_m(), (place.keyframes.count() + place.landmarks.count()) as f64)
            };
            let (one, other) = (rank(one), rank(other));
            other.0.total_cmp(&one.0).then(other.1.total_cmp(&one.1))
        });
        Self { keyframes: all.keyframes.finish(), landmarks: all.landmarks.finish(), places }
    }

    /// Whether nothing is new, gone or moved; covariances may differ.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }
}

impl ElementCounts {
    /// All that changed.
    pub fn count(&self) -> usize {
        self.added + self.removed + self.moved
    }
}

impl ChangedPlace {
    /// The largest motion of a keyframe or a landmark (m).
    pub fn largest_m(&self) -> f64 {
        let motions = [&self.keyframes, &self.landmarks].map(|counts| counts.motion);
        motions.iter().flatten().map(|motion| motion.largest_m).fold(0.0, f64::max)
    }
}

impl Element {
    /// How far it moved (m), where both versions have it.
    fn motion(&self) -> Option<f64> {
        self.before.zip(self.now).map(|(before, now)| (now - before).norm())
    }

    /// Where it is, or was; `None` where it did not change.
    fn changed_at(&self) -> Option<Vector3<f64>> {
        let has_moved = self.motion().is_none_or(|motion| motion > MIN_MOTION || self.turned);
        self.now.or(self.before).filter(|_| has_moved)
    }
}

impl Counting {
    fn add(&mut self, element: &Element) {
        match element.motion() {
            Some(motion) => self.motions.push(motion),
            None if element.now.is_some() => self.added += 1,
            None => self.removed += 1,
        }
    }

    fn finish(mut self) -> ElementCounts {
        let motion = median(&mut self.motions).map(|median_m| MotionSize {
            median_m,
            largest_m: self.motions.iter().copied().fold(0.0, f64::max),
        });
        ElementCounts { added: self.added, removed: self.removed, moved: self.motions.len(), motion }
    }
}

impl PlaceCounting {
    fn finish(self) -> ChangedPlace {
        ChangedPlace {
            centre_m: (self.sum / self.count as f64).into(),
            keyframes: self.keyframes.finish(),
            landmarks: self.landmarks.finish(),
        }
    }
}

fn cube_of(position: &Vector3<f64>) -> [i64; 3] {
    position.map(|along| (along / PLACE_SIZE_M).floor() as i64).into()
}
