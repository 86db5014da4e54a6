//! Which keyframes are new, gone or moved, with their poses.

use geometry::Pose;
use protocol::KeyframeId;

use super::compared::Compared;
use super::criteria::MIN_MOTION;

/// The keyframes that differ between two versions of a map, ascending by their ids.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KeyframeDifference {
    /// Those of both versions whose pose changed by more than rounding.
    pub moved: Vec<MovedKeyframe>,
    /// Those of the second version only.
    pub added: Vec<PlacedKeyframe>,
    /// Those of the first version only.
    pub removed: Vec<PlacedKeyframe>,
}

/// A keyframe and where it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedKeyframe {
    /// Its id.
    pub id: KeyframeId,
    /// From the camera frame (x right, y down, z forward) to G.
    pub global_from_keyframe: Pose,
}

/// A keyframe with its pose in both versions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MovedKeyframe {
    /// Its id.
    pub id: KeyframeId,
    /// `global_from_keyframe` in the first version.
    pub before: Pose,
    /// `global_from_keyframe` in the second version.
    pub now: Pose,
}

impl MovedKeyframe {
    /// How far it moved (m).
    pub fn distance_m(&self) -> f64 {
        (self.now.translation - self.before.translation).norm()
    }
}

impl KeyframeDifference {
    /// The keyframes that are in one of two versions only, or at another pose.
    ///
    /// # Example
    /// ```
    /// use map::difference::{Compared, KeyframeDifference};
    /// use map::{MapContents, MapMetadata};
    /// use protocol::DescriptorKind;
    ///
    /// let map = MapContents::empty(MapMetadata::new("hall", "example", DescriptorKind::Binary, 32));
    /// assert!(KeyframeDifference::between(&Compared::of(&map), &Compared::of(&map)).is_empty());
    /// ```
    pub fn between(before: &Compared, now: &Compared) -> Self {
        let mut difference = Self::default();
        for (&id, keyframe) in &now.keyframes {
            let pose = keyframe.global_from_keyframe.pose;
            match before.keyframes.get(&id).map(|former| former.global_from_keyframe.pose) {
                None => difference.added.push(PlacedKeyframe { id, global_from_keyframe: pose }),
                Some(before) if before.local(&pose).amax() > MIN_MOTION => {
                    difference.moved.push(MovedKeyframe { id, before, now: pose });
                }
                Some(_) => {}
            }
        }
        let is_gone = |id: &KeyframeId| !now.keyframes.contains_key(id);
        let gone = before.keyframes.iter().filter(|(id, _)| is_gone(id));
        difference.removed = gone
            .map(|(&id, keyframe)| PlacedKeyframe {
                id,
                global_from_keyframe: keyframe.global_from_keyframe.pose,
            })
            .collect();
        difference
    }

    /// Whether no keyframe differs.
    pub fn is_empty(&self) -> bool {
        self.moved.is_empty() && self.added.is_empty() && self.removed.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contents::MapContents;
    use crate::model::{Keyframe, MapMetadata};
    use geometry::{Camera, Distortion, PoseWithCovariance, rotation};
    use nalgebra::{Matrix6, Vector3};
    use protocol::DescriptorKind;

    fn map(ids: std::ops::Range<u64>) -> MapContents {
        let (focal, centre) = ([400.0; 2], [320.0, 240.0]);
        let camera = Camera { width: 640, height: 480, focal, centre, distortion: Distortion::None };
        let keyframe = |id: u64| Keyframe {
            id,
            stamp_ns: 0,
            global_from_keyframe: PoseWithCovariance::new(
                Pose::new(rotation::exp(&Vector3::new(0.1, 0.0, -0.3)), Vector3::new(id as f64, 0.0, 1.0)),
                Matrix6::identity() * 1e-2,
            ),
            camera: camera.clone(),
            features: None,
        };
        let info = MapMetadata::new("hall", "test", DescriptorKind::Binary, 32);
        MapContents { keyframes: ids.map(keyframe).collect(), ..MapContents::empty(info) }
    }

    #[test]
    fn each_keyframe_that_differs_is_named_once_with_its_poses_and_forwards_and_backwards_are_opposite() {
        let before = map(0..6);
        let mut now = map(2..8);
        now.keyframes[0].global_from_keyframe.pose.translation.y += 0.3;
        // Rounding, and another covariance: neither is a motion.
        now.keyframes[1].global_from_keyframe.pose.translation.y += 1e-9;
        now.keyframes[2].global_from_keyframe.covariance *= 2.0;
        let turn = rotation::exp(&Vector3::new(0.0, 0.0, 0.02));
        let turned = &mut now.keyframes[3].global_from_keyframe.pose;
        turned.rotation = turn * turned.rotation;

        let there = KeyframeDifference::between(&Compared::of(&before), &Compared::of(&now));
        let ids = |placed: &[PlacedKeyframe]| placed.iter().map(|one| one.id).collect::<Vec<_>>();
        assert_eq!((ids(&there.added), ids(&there.removed)), (vec![6, 7], vec![0, 1]));
        assert_eq!(there.moved.iter().map(|one| one.id).collect::<Vec<_>>(), [2, 5]);
        assert!((there.moved[0].distance_m() - 0.3).abs() < 1e-12 && there.moved[1].distance_m() == 0.0);
        assert_eq!(there.removed[1].global_from_keyframe, before.keyframes[1].global_from_keyframe.pose);

        let back = KeyframeDifference::between(&Compared::of(&now), &Compared::of(&before));
        assert_eq!((&back.added, &back.removed), (&there.removed, &there.added));
        let reversed =
            |moved: &MovedKeyframe| MovedKeyframe { before: moved.now, now: moved.before, ..*moved };
        assert_eq!(back.moved, there.moved.iter().map(reversed).collect::<Vec<_>>());
    }
}
