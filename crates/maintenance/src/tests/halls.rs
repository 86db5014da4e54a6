//! Halls beside each other that were mapped like one, with descriptors of their own.

use map::{KeyframeAliases, MapContents};
use nalgebra::Vector3;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

/// From a hall to the next one (m).
const APART_M: f64 = 300.0;

/// A map of so many halls, the first of which is the given one, sorted; ids of keyframes and of landmarks ascend from hall to hall.
///
/// The errors of different halls are independent.
pub(super) fn halls(hall: &MapContents, count: u64) -> MapContents {
    let keyframe_ids = 1 + hall.keyframes.iter().map(|keyframe| keyframe.id).max().unwrap();
    let landmark_ids = 1 + hall.landmarks.iter().map(|landmark| landmark.id).max().unwrap();
    let mut map = MapContents::empty(hall.info.clone());
    for copy in 0..count {
        let mut rng = StdRng::seed_from_u64(copy);
        let (keyframe_id, landmark_id) = (copy * keyframe_ids, copy * landmark_ids);
        for of_hall in &hall.keyframes {
            let mut keyframe = of_hall.clone();
            keyframe.id += keyframe_id;
            keyframe.stamp_ns += copy as i64;
            keyframe.global_from_keyframe.pose.translation += Vector3::x() * (copy as f64 * APART_M);
            map.aliases.push(KeyframeAliases { keyframe: keyframe.id, places: Vec::new() });
            map.keyframes.push(keyframe);
        }
        for of_hall in &hall.landmarks {
            let mut landmark = of_hall.clone().with_higher_ids(keyframe_id, landmark_id);
            let other: Vec<u8> = (0..32).map(|_| if copy == 0 { 0 } else { rng.random() }).collect();
            for seen in &mut landmark.observations {
                seen.descriptor.iter_mut().zip(&other).for_each(|(byte, other)| *byte ^= other);
            }
            map.landmarks.push(landmark);
        }
        for of_hall in &hall.cross_covariances {
            let mut cross = of_hall.clone();
            cross.a += keyframe_id;
            cross.b += keyframe_id;
            map.cross_covariances.push(cross);
        }
    }
    map.info.sessions.clear();
    map.ensure_sessions("halls");
    map.sort();
    map
}
