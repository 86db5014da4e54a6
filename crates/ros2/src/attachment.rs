//! What comes with every message.

use super::liveliness::GID_BYTES;

/// Length on the wire: two numbers of 8 bytes, the length of the id, the id.
pub const ATTACHMENT_BYTES: usize = 8 + 8 + 1 + GID_BYTES;

/// Number, time and sender of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// Counts the messages of a publisher, from 1 on.
    pub sequence_number: i64,
    /// When it was published, nanoseconds since the epoch of the sender's clock.
    pub source_stamp_ns: i64,
    /// The publisher.
    pub gid: [u8; GID_BYTES],
}

impl Attachment {
    /// The bytes, numbers little endian.
    pub fn to_bytes(&self) -> [u8; ATTACHMENT_BYTES] {
        let mut bytes = [0; ATTACHMENT_BYTES];
        bytes[..8].copy_from_slice(&self.sequence_number.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.source_stamp_ns.to_le_bytes());
        bytes[16] = GID_BYTES as u8;
        bytes[17..].copy_from_slice(&self.gid);
        bytes
    }

    /// Reads the bytes; `None` where they are no attachment of `rmw_zenoh`.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (sequence_number, rest) = bytes.split_first_chunk()?;
        let (source_stamp_ns, rest) = rest.split_first_chunk()?;
        let (length, gid) = rest.split_first()?;
        let gid = gid.try_into().ok().filter(|_| usize::from(*length) == GID_BYTES)?;
        Some(Self {
            sequence_number: i64::from_le_bytes(*sequence_number),
            source_stamp_ns: i64::from_le_bytes(*source_stamp_ns),
            gid,
        })
    }
}
