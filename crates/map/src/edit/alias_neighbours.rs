//! Which places look alike, where a keyframe of one of them is taken out.

use std::collections::{BTreeMap, BTreeSet};

use protocol::KeyframeId;

use crate::contents::MapContents;

/// Part of the landmarks of a keyframe that another one must show, too, to be of the same place.
const LEAST_SHARED: f64 = 0.2;

/// Landmarks that two keyframes share, by the first and the second; of a keyframe with itself, all that it shows.
type Shared = BTreeMap<KeyframeId, BTreeMap<KeyframeId, usize>>;

/// Names in aliases, in place of keyframes that are taken out, those that stay and show most of the same landmarks: their place looks
/// like the other one as before.
///
/// One that shows a landmark of the aliased keyframe, too, is of its own place and is none.
pub(super) fn name_neighbours(contents: &mut MapContents, removed: &BTreeSet<KeyframeId>) {
    let stays = |keyframe: &KeyframeId| !removed.contains(keyframe);
    let mut concerned: BTreeSet<KeyframeId> = BTreeSet::new();
    for aliases in contents.aliases.iter().filter(|aliases| stays(&aliases.keyframe)) {
        let gone = aliases.places.iter().map(|place| place.keyframe).filter(|keyframe| !stays(keyframe));
        let before = concerned.len();
        concerned.extend(gone);
        if concerned.len() > before {
            concerned.insert(aliases.keyframe);
        }
    }
    if concerned.is_empty() {
        return;
    }
    let shared = shared_landmarks(contents, &concerned);
    let none = BTreeMap::new();
    for aliases in contents.aliases.iter_mut().filter(|aliases| stays(&aliases.keyframe)) {
        let sees_the_same = of_one_place(shared.get(&aliases.keyframe).unwrap_or(&none), aliases.keyframe);
        for place in aliases.places.iter_mut().filter(|place| !stays(&place.keyframe)) {
            let others = of_one_place(shared.get(&place.keyframe).unwrap_or(&none), place.keyframe);
            let neighbours = others.iter().filter(|(keyframe, _)| {
                stays(keyframe) && **keyframe != aliases.keyframe && !sees_the_same.contains_key(keyframe)
            });
            // Of equal ones the first.
            if let Some((neighbour, _)) =
                neighbours.max_by_key(|(keyframe, count)| (**count, std::cmp::Reverse(**keyframe)))
            {
                place.keyframe = *neighbour;
            }
        }
        // The strongest of each place is first.
        let mut named = BTreeSet::new();
        aliases.places.sort_by(|a, b| b.log_odds.total_cmp(&a.log_odds));
        aliases.places.retain(|place| named.insert(place.keyframe));
    }
}

/// The keyframes that show enough of what a keyframe shows, with the number of landmarks that they share.
///
/// # Arguments
/// * `shared`: of the keyframe with others and itself.
fn of_one_place(shared: &BTreeMap<KeyframeId, usize>, own: KeyframeId) -> BTreeMap<KeyframeId, usize> {
    let least = LEAST_SHARED * shared.get(&own).copied().unwrap_or(0) as f64;
    shared.iter().filter(|(_, count)| **count as f64 >= least).map(|(id, count)| (*id, *count)).collect()
}

/// How many landmarks some keyframes share with others.
fn shared_landmarks(contents: &MapContents, of: &BTreeSet<KeyframeId>) -> Shared {
    let mut shared = Shared::new();
    for landmark in &contents.landmarks {
        for first in landmark.observations.iter().filter(|seen| of.contains(&seen.keyframe)) {
            let others = shared.entry(first.keyframe).or_default();
            for second in &landmark.observations {
                *others.entry(second.keyframe).or_default() += 1;
            }
        }
    }
    shared
}
