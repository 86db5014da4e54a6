//! What is different between two versions of a map, whatever drives saw of it.

use geometry::Pose;
use map::difference::{MapDifference, PLACE_SIZE_M};
use nalgebra::Vector3;
use protocol::KeyframeId;
use recognition::LoadedMap;
use serde::Serialize;
use std::collections::BTreeMap;

/// A motion is not explained by the covariance that the live map states where its squared length in units of it is larger: 1 in
/// 10,000 are, of 6 degrees of freedom.
const UNEXPLAINED: f64 = 27.86;
/// Smaller motions (m, rad) are no reason to refuse: keyframes that define the frame state next to no uncertainty.
const SMALL_MOTION_M: f64 = 0.05;
const SMALL_MOTION_RAD: f64 = 0.01;

/// How two versions of a map differ.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Structure {
    /// The live map.
    pub live: MapFigures,
    /// The candidate.
    pub candidate: MapFigures,
    /// What is new, gone and moved, and where.
    pub difference: MapDifference,
    /// Keyframes of both.
    pub common_keyframes: usize,
    /// Those that moved by more than the covariance of the live map explains.
    pub unexplained: Vec<KeyframeId>,
    /// Places of the live map: cubes of 10 m with keyframes.
    pub places: usize,
    /// Centres of those within 10 m of which the candidate has no keyframe (m).
    pub emptied_m: Vec<[f64; 3]>,
    /// What moved, for the page: from where to where.
    #[serde(skip)]
    pub(super) motions: Vec<[[f64; 2]; 2]>,
    #[serde(skip)]
    pub(super) added: Vec<[f64; 2]>,
    #[serde(skip)]
    pub(super) removed: Vec<[f64; 2]>,
    #[serde(skip)]
    pub(super) unmoved: Vec<[f64; 2]>,
}

/// Size and ambiguity of a map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MapFigures {
    /// Version of the map.
    pub version: u64,
    /// Number of keyframes.
    pub keyframes: usize,
    /// Number of landmarks.
    pub landmarks: usize,
    /// Part of its views that could be taken for another place.
    pub aliased: f64,
}

impl MapFigures {
    fn of(map: &LoadedMap) -> Self {
        let rate = map.aliasing_rate();
        let aliased = if rate.views > 0.0 { rate.aliased / rate.views } else { 0.0 };
        Self {
            version: map.info().version,
            keyframes: map.keyframe_count(),
            landmarks: map.landmark_count(),
            aliased,
        }
    }
}

impl Structure {
    /// Compares two versions.
    pub fn between(live: &LoadedMap, candidate: &LoadedMap) -> Self {
        let mut structure = Self {
            live: MapFigures::of(live),
            candidate: MapFigures::of(candidate),
            difference: MapDifference::between(&live.compared(), &candidate.compared()),
            common_keyframes: 0,
            unexplained: Vec::new(),
            places: 0,
            emptied_m: Vec::new(),
            motions: Vec::new(),
            added: Vec::new(),
            removed: Vec::new(),
            unmoved: Vec::new(),
        };
        for before in live.keyframes() {
            let (id, former) = (before.id, &before.global_from_keyframe);
            let from = in_plane(&former.pose);
            let Some(now) = candidate.keyframe(id).map(|keyframe| keyframe.global_from_keyframe.pose) else {
                structure.removed.push(from);
                continue;
            };
            structure.common_keyframes += 1;
            if former.pose == now {
                structure.unmoved.push(from);
                continue;
            }
            structure.motions.push([from, in_plane(&now)]);
            let is_small = (now.translation - former.pose.translation).norm() < SMALL_MOTION_M
                && former.pose.rotation.angle_to(&now.rotation) < SMALL_MOTION_RAD;
            if !is_small && former.nees(&now).is_none_or(|nees| nees > UNEXPLAINED) {
                structure.unexplained.push(id);
            }
        }
        let new = candidate.keyframes().filter(|keyframe| live.keyframe(keyframe.id).is_none());
        structure.added = new.map(|keyframe| in_plane(&keyframe.global_from_keyframe.pose)).collect();
        structure.look_for_emptied(live, candidate);
        structure
    }

    fn look_for_emptied(&mut self, live: &LoadedMap, candidate: &LoadedMap) {
        let mut places: BTreeMap<[i64; 3], (Vector3<f64>, f64)> = BTreeMap::new();
        for keyframe in live.keyframes() {
            let position = keyframe.global_from_keyframe.pose.translation;
            let cube: [i64; 3] = position.map(|along| (along / PLACE_SIZE_M).floor() as i64).into();
            let (sum, count) = places.entry(cube).or_default();
            (*sum, *count) = (*sum + position, *count + 1.0);
        }
        self.places = places.len();
        for (sum, count) in places.into_values() {
            let centre = sum / count;
            let is_near = |position: Vector3<f64>| (position - centre).norm() <= PLACE_SIZE_M;
            if !candidate.keyframes().any(|keyframe| is_near(keyframe.global_from_keyframe.pose.translation))
            {
                self.emptied_m.push(centre.into());
            }
        }
    }
}

fn in_plane(pose: &Pose) -> [f64; 2] {
    [pose.translation.x, pose.translation.y]
}
