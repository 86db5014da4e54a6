//! What can go wrong with releases.

use crate::damage::Damage;
use crate::partition::CellId;
use crate::stage::Verdict;
use map::file::SegmentError;
use map::{ContentsError, RecordError};
use protocol::MapIdentity;
use signing::SignatureError;
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
    /// The newest release has sessions that the map lacks: it is older, or was built anew.
    #[error(
        "release {number} of {place} has {sessions} sessions that this map lacks, the first of them {first}: they would be lost; driftless checkout \
         {place} makes a working copy that has them, driftless rollback goes back to a release on purpose, and --replace publishes a map that was \
         built anew"
    )]
    LosesSessions {
        /// The store.
        place: String,
        /// The release.
        number: u64,
        /// How many.
        sessions: usize,
        /// The name of one.
        first: String,
    },
    /// Another program published meanwhile.
    #[error("another program published release {number} at the same time: publish again to come after it")]
    Conflict {
        /// The number that was free before.
        number: u64,
    },
    /// Another program put a candidate meanwhile.
    #[error(
        "another program published candidate {candidate} at the same time: publish again to come after it"
    )]
    CandidateConflict {
        /// The number that was free before.
        candidate: u64,
    },
    /// There is no candidate of that number, or none at all.
    #[error("{place} has no {}; driftless list-releases {place} lists them", candidate.map_or_else(|| "candidate".to_owned(), |number| format!("candidate {number}")))]
    NoCandidate {
        /// The store.
        place: String,
        /// The number; `None` for any.
        candidate: Option<u64>,
    },
    /// The candidate was compared with another release than the newest one.
    #[error(
        "candidate {candidate} was made for release {number}, and release {newest} is the newest one: publish the map as a candidate again, and review that"
    )]
    Overtaken {
        /// The candidate.
        candidate: u64,
        /// The number that it would have had.
        number: u64,
        /// The newest release, 0 for none.
        newest: u64,
    },
    /// The candidate was decided about before.
    #[error("candidate {candidate} was {verdict} before{}", by.as_ref().map_or_else(String::new, |by| format!(" by {by}")))]
    Decided {
        /// The candidate.
        candidate: u64,
        /// What was decided.
        verdict: Verdict,
        /// By whom, where that is known.
        by: Option<String>,
    },
    /// A note that cannot be stored.
    #[error("the {what} may have {at_most} bytes, and no control characters like line breaks")]
    Note {
        /// `author` or `comment`.
        what: &'static str,
        /// The limit.
        at_most: usize,
    },
    /// Segments are removed, or were removed just now.
    #[error(
        "{place} is being cleaned by another program, and segments of this release may go: nothing was published; try again when it has ended"
    )]
    Cleaning {
        /// The store.
        place: String,
    },
    /// While segments were removed, the mark that tells publishers of it could be taken for one of a killed program.
    #[error(
        "cleaning {place} was stopped: its mark was not renewed for a minute, and others may take this program for one that was killed; clean again"
    )]
    MarkLost {
        /// The store.
        place: String,
    },
    /// The file of a release, candidate or decision would be longer than any that is read.
    #[error(
        "{object} would have {bytes} bytes, more than the {most} that can be read: nothing was published; publish the map in larger cells \
         (publish-map --keyframes-per-cell)"
    )]
    TooLong {
        /// The file.
        object: String,
        /// Its bytes.
        bytes: u64,
        /// The limit.
        most: u64,
    },
    /// The same, and most of it is the ledger of the map's sessions.
    #[error(
        "{object} would have {bytes} bytes, more than the {most} that can be read, most of them the ledger of its {sessions} sessions: nothing \
         was published; build the map anew from recent recordings (driftless build-map), publish it elsewhere, and let robots record \
         longer sessions (onboard --hand-in-minutes)"
    )]
    LongLedger {
        /// The file.
        object: String,
        /// How many the ledger has.
        sessions: usize,
        /// Bytes of the file.
        bytes: u64,
        /// The limit.
        most: u64,
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
        "{object} of {place} is not signed with the key that was given: {reason}; do not use it unless you know who published it"
    )]
    NotSigned {
        /// The store.
        place: String,
        /// The file of the release, candidate or decision.
        object: String,
        /// What is wrong with its signature.
        reason: SignatureError,
    },
    /// What would be signed anew was not signed with that key before; nothing is published.
    #[error(
        "{object} of {place} is not signed with the key that would sign it anew: {reason}; nothing was published. If \
         you know who published it, take its map (driftless checkout {place}@{choice} --map DB), look at it, and \
         publish it with --sign"
    )]
    SourceNotSigned {
        /// The store.
        place: String,
        /// The file of the release or candidate.
        object: String,
        /// Which one, as it is named after the `@` of a place.
        choice: String,
        /// What is wrong with its signature.
        reason: SignatureError,
    },
    /// A release cannot be signed; it is not published.
    #[cfg(feature = "signing")]
    #[error("{object} cannot be signed: {source}")]
    Sign {
        /// The file of the release, candidate or decision.
        object: String,
        /// The error.
        source: signing::SignError,
    },
    /// A secret key cannot be used.
    #[cfg(feature = "signing")]
    #[error(transparent)]
    Key(#[from] signing::KeyError),
    /// The release has no such cell.
    #[error("{release} of {place} has no cell {cell}; driftless list-releases --cells names them")]
    NoCell {
        /// The store.
        place: String,
        /// [Title](crate::Release::title) of the release or candidate.
        release: String,
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
