//! Messages to bytes and back; decoding checks everything.
//!
//! Bincode payloads have an envelope, because most random bytes decode to *some* message:
//!
//! | bytes | little-endian |
//! |---|---|
//! | 0..4 | magic `DRFT` |
//! | 4..6 | schema version |
//! | 6..8 | message type, [`Message::TAG`] |
//! | 8..12 | payload length |
//! | 12..16 | CRC-32 (IEEE) of bytes 4..12 and the payload |
//! | 16.. | payload: bincode, little-endian, variable-length integers |
//!
//! JSON payloads are one object with `"schema"` and `"type"` beside the message's own fields.
//!
//! The order of checks is: total length, magic, schema version, length, checksum, type, decoding within the limit of
//! the bytes present, no bytes left over, and the values ([`Validate`]). Memory is never reserved for an announced
//! length.
//!
//! Messages of the schema before and of the one after are read, too, so that a fleet is upgraded one program at a time. This works
//! because a new schema only appends fields to the end of a message. A newer message has bytes left over, which are not read. An older
//! one ends too early and is read as if zeros followed: `None`, an empty list, `false`, 0. What an appended field means when it is
//! zero is that it is not stated; in JSON it has `#[serde(default)]`.

use std::cmp::Ordering;
use std::io::{Read as _, repeat};

use crate::limits::{MAX_MESSAGE_BYTES, OLDEST_SCHEMA, SCHEMA_VERSION};
use crate::validate::{InvalidField, Validate};
use bincode::Options;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use thiserror::Error;

const MAGIC: [u8; 4] = *b"DRFT";
const HEADER_BYTES: usize = 16;
/// Most bytes that fields which a schema appends have when they are zero.
const APPENDED_BYTES: u64 = 64;

/// A type that is a payload of its own.
pub trait Message: Serialize + DeserializeOwned + Validate {
    /// Its number in the bincode envelope, unique in this crate and never reused.
    const TAG: u16;
    /// Its name in JSON's `"type"` and in error texts.
    const NAME: &'static str;

    /// Reads the message's own fields from the flat JSON object.
    ///
    /// # Errors
    /// Those of `serde_json`.
    fn from_json(bytes: &[u8]) -> Result<Self, serde_json::Error> {
        serde_json::from_slice(bytes)
    }
}

/// Encoding of a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Format {
    /// Compact and checksummed, between Driftless programs.
    #[default]
    Bincode,
    /// For scripts and other languages.
    Json,
}

impl Format {
    /// Both formats.
    pub const ALL: [Self; 2] = [Self::Bincode, Self::Json];

    /// The name of this format as Zenoh's `Encoding`.
    pub fn encoding(self) -> &'static str {
        match self {
            Self::Bincode => "application/x-driftless-bincode",
            Self::Json => "application/json",
        }
    }

    /// The format that an `Encoding` names, a schema suffix (`;..`) ignored; `None` for any other.
    ///
    /// ```
    /// use protocol::Format;
    /// assert_eq!(Format::from_encoding("application/json;utf-8"), Some(Format::Json));
    /// assert_eq!(Format::from_encoding("image/png"), None);
    /// ```
    pub fn from_encoding(encoding: &str) -> Option<Self> {
        let name = encoding.split(';').next().unwrap_or_default().trim();
        Self::ALL.into_iter().find(|format| format.encoding() == name)
    }

    /// The format requested for the answer to a query: the parameter `format` of its selector (`json` or `bincode`;
    /// bincode if absent).
    ///
    /// ```
    /// use protocol::Format;
    /// assert_eq!(Format::from_parameters("format=json")?, Format::Json);
    /// assert_eq!(Format::from_parameters("")?, Format::Bincode);
    /// assert!(Format::from_parameters("format=xml").is_err());
    /// # Ok::<(), protocol::CodecError>(())
    /// ```
    ///
    /// # Errors
    /// [`CodecError::UnknownFormat`] for any other value.
    pub fn from_parameters(parameters: &str) -> Result<Self, CodecError> {
        match parameters.split([';', '&']).find_map(|parameter| parameter.trim().strip_prefix("format=")) {
            None | Some("bincode") => Ok(Self::Bincode),
            Some("json") => Ok(Self::Json),
            Some(other) => Err(CodecError::UnknownFormat(other.chars().take(32).collect())),
        }
    }
}

/// Why a message cannot be encoded or decoded.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CodecError {
    /// The payload exceeds [`MAX_MESSAGE_BYTES`].
    #[error("a payload of {length} bytes exceeds the limit of {MAX_MESSAGE_BYTES}")]
    TooLong {
        /// Its bytes; of an encoder that stopped early, the least it would have been.
        length: usize,
    },
    /// The payload ends within the envelope's header.
    #[error("the payload is truncated: {length} bytes are fewer than the header's {HEADER_BYTES}")]
    Truncated {
        /// Its bytes.
        length: usize,
    },
    /// The payload does not start with `DRFT`.
    #[error(
        "this is not a Driftless bincode payload (it does not start with \"DRFT\"); for JSON set the encoding to application/json"
    )]
    WrongMagic,
    /// The payload has a schema version that is not next to this one, or holds what this one does not know.
    #[error(
        "the payload has schema {found}, this program uses schema {expected}: update the older of the two programs"
    )]
    SchemaMismatch {
        /// Version of the payload.
        found: u64,
        /// [`SCHEMA_VERSION`] of this program.
        expected: u16,
    },
    /// A JSON payload without a schema version.
    #[error("the JSON object has no \"schema\" number: add \"schema\": {SCHEMA_VERSION}")]
    MissingSchema,
    /// The length in the envelope is not that of the payload.
    #[error(
        "the envelope announces {announced} bytes but {present} follow it: the payload was cut or concatenated in transit"
    )]
    WrongLength {
        /// Length in the envelope.
        announced: u64,
        /// Bytes present.
        present: usize,
    },
    /// The checksum does not match.
    #[error("the payload's checksum is wrong: it was damaged in transit")]
    WrongChecksum,
    /// The payload is another message than was expected here.
    #[error("expected a {expected}, got {found}")]
    WrongType {
        /// What was expected.
        expected: &'static str,
        /// What was found.
        found: String,
    },
    /// The bytes are not the fields of such a message.
    #[error("the payload is not a {message}: {reason}")]
    Malformed {
        /// What was expected.
        message: &'static str,
        /// Error of the decoder.
        reason: String,
    },
    /// A field has an invalid value.
    #[error("the {message} is invalid: {violation}")]
    Invalid {
        /// The message.
        message: &'static str,
        /// The field and what is wrong with it.
        #[source]
        violation: InvalidField,
    },
    /// A format that does not exist.
    #[error("unknown format {0:?}: use format=json or format=bincode")]
    UnknownFormat(String),
}

/// Encodes a message.
///
/// ```
/// use protocol::{ErrorCode, ErrorReply, Format, decode, encode};
/// let reply = ErrorReply::new(ErrorCode::Busy, "too many queries, ask again later");
/// let bytes = encode(Format::Bincode, &reply)?;
/// assert_eq!(decode::<ErrorReply>(Format::Bincode, &bytes)?, reply);
/// # Ok::<(), protocol::CodecError>(())
/// ```
///
/// # Errors
/// [`CodecError::Invalid`] for a message that [`decode`] would refuse, [`CodecError::TooLong`].
pub fn encode<M: Message>(format: Format, message: &M) -> Result<Vec<u8>, CodecError> {
    validated(message)?;
    let bytes = match format {
        Format::Bincode => encode_bincode(message)?,
        Format::Json => encode_json(message)?,
    };
    check_length(bytes.len())?;
    Ok(bytes)
}

/// Decodes and validates a message.
///
/// # Errors
/// Every [`CodecError`] but [`CodecError::UnknownFormat`]; the module documentation gives the order of the checks.
pub fn decode<M: Message>(format: Format, bytes: &[u8]) -> Result<M, CodecError> {
    check_length(bytes.len())?;
    let message = match format {
        Format::Bincode => decode_bincode(bytes)?,
        Format::Json => decode_json(bytes)?,
    };
    validated(&message)?;
    Ok(message)
}

fn check_length(length: usize) -> Result<(), CodecError> {
    if length > MAX_MESSAGE_BYTES { Err(CodecError::TooLong { length }) } else { Ok(()) }
}

/// How a payload's schema is related to that of this program: one that is read is the same, the one before or the one after.
fn check_schema(found: u64) -> Result<Ordering, CodecError> {
    let own = u64::from(SCHEMA_VERSION);
    let read = (own - 1).max(OLDEST_SCHEMA.into())..=own + 1;
    if read.contains(&found) { Ok(found.cmp(&own)) } else { Err(mismatch(found)) }
}

fn mismatch(found: u64) -> CodecError {
    CodecError::SchemaMismatch { found, expected: SCHEMA_VERSION }
}

fn validated<M: Message>(message: &M) -> Result<(), CodecError> {
    message.validate().map_err(|violation| CodecError::Invalid { message: M::NAME, violation })
}

fn malformed<M: Message>(error: &dyn std::fmt::Display) -> CodecError {
    CodecError::Malformed { message: M::NAME, reason: error.to_string() }
}

fn bincode_options(limit: usize) -> impl Options {
    bincode::DefaultOptions::new().with_limit(limit as u64).reject_trailing_bytes()
}

/// Reads the fields of a message.
///
/// # Arguments
/// * `age`: how the schema of the payload is related to that of `M`.
fn deserialize<M: DeserializeOwned>(payload: &[u8], age: Ordering) -> Result<M, bincode::Error> {
    let options = bincode_options(payload.len());
    match age {
        Ordering::Equal => options.deserialize(payload),
        Ordering::Greater => options.allow_trailing_bytes().deserialize(payload),
        Ordering::Less => {
            let with_zeros = payload.chain(repeat(0).take(APPENDED_BYTES));
            options.with_limit(payload.len() as u64 + APPENDED_BYTES).deserialize_from(with_zeros)
        }
    }
}

/// CRC-32 of the header's fields (all but the magic and itself) and the payload.
fn checksum(header_fields: &[u8], payload: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(header_fields);
    hasher.update(payload);
    hasher.finalize()
}

fn encode_bincode<M: Message>(message: &M) -> Result<Vec<u8>, CodecError> {
    let options = bincode_options(MAX_MESSAGE_BYTES);
    let mut bytes = vec![0; HEADER_BYTES];
    options.serialize_into(&mut bytes, message).map_err(|error| match *error {
        bincode::ErrorKind::SizeLimit => CodecError::TooLong { length: MAX_MESSAGE_BYTES + 1 },
        other => malformed::<M>(&other),
    })?;
    let payload_length = (bytes.len() - HEADER_BYTES) as u32;
    bytes[0..4].copy_from_slice(&MAGIC);
    bytes[4..6].copy_from_slice(&SCHEMA_VERSION.to_le_bytes());
    bytes[6..8].copy_from_slice(&M::TAG.to_le_bytes());
    bytes[8..12].copy_from_slice(&payload_length.to_le_bytes());
    let crc = checksum(&bytes[4..12], &bytes[HEADER_BYTES..]);
    bytes[12..16].copy_from_slice(&crc.to_le_bytes());
    Ok(bytes)
}

fn decode_bincode<M: Message>(bytes: &[u8]) -> Result<M, CodecError> {
    let (header, payload) =
        bytes.split_first_chunk::<HEADER_BYTES>().ok_or(CodecError::Truncated { length: bytes.len() })?;
    let [m0, m1, m2, m3, s0, s1, t0, t1, l0, l1, l2, l3, c0, c1, c2, c3] = *header;
    if [m0, m1, m2, m3] != MAGIC {
        return Err(CodecError::WrongMagic);
    }
    let schema = u64::from(u16::from_le_bytes([s0, s1]));
    let age = check_schema(schema)?;
    let announced = u64::from(u32::from_le_bytes([l0, l1, l2, l3]));
    if announced != payload.len() as u64 {
        return Err(CodecError::WrongLength { announced, present: payload.len() });
    }
    if checksum(&header[4..12], payload) != u32::from_le_bytes([c0, c1, c2, c3]) {
        return Err(CodecError::WrongChecksum);
    }
    let tag = u16::from_le_bytes([t0, t1]);
    if tag != M::TAG {
        return Err(CodecError::WrongType {
            expected: M::NAME,
            found: format!("the message with tag {tag}"),
        });
    }
    deserialize(payload, age).map_err(|error| unreadable::<M>(&error, schema))
}

/// Of a message of this schema: it is malformed. Of another one: it holds what this program does not know.
fn unreadable<M: Message>(error: &dyn std::fmt::Display, schema: u64) -> CodecError {
    if schema == u64::from(SCHEMA_VERSION) { malformed::<M>(error) } else { mismatch(schema) }
}

fn encode_json<M: Message>(message: &M) -> Result<Vec<u8>, CodecError> {
    let object = serde_json::to_vec(message).map_err(|error| malformed::<M>(&error))?;
    let fields = object.strip_prefix(b"{").ok_or_else(|| malformed::<M>(&"it is not a JSON object"))?;
    let mut bytes = format!("{{\"schema\":{SCHEMA_VERSION},\"type\":\"{}\",", M::NAME).into_bytes();
    bytes.extend_from_slice(fields);
    Ok(bytes)
}

fn decode_json<M: Message>(bytes: &[u8]) -> Result<M, CodecError> {
    #[derive(Deserialize)]
    struct Header {
        schema: Option<u64>,
        #[serde(rename = "type")]
        name: Option<String>,
    }
    let header: Header = serde_json::from_slice(bytes).map_err(|error| malformed::<M>(&error))?;
    let schema = header.schema.ok_or(CodecError::MissingSchema)?;
    check_schema(schema)?;
    match header.name {
        Some(name) if name != M::NAME => {
            let shown: String = name.chars().take(64).collect();
            Err(CodecError::WrongType { expected: M::NAME, found: format!("{shown:?}") })
        }
        _ => M::from_json(bytes).map_err(|error| unreadable::<M>(&error, schema)),
    }
}

/// An error of serde_json with a reason of our own.
pub(crate) fn malformed_json(reason: &str) -> serde_json::Error {
    <serde_json::Error as serde::de::Error>::custom(reason)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize, Deserialize, Debug, PartialEq)]
    struct Before {
        id: u64,
        name: String,
    }

    #[derive(Serialize, Deserialize, Debug, PartialEq)]
    struct After {
        id: u64,
        name: String,
        sigma_m: Option<f64>,
        places: Vec<u32>,
        is_moving: bool,
        speed: f32,
    }

    #[test]
    fn appended_fields_are_left_out_by_the_former_schema_and_zero_for_the_next_one() {
        let options = || bincode_options(MAX_MESSAGE_BYTES);
        let before = Before { id: 7, name: "hall".to_owned() };
        let after = |sigma_m, places, speed| {
            let name = "hall".to_owned();
            After { id: 7, name, sigma_m, places, is_moving: speed > 0.0, speed }
        };
        let stated = options().serialize(&after(Some(0.1), vec![1, 2, 3], 0.5)).unwrap();
        assert_eq!(deserialize::<Before>(&stated, Ordering::Greater).unwrap(), before);
        let old = options().serialize(&before).unwrap();
        assert_eq!(deserialize::<After>(&old, Ordering::Less).unwrap(), after(None, Vec::new(), 0.0));
        // Of one schema every byte counts.
        assert!(deserialize::<Before>(&stated, Ordering::Equal).is_err());
        assert!(deserialize::<After>(&old, Ordering::Equal).is_err());
    }

    #[test]
    fn what_was_cut_is_not_filled_with_zeros() {
        let cut = &bincode_options(MAX_MESSAGE_BYTES).serialize(&(7_u64, "a".repeat(200))).unwrap()[..100];
        assert!(deserialize::<After>(cut, Ordering::Less).is_err());
    }
}
