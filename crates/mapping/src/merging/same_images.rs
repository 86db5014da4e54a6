//! Images that both maps are made of: used twice, they would make the merged map look more accurate than it is.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use map::contents::MapContents;
use protocol::KeyframeId;

use super::MergeError;

/// Keyframes without a time are of one image where more than this part of the pixels that one observes is the other's, too.
const SAME_PIXELS: f64 = 0.5;

/// Refuses keyframes that were taken at the same time, and, of those whose time is not known (0), keyframes that observe the
/// same pixels: an extractor finds them in one image only.
///
/// # Errors
/// [`MergeError::InBoth`], [`MergeError::SameImage`].
pub(super) fn check_images(first: &MapContents, second: &MapContents) -> Result<(), MergeError> {
    let stamps: BTreeSet<i64> = first.keyframes.iter().map(|keyframe| keyframe.stamp_ns).collect();
    let known = |stamp_ns: i64| stamp_ns != 0 && stamps.contains(&stamp_ns);
    if let Some(keyframe) = second.keyframes.iter().find(|keyframe| known(keyframe.stamp_ns)) {
        return Err(MergeError::InBoth { keyframe: keyframe.id, stamp_ns: keyframe.stamp_ns });
    }
    let mut of_first: HashMap<[u32; 2], Vec<KeyframeId>> = HashMap::new();
    for (keyframe, pixels) in pixels_without_time(first) {
        for pixel in pixels {
            of_first.entry(pixel).or_default().push(keyframe);
        }
    }
    for (keyframe, pixels) in pixels_without_time(second) {
        let mut shared: BTreeMap<KeyframeId, usize> = BTreeMap::new();
        for other in pixels.iter().filter_map(|pixel| of_first.get(pixel)).flatten() {
            *shared.entry(*other).or_default() += 1;
        }
        let most = shared.into_iter().max_by_key(|(_, count)| *count);
        if let Some((other, _)) = most.filter(|(_, count)| *count as f64 > SAME_PIXELS * pixels.len() as f64)
        {
            return Err(MergeError::SameImage { keyframe, other });
        }
    }
    Ok(())
}

/// The pixels that each keyframe without a time observes, as the bits of their coordinates.
fn pixels_without_time(map: &MapContents) -> BTreeMap<KeyframeId, BTreeSet<[u32; 2]>> {
    let without_time = map.keyframes.iter().filter(|keyframe| keyframe.stamp_ns == 0);
    let mut pixels: BTreeMap<KeyframeId, BTreeSet<[u32; 2]>> =
        without_time.map(|keyframe| (keyframe.id, BTreeSet::new())).collect();
    for observation in map.landmarks.iter().flat_map(|landmark| &landmark.observations) {
        if let Some(pixels) = pixels.get_mut(&observation.keyframe) {
            pixels.insert(observation.pixel.map(f32::to_bits));
        }
    }
    pixels.retain(|_, pixels| !pixels.is_empty());
    pixels
}
