//! Why a map store could not do what it was asked for.

use std::path::PathBuf;

use super::record::RecordError;
use crate::contents::ContentsError;

/// Why a store could not do what it was asked for.
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
    #[error("{path} exists already: choose another path, or remove it first")]
    Exists {
        /// Where the map should have been created.
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
    /// The map was written by an incompatible version of this program.
    #[error(
        "the map {path} has schema {found}, this program reads schema {expected}: \
         export it with the version that wrote it and import it again"
    )]
    Schema {
        /// The path.
        path: PathBuf,
        /// The number in the store.
        found: u16,
        /// [`super::STORE_SCHEMA`].
        expected: u16,
    },
    /// Another process has the map open.
    #[error("the map {path} is in use by another program (a map_server?): stop it first")]
    InUse {
        /// The path.
        path: PathBuf,
    },
    /// One record cannot be read; all others still can.
    #[error("{record} in the map {path} is damaged: {problem}")]
    Corrupt {
        /// The path.
        path: PathBuf,
        /// Which record, for example `landmark 17`.
        record: String,
        /// What is wrong with it.
        problem: RecordError,
    },
    /// The new contents violate an invariant of maps; nothing was written.
    #[error("the map would become invalid: {0}")]
    Invalid(#[from] ContentsError),
    /// The database under the map failed.
    #[error("the database {path} failed: {source}")]
    Database {
        /// The path.
        path: PathBuf,
        /// The error of the database.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}
