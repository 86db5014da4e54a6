//! The envelope around every record.
//!
//! ```text
//! record version u8 | crc32 u32 LE | payload (bincode 1)
//! ```
//! The checksum covers the table's name, the key, the version and the payload, so a record under the wrong key is
//! as damaged as one with flipped bits.

use bincode::Options;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::error::RecordError;

/// Version of the layout of payloads.
const RECORD_VERSION: u8 = 4;
/// Bytes before the payload.
pub(crate) const HEADER_BYTES: usize = 5;

/// Puts a record into its envelope.
///
/// # Errors
/// [`RecordError::Unencodable`].
pub fn seal<T: Serialize>(table: &str, key: &[u8], record: &T) -> Result<Vec<u8>, RecordError> {
    let mut bytes = vec![0; HEADER_BYTES];
    options()
        .serialize_into(&mut bytes, record)
        .map_err(|error| RecordError::Unencodable { reason: error.to_string() })?;
    let checksum = checksum(table, key, RECORD_VERSION, &bytes[HEADER_BYTES..]);
    bytes[0] = RECORD_VERSION;
    bytes[1..HEADER_BYTES].copy_from_slice(&checksum.to_le_bytes());
    Ok(bytes)
}

/// Takes a record out of its envelope.
///
/// # Errors
/// A damaged envelope, another version, or a payload that is no such record.
pub fn unseal<T: DeserializeOwned>(table: &str, key: &[u8], bytes: &[u8]) -> Result<T, RecordError> {
    decode(open(table, key, bytes)?)
}

/// What a payload holds, which may borrow from it.
///
/// # Errors
/// [`RecordError::Undecodable`]: a payload that is no such record.
pub fn decode<'a, T: Deserialize<'a>>(payload: &'a [u8]) -> Result<T, RecordError> {
    // No payload can claim more than its own length: a vector costs at least a byte an element.
    options()
        .with_limit(payload.len() as u64)
        .deserialize(payload)
        .map_err(|error| RecordError::Undecodable { reason: error.to_string() })
}

/// The bytes of a record without an envelope, for a digest over records.
pub(crate) fn payload<T: Serialize>(record: &T) -> Vec<u8> {
    // Only a writer that refuses bytes, or a type that bincode does not know, makes this fail.
    options().serialize(record).unwrap_or_default()
}

/// The payload of an intact record.
///
/// # Errors
/// A damaged envelope, another version.
pub fn open<'a>(table: &str, key: &[u8], bytes: &'a [u8]) -> Result<&'a [u8], RecordError> {
    let Some((&[version, c0, c1, c2, c3], payload)) = bytes.split_first_chunk::<HEADER_BYTES>() else {
        return Err(RecordError::TooShort { bytes: bytes.len() });
    };
    if checksum(table, key, version, payload) != u32::from_le_bytes([c0, c1, c2, c3]) {
        return Err(RecordError::Checksum);
    }
    if version != RECORD_VERSION {
        return Err(RecordError::Version { found: version, expected: RECORD_VERSION });
    }
    Ok(payload)
}

fn options() -> impl Options {
    bincode::DefaultOptions::new().with_fixint_encoding()
}

fn checksum(table: &str, key: &[u8], version: u8, payload: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(table.as_bytes());
    hasher.update(key);
    hasher.update(&[version]);
    hasher.update(payload);
    hasher.finalize()
}
