//! Session files: what a robot records of a drive for the map, and hands in.
//!
//! A session has what a map can be extended by: readings of the IMU, tracked points, the features of keyframe candidates of all cameras
//! that the map is asked about, and which landmarks of the map were matched with them. It has no poses: what came out of a map does not go into it again.
//!
//! | module | what |
//! |---|---|
//! | `reading`, `writing` | [`Session`], [`SessionWriter`]: files, cut off without harm |
//! | `header` | [`Header`]: robot, sensors, extractor |
//! | `chunk` | [`Chunk`]: some seconds of a session |
//! | `block`, `blocks` | blocks with checksums; those of a file |
//! | `bytes`, `memory` | integers of variable length; how much memory a chunk may take |
//! | `schema` | versions of the format |
//! | `signature` | [`sign`], [`verify`] |
//! | [`inbox`] | [`Inbox`]: the folder that sessions are handed in to |
//! | `error` | [`HandInError`], [`ChunkError`] |
//!
//! The format is described in the book, "Session files".
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod block;
mod blocks;
mod bytes;
mod chunk;
mod error;
mod header;
pub mod inbox;
mod memory;
mod reading;
mod schema;
mod signature;
mod writing;

pub use chunk::{Answer, AnsweredMatch, Candidate, Chunk, RecordedSoFar, SessionFrame};
pub use error::{ChunkError, HandInError};
pub use header::Header;
pub use inbox::{Inbox, InboxError, InboxSettings, Received};
pub use memory::{MAX_MEMORY_PER_BYTE, MAX_SESSION_MEMORY_BYTES};
pub use reading::Session;
pub use signature::{sign, verify};
pub use writing::SessionWriter;

/// How a session file begins.
const MAGIC: &[u8; 8] = b"DRFTSESS";
