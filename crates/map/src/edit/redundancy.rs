//! Keyframes that add nothing to what others show.

use std::collections::{BTreeMap, BTreeSet};

use protocol::KeyframeId;

use crate::contents::MapContents;

/// A landmark is well observed without a keyframe where so many others observe it.
///
/// Source: the culling of keyframes in Mur-Artal, Montiel & Tardos, "ORB-SLAM", T-RO 2015, section VI.E.
pub const MIN_OTHERS: usize = 3;

/// The keyframes that can be taken out together, because the landmarks of each are well observed by those that stay.
///
/// The most redundant are taken first; the first and the last keyframe in time stay. Keyframes without landmarks are
/// redundant.
///
/// # Arguments
/// * `share`: the part of a keyframe's landmarks, from 0 to 1, that [`MIN_OTHERS`] others must observe.
pub fn redundant_keyframes(contents: &MapContents, share: f64) -> BTreeSet<KeyframeId> {
    let mut seen: BTreeMap<KeyframeId, Vec<usize>> =
        contents.keyframes.iter().map(|keyframe| (keyframe.id, Vec::new())).collect();
    let mut observers: Vec<usize> = Vec::with_capacity(contents.landmarks.len());
    for (index, landmark) in contents.landmarks.iter().enumerate() {
        observers.push(landmark.observations.len());
        for observation in &landmark.observations {
            seen.entry(observation.keyframe).or_default().push(index);
        }
    }
    let redundancy = |landmarks: &[usize], observers: &[usize]| {
        let well = landmarks.iter().filter(|&&landmark| observers[landmark] > MIN_OTHERS).count();
        if landmarks.is_empty() { 1.0 } else { well as f64 / landmarks.len() as f64 }
    };
    let by_time = || contents.keyframes.iter().map(|keyframe| (keyframe.stamp_ns, keyframe.id));
    let ends = [by_time().min(), by_time().max()].map(|end| end.map(|(_, id)| id));
    let mut order: Vec<(f64, KeyframeId)> = seen
        .iter()
        .filter(|(id, _)| !ends.contains(&Some(**id)))
        .map(|(id, landmarks)| (redundancy(landmarks, &observers), *id))
        .collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut redundant = BTreeSet::new();
    for (_, id) in order {
        let landmarks = &seen[&id];
        if redundancy(landmarks, &observers) >= share {
            for &landmark in landmarks {
                observers[landmark] -= 1;
            }
            redundant.insert(id);
        }
    }
    redundant
}
