//! The part of a map in which a recording was located, put back into the map.

use std::collections::{BTreeMap, BTreeSet};

use map::contents::MapContents;
use map::edit;
use map::model::{Keyframe, Landmark, LandmarkExistence};
use nalgebra::Vector3;
use protocol::{KeyframeId, LandmarkId};

use super::located::LocatedErrors;

/// Landmarks that moved by less stay where they are (m): rounding.
const UNMOVED_M: f64 = 1e-9;

/// Puts a part of a map back into it, with the new keyframes that were located in it.
///
/// Keyframes of the part that `after` lacks are taken out. The poses and covariances of the others stay. Whether places look alike is not
/// known of the new keyframes: [`find_aliases`](crate::find_aliases) finds it out.
///
/// # Arguments
/// * `map`: sorted.
/// * `before`: the part as [`edit::part_of`] gives it.
/// * `after`: the part with the new keyframes, sorted and valid; its ledger is that of the map with the recording.
/// * `gone`: landmarks of the part that are taken out, whoever observes them. Ids that `before` lacks are those of new landmarks, which another
///   landmark of the map may have: they name none of the map.
/// * `errors`: of all new keyframes, those included that `after` lacks.
pub fn put_back(
    map: &mut MapContents,
    before: &MapContents,
    after: MapContents,
    gone: &BTreeSet<LandmarkId>,
    errors: LocatedErrors,
) {
    let known: BTreeSet<KeyframeId> = before.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let left: BTreeSet<KeyframeId> = after.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let removed: BTreeSet<KeyframeId> = known.difference(&left).copied().collect();
    put_back_landmarks(map, before, &after, &removed, gone);
    map.info = after.info;
    map.keyframes.extend(after.keyframes.into_iter().filter(|keyframe| !known.contains(&keyframe.id)));
    let is_new = |id: &KeyframeId| left.contains(id) && !known.contains(id);
    map.common_errors.extend(errors.common.into_iter().filter(|common| is_new(&common.keyframe)));
    let present: BTreeSet<KeyframeId> = map.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let cross = errors.cross.into_iter();
    map.cross_covariances.extend(cross.filter(|of| present.contains(&of.a) && present.contains(&of.b)));
    edit::remove_keyframes(map, &removed);
    map.drop_existence_of_others();
    map.sort();
    map.count_sessions();
}

/// Landmarks of the part: what the recording observed of them and where they are now; those that are new, with ids beyond those of the map.
///
/// # Arguments
/// * `removed`: keyframes of the part that `after` lacks. Landmarks that only got another anchor with that were not measured again.
fn put_back_landmarks(
    map: &mut MapContents,
    before: &MapContents,
    after: &MapContents,
    removed: &BTreeSet<KeyframeId>,
    gone: &BTreeSet<LandmarkId>,
) {
    let last = |contents: &MapContents| {
        contents.landmarks.iter().map(|landmark| landmark.id).max().unwrap_or_default()
    };
    let (last_of_part, last_of_map) = (last(before), last(map));
    let renamed = |id: LandmarkId| if id > last_of_part { id - last_of_part + last_of_map } else { id };
    let known: BTreeSet<KeyframeId> = before.keyframes.iter().map(|keyframe| keyframe.id).collect();
    let was: BTreeMap<LandmarkId, _> =
        before.landmarks_in_global().map(|(landmark, position)| (landmark.id, position)).collect();
    let mut unmeasured = BTreeMap::new();
    if !removed.is_empty() {
        let mut left = before.clone();
        edit::remove_keyframes(&mut left, removed);
        unmeasured.extend(left.landmarks_in_global().map(|(landmark, position)| (landmark.id, position)));
    }
    let keyframes: BTreeMap<KeyframeId, &Keyframe> =
        map.keyframes.iter().map(|keyframe| (keyframe.id, keyframe)).collect();
    map.landmarks.retain(|landmark| !(gone.contains(&landmark.id) && was.contains_key(&landmark.id)));
    let mut new: Vec<Landmark> = Vec::new();
    for (landmark, position) in after.landmarks_in_global() {
        let Some(was) = was.get(&landmark.id) else {
            new.push(Landmark { id: renamed(landmark.id), ..landmark.clone() });
            continue;
        };
        let Ok(at) = map.landmarks.binary_search_by_key(&landmark.id, |of| of.id) else { continue };
        let of_map = &mut map.landmarks[at];
        let seen = landmark.observations.iter().filter(|seen| !known.contains(&seen.keyframe));
        of_map.observations.extend(seen.cloned());
        let is_there = |other: &Vector3<f64>| (position - other).norm() <= UNMOVED_M;
        if let Some(anchor) = keyframes.get(&of_map.anchor)
            && !is_there(was)
            && !unmeasured.get(&landmark.id).is_some_and(is_there)
        {
            // What an anchor beyond the border sees has no part in where the landmark is now.
            let own = of_map.observations.iter().find(|seen| seen.keyframe == anchor.id);
            let on_ray = own.filter(|_| !known.contains(&anchor.id));
            let on_ray = on_ray.and_then(|seen| anchor.point_on_ray(seen.pixel, &position));
            let by_poses = || anchor.global_from_keyframe.pose.inverse_transform(&position);
            of_map.position_in_anchor = on_ray.unwrap_or_else(by_poses);
        }
    }
    map.landmarks.append(&mut new);
    map.renumber_added();
    let mut existence: BTreeMap<LandmarkId, LandmarkExistence> =
        map.existence.iter().map(|existence| (existence.landmark, *existence)).collect();
    for of in &after.existence {
        let landmark = renamed(of.landmark);
        existence.insert(landmark, LandmarkExistence { landmark, ..*of });
    }
    map.existence = existence.into_values().collect();
}
