//! What can be wrong with a session file.

use std::path::PathBuf;

use calibration::CalibrationError;

use crate::memory::{MAX_MEMORY_PER_BYTE, MAX_SESSION_MEMORY_BYTES};

/// Why a session file cannot be used: always the file, and what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum HandInError {
    /// The operating system reports an error.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error.
        source: std::io::Error,
    },
    /// It is no session file.
    #[error("{} is no session file of a robot (it does not start with \"DRFTSESS\")", path.display())]
    OtherFormat {
        /// The file.
        path: PathBuf,
    },
    /// It has another schema.
    #[error(
        "{} has schema {found}, this program reads those up to {expected}: update the older of the robot and this program",
        path.display()
    )]
    Schema {
        /// The file.
        path: PathBuf,
        /// Of the file.
        found: u16,
        /// The newest one that this program reads.
        expected: u16,
    },
    /// The header is not whole: the file was cut off, or is damaged.
    #[error("{}: its header is cut off or damaged, so nothing of it can be read: copy it from the robot again", path.display())]
    NoHeader {
        /// The file.
        path: PathBuf,
    },
    /// The header is whole, and no block that follows is.
    #[error("{}: it has a header and nothing behind it that is whole: the robot was stopped before anything was recorded, delete it", path.display())]
    NothingRecorded {
        /// The file.
        path: PathBuf,
    },
    /// The header cannot be read.
    #[error("{}: the header: {source}", path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// Why.
        source: serde_json::Error,
    },
    /// The header states what cannot be.
    #[error("{}: the header: {problem}", path.display())]
    HeaderValue {
        /// The file.
        path: PathBuf,
        /// What.
        problem: &'static str,
    },
    /// The calibration in the header cannot be used.
    #[error("{}: {source}", path.display())]
    Calibration {
        /// The file.
        path: PathBuf,
        /// Why.
        source: CalibrationError,
    },
    /// The file cannot be signed.
    #[error("{} cannot be signed: {source}", path.display())]
    Sign {
        /// The file.
        path: PathBuf,
        /// Why.
        source: signing::SignError,
    },
    /// The signature is missing or wrong.
    #[error("{}: {source}", path.display())]
    Signature {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: signing::SignatureError,
    },
    /// A block that is whole holds what cannot be.
    #[error("{}: the block at byte {offset}: {source}; the robot that wrote it has another version or a fault", path.display())]
    Chunk {
        /// The file.
        path: PathBuf,
        /// Where the block begins.
        offset: u64,
        /// What is wrong.
        source: ChunkError,
    },
}

/// What is wrong with a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ChunkError {
    /// Something is announced that is not there.
    #[error("it is shorter than it says")]
    TooShort,
    /// Something follows its end.
    #[error("{0} bytes follow its end")]
    TooLong(usize),
    /// An integer of more than 64 bits.
    #[error("an integer has more than 64 bits")]
    Integer,
    /// Times do not ascend.
    #[error("its times do not ascend")]
    Order,
    /// It takes more memory than [`MAX_MEMORY_PER_BYTE`](crate::MAX_MEMORY_PER_BYTE) allows.
    #[error(
        "its content would take more than {most} bytes of memory, {MAX_MEMORY_PER_BYTE} for each of its own"
    )]
    Memory {
        /// Bytes that it may take.
        most: u64,
    },
    /// With it the session takes more memory than [`MAX_SESSION_MEMORY_BYTES`](crate::MAX_SESSION_MEMORY_BYTES).
    #[error("with it the session would take more than {MAX_SESSION_MEMORY_BYTES} bytes of memory")]
    SessionMemory,
    /// A number that cannot be.
    #[error("{0} is out of range")]
    Range(&'static str),
    /// A kind of block that this version does not know.
    #[error("blocks of kind {0} are not known")]
    Kind(u8),
}
