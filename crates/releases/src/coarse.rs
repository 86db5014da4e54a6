//! What tells from afar which cells an image could be of: some landmarks of each keyframe, by one descriptor each.
//!
//! Every server has these of all cells, and asks only the cells that they name.

use crate::cells::BorderedCell;
use map::file::SegmentError;
use map::file::record::{seal, unseal};
use map::{Keyframe, Landmark, RecordError};
use protocol::KeyframeId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

const MAGIC: &[u8] = b"driftless coarse 1\n";
const TABLE: &str = "coarse";

/// So many landmarks of each keyframe are taken, where it has them; neighbours share most of them, so that there are some three
/// a keyframe in all. With 16, one query in 80 at the end of a path was sent to the wrong cells.
const LANDMARKS_A_KEYFRAME: u32 = 32;

/// The landmarks of a cell that tell it from others.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CoarseCell {
    /// The cell's keyframes, ascending.
    pub keyframes: Vec<KeyframeId>,
    /// Their positions in G, metres.
    pub positions: Vec<[f32; 3]>,
    /// Some landmarks that they observe.
    pub landmarks: Vec<CoarseLandmark>,
}

/// A landmark by its looks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CoarseLandmark {
    /// As one of its observers saw it.
    pub descriptor: Vec<u8>,
    /// Which of [`CoarseCell::keyframes`] observe it, ascending.
    pub observers: Vec<u32>,
}

#[derive(Serialize, Deserialize)]
struct CoarseRecord {
    keyframes: Vec<KeyframeId>,
    positions: Vec<[f32; 3]>,
    descriptors: Vec<Vec<u8>>,
    observers: Vec<Vec<u32>>,
}

impl CoarseCell {
    /// Of the landmarks that most of the cell's keyframes observe, so many that each keyframe has its share.
    pub(crate) fn of(cell: &BorderedCell<'_>) -> Self {
        let keyframes: Vec<KeyframeId> = cell.own.keyframes.iter().map(|keyframe| keyframe.id).collect();
        let number: BTreeMap<KeyframeId, u32> = keyframes.iter().copied().zip(0..).collect();
        let observers = |landmark: &Landmark| -> Vec<u32> {
            let numbers = landmark.observations.iter().filter_map(|seen| number.get(&seen.keyframe).copied());
            numbers.collect()
        };
        let all = cell.own.landmarks.iter().chain(&cell.border.landmarks);
        let mut observed: Vec<(Vec<u32>, &Landmark)> =
            all.map(|landmark| (observers(landmark), *landmark)).collect();
        observed.sort_by_key(|(observers, landmark)| (std::cmp::Reverse(observers.len()), landmark.id));
        let mut taken = vec![0_u32; keyframes.len()];
        let mut landmarks = Vec::new();
        for (observers, landmark) in observed {
            if observers.iter().all(|at| taken[*at as usize] >= LANDMARKS_A_KEYFRAME) {
                continue;
            }
            let own = |id: KeyframeId| number.contains_key(&id);
            let Some(seen) = landmark.observations.iter().find(|seen| own(seen.keyframe)) else { continue };
            for at in &observers {
                taken[*at as usize] += 1;
            }
            landmarks.push(CoarseLandmark { descriptor: seen.descriptor.clone(), observers });
        }
        let position =
            |keyframe: &Keyframe| keyframe.global_from_keyframe.pose.translation.cast::<f32>().into();
        let positions = cell.own.keyframes.iter().map(|keyframe| position(keyframe)).collect();
        Self { keyframes, positions, landmarks }
    }

    pub(crate) fn encode(self) -> Result<Vec<u8>, RecordError> {
        let Self { keyframes, positions, landmarks } = self;
        let (descriptors, observers) =
            landmarks.into_iter().map(|landmark| (landmark.descriptor, landmark.observers)).unzip();
        let record = CoarseRecord { keyframes, positions, descriptors, observers };
        Ok([MAGIC, &seal(TABLE, &[], &record)?].concat())
    }

    /// Decodes what [`CoarseCell::encode`] wrote.
    ///
    /// # Arguments
    /// * `width`: bytes of a descriptor.
    pub(crate) fn decode(bytes: &[u8], width: usize) -> Result<Self, SegmentError> {
        let sealed = bytes.strip_prefix(MAGIC).ok_or(SegmentError::NotASegment)?;
        let damaged = |problem| SegmentError::Record { record: "its record".to_owned(), problem };
        let CoarseRecord { keyframes, positions, descriptors, observers } =
            unseal(TABLE, &[], sealed).map_err(damaged)?;
        let count = keyframes.len();
        let is_known = |observers: &Vec<u32>| observers.iter().all(|at| (*at as usize) < count);
        let is_whole = descriptors.len() == observers.len()
            && positions.len() == count
            && keyframes.is_sorted()
            && descriptors.iter().all(|descriptor| descriptor.len() == width)
            && observers.iter().all(|observers| observers.is_sorted() && is_known(observers));
        if !is_whole {
            let reason = "its landmarks do not fit its keyframes".to_owned();
            return Err(damaged(RecordError::Undecodable { reason }));
        }
        let landmarks = descriptors.into_iter().zip(observers);
        let landmarks =
            landmarks.map(|(descriptor, observers)| CoarseLandmark { descriptor, observers }).collect();
        Ok(Self { keyframes, positions, landmarks })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::split;
    use crate::partition::Partition;
    use proptest::prelude::*;
    use std::sync::LazyLock;
    use testing::{Place, PlaceOptions};

    fn coarse() -> (CoarseCell, usize, usize) {
        let map = Place::new(&PlaceOptions::default()).map;
        let cells = split(&map, &Partition::whole(map.info.gravity_in_global));
        (CoarseCell::of(&cells[&0]), map.landmarks.len(), usize::from(map.info.descriptor_width))
    }

    #[test]
    fn each_keyframe_has_its_share_and_few_landmarks_do() {
        let (coarse, landmarks, width) = coarse();
        assert_eq!(coarse.keyframes.len(), 30);
        assert!(coarse.landmarks.len() * 3 < landmarks, "{} of {landmarks}", coarse.landmarks.len());
        for at in 0..30_u32 {
            let share = coarse.landmarks.iter().filter(|landmark| landmark.observers.contains(&at)).count();
            assert!(share >= LANDMARKS_A_KEYFRAME as usize, "keyframe {at} has {share}");
        }
        let bytes = coarse.clone().encode().unwrap();
        assert_eq!(CoarseCell::decode(&bytes, width).unwrap(), coarse);
        assert!(CoarseCell::decode(&bytes, width + 1).is_err());
    }

    static ENCODED: LazyLock<(Vec<u8>, usize)> = LazyLock::new(|| {
        let (coarse, _, width) = coarse();
        (coarse.encode().unwrap(), width)
    });

    proptest! {
        #[test]
        fn damage_is_an_error(cut in 0..1_000_000_usize, at in 0..1_000_000_usize, bit in 0..8_u8) {
            let (bytes, width) = &*ENCODED;
            let width = *width;
            prop_assert!(CoarseCell::decode(&bytes[..cut % bytes.len()], width).is_err());
            let mut flipped = bytes.clone();
            flipped[at % bytes.len()] ^= 1 << bit;
            prop_assert!(CoarseCell::decode(&flipped, width).is_err());
        }
    }
}
