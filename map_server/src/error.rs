//! Why a server does not start, or a map is not replaced.

use std::path::PathBuf;

use protocol::keys::NameError;
use protocol::{CodecError, MapIdentity};
use recognition::LoadError;
use releases::ReleaseError;
use tokio::task::JoinError;
use vision::DescriptorError;

/// Why a server does not start, or a map is not replaced.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// A name cannot be part of a key.
    #[error(transparent)]
    Name(#[from] NameError),
    /// Another server of this name is alive.
    #[error(
        "another map server named {name:?} is alive: give each its own --name (in a secured fleet its own certificate), or stop the \
         other one"
    )]
    NameTaken {
        /// The name.
        name: String,
    },
    /// Two maps have the same name.
    #[error("two maps are to be served as {name:?}: give each its own name")]
    DuplicateMap {
        /// The name.
        name: String,
    },
    /// The system has no threads for the workers.
    #[error(
        "no thread could be started for a worker ({0}): allow the program more threads, or give it fewer --workers"
    )]
    Threads(#[source] std::io::Error),
    /// The server has no map of that name.
    #[error("no map named {name:?} is served here")]
    UnknownMap {
        /// The name.
        name: String,
    },
    /// The version is not newer than the one that is served.
    #[error(
        "version {given} of map {name} is not newer than version {served}, which is served: make it the next version \
         (import-map --force), or restart the server"
    )]
    OldVersion {
        /// Name of the map.
        name: String,
        /// Version that is served.
        served: u64,
        /// Version that was to replace it.
        given: u64,
    },
    /// What is to be served is no version of the map that is served.
    #[error(
        "map {name} is {served}, and {given} is another map: robots would take the poses in one for poses in the other; \
         write it over the served one to make it its next version (--force), or serve it under another name, or restart the \
         server and the robots"
    )]
    OtherMap {
        /// The name under which the map is served.
        name: String,
        /// Identity of the served map.
        served: MapIdentity,
        /// Identity of the other one.
        given: MapIdentity,
    },
    /// A release cannot be read.
    #[error(transparent)]
    Release(#[from] ReleaseError),
    /// Cells that are not in memory cannot be kept on disk.
    #[error(
        "cells cannot be kept in {path}: {source}; choose another folder (--cache), or serve without --memory"
    )]
    ColdFolder {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A cell of a release cannot be indexed.
    #[error(transparent)]
    Load(#[from] LoadError),
    /// The landmarks that tell cells from each other cannot be indexed.
    #[error("the cells of the release cannot be told from each other: {0}")]
    Descriptors(#[from] DescriptorError),
    /// A task of the server panicked.
    #[error("a task of the map server ended badly: {problem}")]
    TaskFailed {
        /// Text of the panic.
        problem: String,
    },
    /// A message cannot be encoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// Zenoh reported an error.
    #[error("Zenoh: {0}")]
    Zenoh(zenoh::Error),
}

impl ServeError {
    pub(crate) fn task(error: &JoinError) -> ServeError {
        ServeError::TaskFailed { problem: error.to_string() }
    }
}

impl From<zenoh::Error> for ServeError {
    fn from(error: zenoh::Error) -> ServeError {
        ServeError::Zenoh(error)
    }
}
