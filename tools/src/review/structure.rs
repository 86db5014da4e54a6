//! What is different between two versions of a map, whatever drives saw of it.

use geometry::uncertain_pose::isotropic_covariance;
use geometry::{Pose, PoseWithCovariance, Viewpoint};
use map::Keyframe;
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
/// A keyframe's motion is compared with those of so many others, most of which must disagree: one that is wrong itself says nothing of them.
const NEIGHBOURS: usize = 3;
/// These are the nearest ones at each of these distances, or beyond (m).
const NEIGHBOURS_M: [f64; 3] = [1.0, 4.0, 16.0];
/// Standard deviation of a relative pose beyond what the map states (rad, m): keyframes that share all of their errors state none.
const RELATIVE_SIGMA_RAD: f64 = 0.002;
const RELATIVE_SIGMA_M: f64 = 0.01;
/// A place has moved where so many of its keyframes, and more than half, moved by more than the covariance explains.
const MOVED_KEYFRAMES: usize = 3;
/// A keyframe shows what others show where the cosine of the angle between their optical axes is at least this (60 deg).
const SAME_DIRECTION: f64 = 0.5;
/// A camera looks up or down where the vertical part of its optical axis is larger.
const STEEP: f64 = 0.7;
/// Directions of view to the sides by which the keyframes of a place are told apart.
const DIRECTIONS: f64 = 4.0;

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
    /// Those that moved by more than the covariance of the live map explains: in the map's frame, or relative to others.
    pub unexplained: Vec<KeyframeId>,
    /// Centres of the cubes of 10 m most of whose keyframes are of these (m).
    pub moved_m: Vec<[f64; 3]>,
    /// Places of the live map: cubes of 10 m with keyframes, by four directions of view.
    pub places: usize,
    /// Centres of those within 5 m, or half of the map's viewing distance, of which the candidate has no keyframe that looks the same way
    /// (m).
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
        Self {
            version: map.info().version,
            keyframes: map.keyframe_count(),
            landmarks: map.landmark_count(),
            aliased: map.aliasing_rate().part_aliased(),
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
            moved_m: Vec::new(),
            places: 0,
            emptied_m: Vec::new(),
            motions: Vec::new(),
            added: Vec::new(),
            removed: Vec::new(),
            unmoved: Vec::new(),
        };
        let mut places = BTreeMap::<[i64; 3], MovedPlace>::new();
        let in_both = live.keyframes().filter(|keyframe| candidate.keyframe(keyframe.id).is_some());
        let common: Vec<(KeyframeId, Vector3<f64>)> =
            in_both.map(|keyframe| (keyframe.id, keyframe.global_from_keyframe.pose.translation)).collect();
        for before in live.keyframes() {
            let (id, former) = (before.id, &before.global_from_keyframe);
            let from = in_plane(&former.pose);
            let Some(now) = candidate.keyframe(id).map(|keyframe| keyframe.global_from_keyframe.pose) else {
                structure.removed.push(from);
                continue;
            };
            structure.common_keyframes += 1;
            let place = places.entry(cube_of(&former.pose.translation)).or_default();
            place.positions_m += former.pose.translation;
            place.keyframes += 1;
            if former.pose == now {
                structure.unmoved.push(from);
                continue;
            }
            structure.motions.push([from, in_plane(&now)]);
            if is_unexplained(former, &now) || is_unexplained_by_neighbours(live, candidate, before, &common)
            {
                structure.unexplained.push(id);
                place.unexplained += 1;
            }
        }
        let moved = places.values().filter(|place| place.has_moved());
        structure.moved_m = moved.map(|place| (place.positions_m / place.keyframes as f64).into()).collect();
        let new = candidate.keyframes().filter(|keyframe| live.keyframe(keyframe.id).is_none());
        structure.added = new.map(|keyframe| in_plane(&keyframe.global_from_keyframe.pose)).collect();
        structure.look_for_emptied(live, candidate);
        structure
    }

    fn look_for_emptied(&mut self, live: &LoadedMap, candidate: &LoadedMap) {
        let mut places: BTreeMap<([i64; 3], i64), Vec<Viewpoint>> = BTreeMap::new();
        for keyframe in live.keyframes() {
            let view = keyframe.viewpoint();
            places.entry((cube_of(&view.position), direction_of(&view.axis))).or_default().push(view);
        }
        self.places = places.len();
        // Where what is seen is far away, keyframes that are far apart show the same.
        let reach = (0.5 * PLACE_SIZE_M).max(0.5 * live.viewing_distance());
        let views: Vec<Viewpoint> = candidate.keyframes().map(Keyframe::viewpoint).collect();
        for ((cube, _), former) in places {
            let mean = |of: &dyn Fn(&Viewpoint) -> Vector3<f64>| {
                former.iter().map(of).sum::<Vector3<f64>>() / former.len() as f64
            };
            let (centre, axis) = (mean(&|view| view.position), mean(&|view| view.axis).normalize());
            let is_left = |view: &Viewpoint| {
                let is_near = (view.position - centre).norm() <= reach || cube_of(&view.position) == cube;
                is_near && view.axis.dot(&axis) >= SAME_DIRECTION
            };
            if !views.iter().any(is_left) {
                self.emptied_m.push(centre.into());
            }
        }
    }
}

/// Number of a direction of view: one of four to the sides, up, or down.
fn direction_of(axis: &Vector3<f64>) -> i64 {
    if axis.z.abs() > STEEP {
        return if axis.z > 0.0 { i64::MAX } else { i64::MIN };
    }
    (axis.y.atan2(axis.x) / std::f64::consts::TAU * DIRECTIONS).floor() as i64
}

/// The keyframes of a cube that both maps have.
#[derive(Default)]
struct MovedPlace {
    /// Sum of their positions (m).
    positions_m: Vector3<f64>,
    keyframes: usize,
    /// Those that moved by more than the covariance explains.
    unexplained: usize,
}

impl MovedPlace {
    fn has_moved(&self) -> bool {
        self.unexplained >= MOVED_KEYFRAMES && 2 * self.unexplained > self.keyframes
    }
}

/// The cube of 10 m of a position in G (m).
fn cube_of(position: &Vector3<f64>) -> [i64; 3] {
    position.map(|along| (along / PLACE_SIZE_M).floor() as i64).into()
}

/// Whether a motion is larger than the covariance of the pose before explains.
fn is_unexplained(former: &PoseWithCovariance, now: &Pose) -> bool {
    let is_small = (now.translation - former.pose.translation).norm() < SMALL_MOTION_M
        && former.pose.rotation.angle_to(&now.rotation) < SMALL_MOTION_RAD;
    !is_small && former.nees(now).is_none_or(|nees| nees > UNEXPLAINED)
}

/// Whether a keyframe moved relative to others, near and far, by more than the covariance of their relative pose explains: a map that is
/// uncertain as a whole knows its parts far better.
///
/// # Arguments
/// * `common`: keyframes of both maps, and where they are in the live one (m).
fn is_unexplained_by_neighbours(
    live: &LoadedMap,
    candidate: &LoadedMap,
    keyframe: &Keyframe,
    common: &[(KeyframeId, Vector3<f64>)],
) -> bool {
    let position = keyframe.global_from_keyframe.pose.translation;
    let own_now = candidate.keyframe(keyframe.id).map(|keyframe| keyframe.global_from_keyframe.pose);
    let disagrees = |other: KeyframeId| {
        let (Some(mut former), Some(own_now)) = (live.relative_pose(other, keyframe.id), own_now) else {
            return false;
        };
        former.covariance += isotropic_covariance(RELATIVE_SIGMA_RAD, RELATIVE_SIGMA_M);
        let other_now = candidate.keyframe(other).map(|keyframe| keyframe.global_from_keyframe.pose);
        other_now.is_some_and(|other| is_unexplained(&former, &other.inverse().compose(&own_now)))
    };
    let mut by_distance: Vec<(f64, KeyframeId)> =
        common.iter().map(|(id, other)| ((other - position).norm(), *id)).collect();
    NEIGHBOURS_M.into_iter().any(|metres| {
        by_distance.retain(|(apart, _)| *apart >= metres);
        let last = NEIGHBOURS.min(by_distance.len());
        if by_distance.len() > last {
            by_distance.select_nth_unstable_by(last, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        }
        2 * by_distance[..last].iter().filter(|(_, id)| disagrees(*id)).count() > NEIGHBOURS
    })
}

fn in_plane(pose: &Pose) -> [f64; 2] {
    [pose.translation.x, pose.translation.y]
}
