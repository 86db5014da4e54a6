//! The bytes of a cell.
//!
//! ```text
//! "driftless segment 4\n"
//! for keyframes, landmarks, cross-covariances, common errors, aliases:
//!     number of records u64 LE
//!     for each: key (8 bytes, of a pair 16, big-endian) | length u32 LE | record as in a database
//! ```
//! Equal cells have equal bytes, whatever program and machine wrote them.

use crate::cells::{CellContents, CellView};
use crate::error::SegmentError;
use map::store::record::{
    AliasesRecord, CommonErrorRecord, CrossCovarianceRecord, KeyframeRecord, LandmarkRecord, seal, unseal,
};
use map::{KeyframeCrossCovariance, RecordError};

const MAGIC: &[u8] = b"driftless segment 4\n";
const KEYFRAMES: &str = "keyframes";
const LANDMARKS: &str = "landmarks";
const CROSS_COVARIANCES: &str = "cross_covariances";
const COMMON_ERRORS: &str = "common_errors";
const ALIASES: &str = "aliases";

/// Encodes a cell.
pub(crate) fn encode(cell: &CellView<'_>) -> Result<Vec<u8>, RecordError> {
    let mut bytes = MAGIC.to_vec();
    begin(&mut bytes, cell.keyframes.len());
    for keyframe in &cell.keyframes {
        let key = keyframe.id.to_be_bytes();
        append(&mut bytes, &key, &seal(KEYFRAMES, &key, &KeyframeRecord::new(keyframe))?)?;
    }
    begin(&mut bytes, cell.landmarks.len());
    for landmark in &cell.landmarks {
        let key = landmark.id.to_be_bytes();
        append(&mut bytes, &key, &seal(LANDMARKS, &key, &LandmarkRecord::new(landmark))?)?;
    }
    begin(&mut bytes, cell.cross_covariances.len());
    for cross in cell.cross_covariances.iter().map(|cross| cross.ordered()) {
        let key = pair_key(&cross);
        append(&mut bytes, &key, &seal(CROSS_COVARIANCES, &key, &CrossCovarianceRecord::new(&cross))?)?;
    }
    begin(&mut bytes, cell.common_errors.len());
    for common in &cell.common_errors {
        let key = common.keyframe.to_be_bytes();
        append(&mut bytes, &key, &seal(COMMON_ERRORS, &key, &CommonErrorRecord::new(common))?)?;
    }
    begin(&mut bytes, cell.aliases.len());
    for aliases in &cell.aliases {
        let key = aliases.keyframe.to_be_bytes();
        append(&mut bytes, &key, &seal(ALIASES, &key, &AliasesRecord::new(aliases))?)?;
    }
    Ok(bytes)
}

/// Decodes a cell. Counts and lengths are believed only as far as there are bytes.
pub(crate) fn decode(bytes: &[u8]) -> Result<CellContents, SegmentError> {
    let mut reader = Reader { bytes, at: 0 };
    if reader.take(MAGIC.len()).ok() != Some(MAGIC) {
        return Err(SegmentError::NotASegment);
    }
    let mut cell = CellContents::default();
    for _ in 0..reader.count()? {
        cell.keyframes.push(reader.record(|[id]: [u64; 1], key, sealed| {
            unseal::<KeyframeRecord>(KEYFRAMES, key, sealed)?.into_keyframe(id)
        })?);
    }
    for _ in 0..reader.count()? {
        cell.landmarks.push(reader.record(|[id]: [u64; 1], key, sealed| {
            Ok(unseal::<LandmarkRecord>(LANDMARKS, key, sealed)?.into_landmark(id))
        })?);
    }
    for _ in 0..reader.count()? {
        cell.cross_covariances.push(reader.record(|[a, b]: [u64; 2], key, sealed| {
            Ok(unseal::<CrossCovarianceRecord>(CROSS_COVARIANCES, key, sealed)?.into_cross_covariance(a, b))
        })?);
    }
    for _ in 0..reader.count()? {
        cell.common_errors.push(reader.record(|[id]: [u64; 1], key, sealed| {
            Ok(unseal::<CommonErrorRecord>(COMMON_ERRORS, key, sealed)?.into_common_error(id))
        })?);
    }
    for _ in 0..reader.count()? {
        cell.aliases.push(reader.record(|[id]: [u64; 1], key, sealed| {
            Ok(unseal::<AliasesRecord>(ALIASES, key, sealed)?.into_aliases(id))
        })?);
    }
    match bytes.len() - reader.at {
        0 => Ok(cell),
        bytes => Err(SegmentError::TooLong { bytes }),
    }
}

fn begin(bytes: &mut Vec<u8>, count: usize) {
    bytes.extend((count as u64).to_le_bytes());
}

fn append(bytes: &mut Vec<u8>, key: &[u8], sealed: &[u8]) -> Result<(), RecordError> {
    let length = u32::try_from(sealed.len()).map_err(|_| RecordError::Unencodable {
        reason: format!("a record of {} bytes is too long", sealed.len()),
    })?;
    bytes.extend(key);
    bytes.extend(length.to_le_bytes());
    bytes.extend(sealed);
    Ok(())
}

fn pair_key(cross: &KeyframeCrossCovariance) -> [u8; 16] {
    let mut key = [0; 16];
    key[..8].copy_from_slice(&cross.a.to_be_bytes());
    key[8..].copy_from_slice(&cross.b.to_be_bytes());
    key
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], SegmentError> {
        let end = self.at.checked_add(count);
        let taken = end.and_then(|end| self.bytes.get(self.at..end));
        let taken = taken.ok_or(SegmentError::CutOff { bytes: self.bytes.len() })?;
        self.at += count;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], SegmentError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn count(&mut self) -> Result<u64, SegmentError> {
        self.array().map(u64::from_le_bytes)
    }

    fn record<T, const N: usize>(
        &mut self,
        decode: impl FnOnce([u64; N], &[u8], &[u8]) -> Result<T, RecordError>,
    ) -> Result<T, SegmentError> {
        let at = self.at;
        let key = self.take(8 * N)?;
        let (ids, _) = key.as_chunks::<8>();
        let ids = std::array::from_fn(|index| u64::from_be_bytes(ids[index]));
        let length = u32::from_le_bytes(self.array()?) as usize;
        let sealed = self.take(length)?;
        decode(ids, key, sealed).map_err(|source| SegmentError::Record { at, source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::{join, split};
    use crate::partition::Partition;
    use proptest::prelude::*;
    use std::sync::LazyLock;
    use testing::{Place, PlaceOptions, add_aliases, add_common_errors};

    fn bytes(common: bool, aliases: bool) -> Vec<u8> {
        let options = PlaceOptions { keyframes: 6, landmarks: 80, ..PlaceOptions::default() };
        let mut map = Place::new(&options).map;
        if common {
            add_common_errors(&mut map, 2);
        }
        if aliases {
            add_aliases(&mut map);
        }
        let cells = split(&map, &Partition::whole(map.info.gravity_in_global));
        let bytes = encode(&cells[&0].own).unwrap();
        let mut sorted = map.clone();
        sorted.sort();
        assert_eq!(join(map.info, [decode(&bytes).unwrap()]), sorted);
        bytes
    }

    /// By whether they have common errors, and aliases.
    static SEGMENTS: LazyLock<[[Vec<u8>; 2]; 2]> =
        LazyLock::new(|| [false, true].map(|common| [false, true].map(|aliases| bytes(common, aliases))));

    proptest! {
        #[test]
        fn no_bytes_make_it_panic_and_none_are_believed(
            common: bool, aliases: bool,
            cut in 0..1_000_000_usize, at in 0..1_000_000_usize, bit in 0..8_u8, noise: Vec<u8>,
        ) {
            let bytes = SEGMENTS[usize::from(common)][usize::from(aliases)].as_slice();
            prop_assert!(decode(&bytes[..cut % bytes.len()]).is_err());
            let mut flipped = bytes.to_vec();
            flipped[at % bytes.len()] ^= 1 << bit;
            prop_assert!(decode(&flipped).is_err());
            prop_assert!(decode(&[MAGIC, noise.as_slice()].concat()).is_err());
            prop_assert!(decode(&[bytes, &[0]].concat()).is_err());
        }
    }
}
