//! CDR (XCDR version 1) with its 4-byte header, as ROS 2 puts it on the wire and into recordings.

use crate::message::RosMessage;
use hiroz_cdr::{BigEndian, LittleEndian};

/// Length of the header: two bytes of representation, two of options.
const HEADER: usize = 4;
const PLAIN_BIG_ENDIAN: [u8; 2] = [0, 0];
const PLAIN_LITTLE_ENDIAN: [u8; 2] = [0, 1];
/// Some middlewares round a payload up to a multiple of 4 or 8 bytes.
const MAX_PADDING: usize = 7;
/// Room for the fields around an array of bytes, so that most messages are written without a reallocation.
const CAPACITY: usize = 1024;

/// Why bytes are not the message, or a message can't be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CdrError {
    /// Fewer bytes than a header has.
    #[error("{type_name}: {length} bytes are too few for a CDR header")]
    NoHeader {
        /// The expected type.
        type_name: &'static str,
        /// Bytes given.
        length: usize,
    },
    /// Parameter lists, XCDR2 and whatever else is not plain CDR.
    #[error(
        "{type_name}: CDR representation {representation:#06x} is not supported, only plain CDR (0x0000, 0x0001)"
    )]
    Representation {
        /// The expected type.
        type_name: &'static str,
        /// The header's representation identifier.
        representation: u16,
    },
    /// The bytes end too early, or a string, boolean or length in them is invalid.
    #[error("{type_name}: the bytes are truncated or of another type: {source}")]
    Malformed {
        /// The expected type.
        type_name: &'static str,
        /// What the decoder met.
        source: hiroz_cdr::Error,
    },
    /// More bytes than the message has, so they are probably of another type.
    #[error("{type_name}: {count} bytes are left after the message: is the topic of another type?")]
    TrailingBytes {
        /// The expected type.
        type_name: &'static str,
        /// Bytes after the last field.
        count: usize,
    },
}

/// Writes a message as little-endian CDR with its header.
///
/// # Errors
/// [`CdrError::Malformed`] for a sequence whose length is unknown; none of this crate's messages has one.
pub fn encode<M: RosMessage>(message: &M) -> Result<Vec<u8>, CdrError> {
    let mut bytes = Vec::with_capacity(CAPACITY);
    bytes.extend_from_slice(&[PLAIN_LITTLE_ENDIAN[0], PLAIN_LITTLE_ENDIAN[1], 0, 0]);
    // The writer aligns relative to the length that it finds, which is the header's.
    let mut serializer = hiroz_cdr::CdrSerializer::<LittleEndian>::new(&mut bytes);
    message
        .serialize(&mut serializer)
        .map_err(|source| CdrError::Malformed { type_name: M::TYPE_NAME, source })?;
    Ok(bytes)
}

/// Reads a message from CDR of either byte order.
///
/// Lengths in the bytes are checked against what is there before anything is allocated for them.
///
/// # Errors
/// All of [`CdrError`].
pub fn decode<M: RosMessage>(bytes: &[u8]) -> Result<M, CdrError> {
    let type_name = M::TYPE_NAME;
    let Some((header, body)) = bytes.split_at_checked(HEADER) else {
        return Err(CdrError::NoHeader { type_name, length: bytes.len() });
    };
    let (message, read) = match [header[0], header[1]] {
        PLAIN_LITTLE_ENDIAN => hiroz_cdr::from_bytes::<M, LittleEndian>(body),
        PLAIN_BIG_ENDIAN => hiroz_cdr::from_bytes::<M, BigEndian>(body),
        other => {
            return Err(CdrError::Representation { type_name, representation: u16::from_be_bytes(other) });
        }
    }
    .map_err(|source| CdrError::Malformed { type_name, source })?;
    match body.len() - read {
        0..=MAX_PADDING => Ok(message),
        count => Err(CdrError::TrailingBytes { type_name, count }),
    }
}
