//! `map/{map}/sessions/{robot}`: session files that robots hand in, part by part.
//!
//! A part without bytes asks how much of a file has been received. Whatever was lost on the way, the reply to any part says where to
//! go on; a file is complete when it is on the disk of the server, and its digest is right.

use crate::validate::{InvalidField, Validate, require};
use serde::{Deserialize, Serialize};

/// Most bytes of a part.
pub const MAX_SESSION_PART_BYTES: usize = 64 << 10;

/// Largest session file that is handed in, bytes.
pub const MAX_SESSION_BYTES: u64 = 256 << 20;

/// Some bytes of a session file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SessionPart {
    /// Bytes of the whole file, at most [`MAX_SESSION_BYTES`].
    pub total_bytes: u64,
    /// SHA-256 of the whole file.
    pub digest: [u8; 32],
    /// Where in the file the bytes begin.
    pub offset: u64,
    /// At most [`MAX_SESSION_PART_BYTES`]; none to ask how much has been received.
    #[serde(with = "serde_bytes")]
    pub bytes: Vec<u8>,
}

impl Validate for SessionPart {
    fn validate(&self) -> Result<(), InvalidField> {
        require(self.total_bytes > 0, "total_bytes", "is zero")?;
        let fits = self.total_bytes <= MAX_SESSION_BYTES;
        require(fits, "total_bytes", &format!("is more than {MAX_SESSION_BYTES}"))?;
        let few = self.bytes.len() <= MAX_SESSION_PART_BYTES;
        require(few, "bytes", &format!("are more than {MAX_SESSION_PART_BYTES}"))?;
        let end = self.offset.checked_add(self.bytes.len() as u64);
        let inside = end.is_some_and(|end| end <= self.total_bytes);
        require(inside, "offset", "and the bytes go beyond the end of the file")
    }
}

/// The answer to a [`SessionPart`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SessionPartReply {
    /// Bytes of the file that have been received: where to go on. After a file that was damaged on its way it is zero.
    pub received_bytes: u64,
    /// The whole file is on the disk of the server, checked.
    pub is_complete: bool,
}

impl Validate for SessionPartReply {
    fn validate(&self) -> Result<(), InvalidField> {
        require(self.received_bytes <= MAX_SESSION_BYTES, "received_bytes", "is more than a session may have")
    }
}
