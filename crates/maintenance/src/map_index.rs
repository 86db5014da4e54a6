//! A map by the positions of its keyframes and landmarks: who observes what, and what would be seen from where.

use std::collections::BTreeMap;

use geometry::Pose;
use map::{Keyframe, MapContents};
use nalgebra::{Vector2, Vector3};
use protocol::KeyframeId;

/// A keyframe sees a landmark as another one does where the angle between their directions of view is below this (rad) ...
const MAX_ANGLE: f64 = 0.35;
/// ... and this is the ratio of their distances at most.
const MAX_DISTANCE_RATIO: f64 = 1.5;
/// Distance of an expected pixel from the border of the image (px).
const MARGIN_PX: f64 = 20.0;

/// A map, indexed.
pub(crate) struct MapIndex<'a> {
    pub(crate) contents: &'a MapContents,
    /// Of each landmark, in G (m).
    pub(crate) positions: Vec<Vector3<f64>>,
    /// Of each landmark, the keyframes that observe it.
    pub(crate) observers: Vec<Vec<usize>>,
    /// Of each keyframe, the landmarks that it observes, in order.
    pub(crate) observed: Vec<Vec<usize>>,
}

impl<'a> MapIndex<'a> {
    pub(crate) fn of(contents: &'a MapContents) -> MapIndex<'a> {
        let keyframes: BTreeMap<KeyframeId, usize> =
            contents.keyframes.iter().map(|keyframe| keyframe.id).zip(0..).collect();
        let mut index = MapIndex {
            contents,
            positions: contents.landmarks_in_global().map(|(_, position)| position).collect(),
            observers: Vec::with_capacity(contents.landmarks.len()),
            observed: vec![Vec::new(); contents.keyframes.len()],
        };
        for (at, landmark) in contents.landmarks.iter().enumerate() {
            let observers = landmark.observations.iter();
            let observers: Vec<usize> =
                observers.filter_map(|seen| keyframes.get(&seen.keyframe).copied()).collect();
            for &keyframe in &observers {
                index.observed[keyframe].push(at);
            }
            index.observers.push(observers);
        }
        index
    }

    /// Distance of a landmark from a keyframe (m).
    pub(crate) fn distance(&self, keyframe: &Keyframe, landmark: usize) -> f64 {
        (self.positions[landmark] - keyframe.global_from_keyframe.pose.translation).norm()
    }

    /// Whether a landmark is seen from a pose, in G, from a similar direction and distance as from a keyframe.
    pub(crate) fn is_seen_alike(&self, landmark: usize, pose: &Pose, keyframe: usize) -> bool {
        let from = |pose: &Pose| pose.translation - self.positions[landmark];
        let own = from(pose);
        let other = from(&self.contents.keyframes[keyframe].global_from_keyframe.pose);
        let ratio = own.norm() / other.norm();
        own.angle(&other) <= MAX_ANGLE && (MAX_DISTANCE_RATIO.recip()..=MAX_DISTANCE_RATIO).contains(&ratio)
    }

    /// Where a keyframe sees a landmark, with a margin; `None` where it is not in the image.
    pub(crate) fn pixel_of(&self, landmark: usize, keyframe: &Keyframe) -> Option<Vector2<f64>> {
        let camera = &keyframe.camera;
        let pose = &keyframe.global_from_keyframe.pose;
        let pixel = camera.project(&pose.inverse_transform(&self.positions[landmark])).ok()?;
        let [width, height] = [camera.width, camera.height].map(f64::from);
        let is_inside = (MARGIN_PX..=width - MARGIN_PX).contains(&pixel.x)
            && (MARGIN_PX..=height - MARGIN_PX).contains(&pixel.y);
        is_inside.then_some(pixel)
    }
}
