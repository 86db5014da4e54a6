//! Segments of a map and their records.

use map::file::Segment;
use map::file::record::{Element, key_bytes, unseal};
use map::{CommonError, Keyframe, KeyframeAliases, KeyframeCrossCovariance, Landmark};

/// The first line of a segment.
const MAGIC: &[u8] = b"driftless segment 4\n";

/// Records of every kind: the bytes as they are, and as the payload of an intact envelope, so that mutations get past
/// the checksum; and segments, whole ones and one record after the other. The first byte is the record's version.
pub fn store_records(data: &[u8]) {
    let _ = Segment::decode(data);
    let _ = Segment::decode(&[MAGIC, data].concat());
    read::<Keyframe>(data);
    read::<Landmark>(data);
    read::<KeyframeCrossCovariance>(data);
    read::<CommonError>(data);
    read::<KeyframeAliases>(data);
}

fn read<E: Element>(data: &[u8]) {
    let mut key = E::Key::default();
    // Any, since the checksum is made for it; of a pair, the second is larger.
    key.as_mut().iter_mut().zip(1..).for_each(|(id, number)| *id = number);
    let (table, bytes) = (E::TABLE.name(), key_bytes(key.as_ref()));
    let of = |sealed: &[u8]| {
        let record: Result<E::Record, _> = unseal(table, &bytes, sealed);
        let _ = record.and_then(|record| E::from_record(key, record));
    };
    of(data);
    let Some((&version, payload)) = data.split_first() else { return };
    of(&sealed(table, &bytes, version, payload));
}

fn sealed(table: &str, key: &[u8], version: u8, payload: &[u8]) -> Vec<u8> {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(table.as_bytes());
    hasher.update(key);
    hasher.update(&[version]);
    hasher.update(payload);
    let mut bytes = vec![version];
    bytes.extend_from_slice(&hasher.finalize().to_le_bytes());
    bytes.extend_from_slice(payload);
    bytes
}
