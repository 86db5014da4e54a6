//! What the page draws of one cell of a map that is served by cells.

use crate::cameras::{ViewedCamera, cameras_of};
use crate::viewed_map::{MAX_LANDMARKS, ViewedKeyframe, aliases_of};
use map::{Keyframe, KeyframeAliases, MapContents};
use nalgebra::Vector3;
use protocol::KeyframeId;
use std::collections::BTreeMap;

/// Keyframes that are drawn of a map that is served by cells: 14 MB.
pub const MAX_KEYFRAMES: usize = 50_000;

/// Which part of its keyframes and landmarks each cell of a map keeps, so that all cells together stay within what the page loads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrawnShare {
    keyframes: f64,
    landmarks: f64,
}

impl DrawnShare {
    /// For a map of so many keyframes and landmarks in all its cells.
    pub fn of(keyframes: usize, landmarks: usize) -> Self {
        let share = |most: usize, all: usize| (most as f64 / all.max(1) as f64).min(1.0);
        Self { keyframes: share(MAX_KEYFRAMES, keyframes), landmarks: share(MAX_LANDMARKS, landmarks) }
    }
}

/// What the page draws of a cell. Cells have nothing in common, so that those of a map can be put together.
#[derive(Clone, Debug)]
pub struct ViewedPart {
    /// Of all its keyframes.
    pub(crate) keyframe_count: usize,
    pub(crate) landmark_count: usize,
    /// An even sample.
    pub(crate) keyframes: Vec<ViewedKeyframe>,
    pub(crate) cameras: Vec<ViewedCamera>,
    /// An even sample, in G (m).
    pub(crate) landmarks: Vec<[f32; 3]>,
}

impl ViewedPart {
    /// Of a cell with its border, the cell.
    ///
    /// # Arguments
    /// * `own`: the keyframes of the cell, ascending; its landmarks are those that are anchored in one of them.
    /// * `aliases`: what they could be taken for, in this cell and in others.
    pub fn new(
        contents: &MapContents,
        own: &[KeyframeId],
        aliases: &[KeyframeAliases],
        share: DrawnShare,
    ) -> Self {
        let aliases = aliases_of(aliases);
        let places = |keyframe: &Keyframe| aliases.get(&keyframe.id).copied().unwrap_or_default();
        let is_own = |id: KeyframeId| own.binary_search(&id).is_ok();
        let keyframes: Vec<_> = contents.keyframes.iter().filter(|keyframe| is_own(keyframe.id)).collect();
        let poses: BTreeMap<KeyframeId, _> =
            keyframes.iter().map(|keyframe| (keyframe.id, &keyframe.global_from_keyframe.pose)).collect();
        let landmarks: Vec<_> = contents
            .landmarks
            .iter()
            .filter_map(|landmark| Some((landmark, poses.get(&landmark.anchor)?)))
            .collect();
        let position = |at: usize| {
            let (landmark, global_from_anchor) = landmarks[at];
            let position: Vector3<f64> = global_from_anchor.transform(&landmark.position_in_anchor);
            position.cast::<f32>().into()
        };
        Self {
            keyframe_count: keyframes.len(),
            landmark_count: landmarks.len(),
            cameras: cameras_of(keyframes.iter().map(|keyframe| &keyframe.camera)),
            landmarks: even_sample(landmarks.len(), share.landmarks).map(position).collect(),
            keyframes: even_sample(keyframes.len(), share.keyframes)
                .map(|at| ViewedKeyframe::of(keyframes[at], places(keyframes[at])))
                .collect(),
        }
    }
}

/// A share of so many, at equal steps; of few rather one more than none.
fn even_sample(count: usize, share: f64) -> impl Iterator<Item = usize> {
    let sampled = (count as f64 * share).ceil() as usize;
    (0..sampled).map(move |at| at * count / sampled)
}

#[cfg(test)]
mod tests {
    use super::*;
    use testing::{Place, PlaceOptions};

    #[test]
    fn a_cell_has_what_is_its_own_and_a_share_of_it_is_even() {
        let map = Place::new(&PlaceOptions::default()).map;
        let own: Vec<KeyframeId> = map.keyframes.iter().take(20).map(|keyframe| keyframe.id).collect();
        let whole = ViewedPart::new(&map, &own, &[], DrawnShare::of(30, 1500));
        assert_eq!(whole.keyframes.iter().map(|keyframe| keyframe.id).collect::<Vec<_>>(), own);
        let of_own = map.landmarks.iter().filter(|landmark| own.contains(&landmark.anchor)).count();
        assert!(of_own < map.landmarks.len());
        assert_eq!((whole.landmarks.len(), whole.landmark_count), (of_own, of_own));
        assert_eq!((whole.cameras.len(), whole.cameras[0].keyframes), (1, 20));

        let share = DrawnShare::of(4 * MAX_KEYFRAMES, 10 * MAX_LANDMARKS);
        let large = ViewedPart::new(&map, &own, &[], share);
        assert_eq!((large.keyframe_count, large.landmark_count), (20, of_own));
        assert_eq!(
            large.keyframes.iter().map(|keyframe| keyframe.id).collect::<Vec<_>>(),
            own.iter().copied().step_by(4).collect::<Vec<_>>()
        );
        assert_eq!(large.landmarks.len(), of_own.div_ceil(10));
        assert!(large.landmarks.iter().all(|landmark| whole.landmarks.contains(landmark)));
    }
}
