//! What can go wrong with releases.

use crate::damage::Damage;
use crate::partition::CellId;
use crate::signing::SignatureError;
use map::file::SegmentError;
use map::{ContentsError, RecordError};
use protocol::MapIdentity;
use std::path::PathBuf;

/// Why a release was not published, read or fetched.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReleaseError {
    /// The place is no URL that can be used.
    #[error("{place} is no place of releases: {reason}; write a folder, or a URL like s3://bucket/city")]
    Place {
        /// What was given.
        place: String,
        /// Why not.
        reason: String,
    },
    /// The store failed.
    #[error("{place}: {object} cannot be {done}: {reason}")]
    Store {
        /// The store.
        place: String,
        /// What it was about.
        object: String,
        /// `read`, `written`, `listed` or `removed`.
        done: &'static str,
        /// The error of the store, which tells its own causes.
        reason: Box<object_store::Error>,
    },
    /// Another program published meanwhile.
    #[error("another program published release {number} at the same time: publish again to come after it")]
    Conflict {
        /// The number that was free before.
        number: u64,
    },
    /// Segments are removed, or were removed just now.
    #[error(
        "{place} is being cleaned by another program, and segments of this release may go: nothing was published; try again when it has ended"
    )]
    Cleaning {
        /// The store.
        place: String,
    },
    /// The map is not a version of the one that is published there.
    #[error(
        "the map has the identity {given}, and {place} holds releases of another map ({published}): publish it elsewhere"
    )]
    OtherMap {
        /// The store.
        place: String,
        /// Identity of the given map.
        given: MapIdentity,
        /// Identity of the published one.
        published: MapIdentity,
    },
    /// Nothing was published there.
    #[error("{place} has no release: publish one with driftless publish-map --to {place}")]
    Empty {
        /// The store.
        place: String,
    },
    /// There is no release of that number.
    #[error("{place} has no release {number}; driftless list-releases {place} lists them")]
    NoRelease {
        /// The store.
        place: String,
        /// The number.
        number: u64,
    },
    /// The release is not signed with the key that it must be signed with.
    #[error(
        "release {number} of {place} is not signed with the key that was given: {reason}; do not use it unless you know who published it"
    )]
    NotSigned {
        /// The store.
        place: String,
        /// The release.
        number: u64,
        /// What is wrong with its signature.
        reason: SignatureError,
    },
    /// A release cannot be signed; it is not published.
    #[error("release {number} cannot be signed: {reason}")]
    Sign {
        /// The release.
        number: u64,
        /// The error of minisign.
        reason: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A secret key cannot be used.
    #[error("the key {file} cannot be used: {reason}")]
    Key {
        /// File of the key.
        file: PathBuf,
        /// Why not.
        reason: String,
    },
    /// The release has no such cell.
    #[error("release {number} of {place} has no cell {cell}; driftless list-releases --cells names them")]
    NoCell {
        /// The store.
        place: String,
        /// The release.
        number: u64,
        /// The cell.
        cell: CellId,
    },
    /// What was read is not what was published.
    #[error("{place}: {object} is damaged: {reason}")]
    Damaged {
        /// The store.
        place: String,
        /// The object.
        object: String,
        /// What is wrong with it.
        reason: Damage,
    },
    /// A segment that has the right checksum and cannot be understood.
    #[error("{place}: segment {segment} cannot be read")]
    Segment {
        /// The store.
        place: String,
        /// Its name.
        segment: String,
        /// What is wrong with it.
        source: SegmentError,
    },
    /// The map violates an invariant.
    #[error(transparent)]
    Contents(#[from] ContentsError),
    /// A cell cannot be encoded.
    #[error("a cell of the map cannot be written")]
    Record(#[from] RecordError),
    /// The cache failed.
    #[error("the cache {path} cannot be used")]
    Cache {
        /// File or folder.
        path: PathBuf,
        /// The error of the file system.
        source: std::io::Error,
    },
}

/// An error with its causes, in one line.
pub(crate) fn with_causes(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(error.source(), |cause| cause.source());
    causes.fold(error.to_string(), |text, cause| format!("{text}: {cause}"))
}
