//! Which keyframes see the same part of a map, by its own landmarks.

use std::collections::{BTreeMap, HashMap};

use map::MapContents;
use protocol::KeyframeId;

use crate::matching::ImageId;

/// Keyframes that see fewer landmarks together are not matched for that.
const LEAST_SHARED: usize = 10;
/// Each keyframe is matched with so many of those that share most landmarks with it.
const PARTNERS: usize = 10;
/// Landmarks with more observers are seen from everywhere: they tell little, and their pairs are many.
const MOST_OBSERVERS: usize = 60;

/// Pairs of views that share landmarks of the primary kind, each with the earlier one first.
///
/// # Arguments
/// * `keyframes`: the keyframe of each view.
pub(super) fn covisible_pairs(contents: &MapContents, keyframes: &[KeyframeId]) -> Vec<(ImageId, ImageId)> {
    let view_of: HashMap<KeyframeId, usize> = keyframes.iter().copied().zip(0..).collect();
    let mut shared: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for landmark in &contents.landmarks {
        let observers: Vec<usize> =
            landmark.observations.iter().filter_map(|seen| view_of.get(&seen.keyframe).copied()).collect();
        if observers.len() > MOST_OBSERVERS {
            continue;
        }
        for (at, &one) in observers.iter().enumerate() {
            for &other in &observers[at + 1..] {
                *shared.entry((one.min(other), one.max(other))).or_default() += 1;
            }
        }
    }
    let mut partners: Vec<Vec<(usize, (usize, usize))>> = vec![Vec::new(); keyframes.len()];
    for (&pair, &count) in shared.iter().filter(|(_, count)| **count >= LEAST_SHARED) {
        partners[pair.0].push((count, pair));
        partners[pair.1].push((count, pair));
    }
    let mut pairs: Vec<(ImageId, ImageId)> = Vec::new();
    for of_view in &mut partners {
        of_view.sort_by_key(|&(count, pair)| (std::cmp::Reverse(count), pair));
        pairs.extend(of_view.iter().take(PARTNERS).map(|&(_, (a, b))| ((a, 0), (b, 0))));
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;
    use testing::{Place, PlaceOptions};

    #[test]
    fn neighbours_are_paired_and_the_ends_of_a_path_are_not() {
        let place = Place::new(&PlaceOptions { keyframes: 30, landmarks: 3000, ..PlaceOptions::default() });
        let keyframes: Vec<KeyframeId> = place.map.keyframes.iter().map(|keyframe| keyframe.id).collect();
        let pairs = covisible_pairs(&place.map, &keyframes);
        let sees = |view: usize| {
            let seen =
                place.map.landmarks.iter().filter(|landmark| {
                    landmark.observations.iter().any(|seen| seen.keyframe == keyframes[view])
                });
            seen.map(|landmark| landmark.id).collect::<std::collections::BTreeSet<_>>()
        };
        assert!(pairs.len() >= 29 && pairs.len() <= 30 * PARTNERS, "{}", pairs.len());
        for &((a, _), (b, _)) in &pairs {
            assert!(a < b && sees(a).intersection(&sees(b)).count() >= LEAST_SHARED, "{a} and {b}");
        }
        assert!((0..29).all(|view| pairs.contains(&((view, 0), (view + 1, 0)))), "{pairs:?}");
        assert!(!pairs.contains(&((0, 0), (29, 0))));
    }
}
