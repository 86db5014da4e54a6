//! Why a map could not be read or written.

use std::path::PathBuf;

use protocol::MapIdentity;

use crate::contents::ContentsError;
use crate::file::STORE_SCHEMA;
use crate::file::record::RecordError;
use crate::file::segment::SegmentError;

/// Why a map could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// There is no map at the path.
    #[error("there is no map at {path}: build one with `driftless build-map` or `driftless import-map`")]
    Missing {
        /// The path.
        path: PathBuf,
    },
    /// A new map must not overwrite what is there.
    #[error("{path} exists already: choose another path, or replace the map with --force")]
    Exists {
        /// Where the map should have been written.
        path: PathBuf,
    },
    /// The path holds something else.
    #[error("{path} is not a Driftless map: {problem}")]
    NotAMap {
        /// The path.
        path: PathBuf,
        /// What was found.
        problem: &'static str,
    },
    /// The program that wrote the map was stopped before it was complete.
    #[error(
        "the map {path} is unfinished: the program that wrote it was stopped before its end; \
         build or import it again (--force is not needed)"
    )]
    Unfinished {
        /// The path.
        path: PathBuf,
    },
    /// The map was written by an incompatible version of this program.
    #[error(
        "the map {path} has schema {found}, this program reads schemas {STORE_SCHEMA} to {expected}: \
         export it with the version that wrote it and import it again"
    )]
    Schema {
        /// The path.
        path: PathBuf,
        /// The number in the store.
        found: u16,
        /// The newest one that is read, [`super::EXTENDED_STORE_SCHEMA`].
        expected: u16,
    },
    /// A copy of one map cannot take the place of another one.
    #[error(
        "{path} holds {}, and what is to be written is {}: choose another path",
        found.map_or_else(|| "no map".to_owned(), |found| format!("the map {found}")),
        given.map_or_else(|| "a map without identity".to_owned(), |given| format!("the map {given}"))
    )]
    OtherMap {
        /// The path.
        path: PathBuf,
        /// Identity of the map that is there.
        found: Option<MapIdentity>,
        /// Identity of the map that was to be written.
        given: Option<MapIdentity>,
    },
    /// Another process writes the map.
    #[error(
        "the map {path} is in use by another program (a build or an import?): wait for its end, or stop it"
    )]
    InUse {
        /// The path.
        path: PathBuf,
    },
    /// Another program wrote the map since the work on it began.
    #[error(
        "the map {path} was changed meanwhile by another program (version {seen} was there at the begin, version {found} is now): nothing \
         was written; do it again with the map as it is now"
    )]
    Changed {
        /// The path.
        path: PathBuf,
        /// The version at the begin, 0 for none.
        seen: u64,
        /// The version now, 0 for none.
        found: u64,
    },
    /// The files of the map are not those that were written.
    #[error(
        "the map {path} is damaged: {damage}; restore it from a backup, or build or import it again with --force"
    )]
    Damaged {
        /// The path.
        path: PathBuf,
        /// What is wrong with it.
        damage: Damage,
    },
    /// The new contents violate an invariant of maps; nothing was written.
    #[error("the map would become invalid: {0}")]
    Invalid(#[from] ContentsError),
    /// A file or folder of the map cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The map cannot be written. What was there before is still there.
    #[error("the map {path} cannot be written: {problem}; what was there before is unchanged")]
    Write {
        /// The path.
        path: PathBuf,
        /// What failed.
        problem: WriteProblem,
    },
}

/// What is wrong with the files of a map.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Damage {
    /// The list of the map's files is unusable.
    #[error("its {file} cannot be understood ({reason})")]
    Manifest {
        /// Name of the file.
        file: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// A file is not there.
    #[error("the file {file} is missing")]
    MissingFile {
        /// Its path in the folder of the map.
        file: String,
    },
    /// A file is shorter or longer than it was written.
    #[error("the file {file} has {found} bytes, {expected} were written")]
    Length {
        /// Its path in the folder of the map.
        file: String,
        /// Its bytes.
        found: u64,
        /// The bytes that were written.
        expected: u64,
    },
    /// A file has other bytes than were written.
    #[error("the bytes of the file {file} have changed since it was written (in the segment at byte {at})")]
    Checksum {
        /// Its path in the folder of the map.
        file: String,
        /// Where the segment begins.
        at: u64,
    },
    /// What was written is no segment of a map.
    #[error("the segment at byte {at} of the file {file} cannot be read ({problem})")]
    Segment {
        /// Its path in the folder of the map.
        file: String,
        /// Where the segment begins.
        at: u64,
        /// What is wrong with it.
        problem: SegmentError,
    },
}

/// Why a map cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteProblem {
    /// A file or folder cannot be written, for example because the disk is full.
    #[error("{file}: {source}")]
    File {
        /// The file or folder.
        file: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// An element of the map cannot be stored.
    #[error("a record: {0}")]
    Record(RecordError),
    /// What the map states as a whole is longer than any that is read, nearly all of it the ledger of its sessions.
    #[error(
        "its manifest, with the ledger of its {sessions} sessions, would have {bytes} bytes, more than the {most} that can be read. A map takes \
         about 80,000 sessions: build it anew from recent recordings (driftless build-map), and let robots record longer ones \
         (onboard --hand-in-minutes)"
    )]
    LongLedger {
        /// How many the ledger has.
        sessions: usize,
        /// Bytes that the manifest would have.
        bytes: u64,
        /// The limit.
        most: u64,
    },
}
