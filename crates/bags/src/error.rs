//! Errors of recordings.

use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a recording, or a message of it, could not be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum BagError {
    /// The operating system reports an error.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error.
        source: std::io::Error,
    },
    /// The file is of no format that is read here.
    #[error("{} is no recording, or its beginning is damaged: an MCAP, a rosbag1 (.bag), a rosbag2 (.db3, or its folder) is needed", path.display())]
    UnknownFormat {
        /// The file or folder.
        path: PathBuf,
    },
    /// The file is of a known format and cannot be used.
    #[error("{}: {problem}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// SQLite reports an error.
    #[error("{}: {source}", path.display())]
    Sqlite {
        /// The file.
        path: PathBuf,
        /// The error.
        source: rusqlite::Error,
    },
    /// A message is damaged.
    #[error("{}: the message at {} is damaged: {problem}", path.display(), position)]
    Message {
        /// The file.
        path: PathBuf,
        /// Its position: byte of the file or of its chunk, or row of the table.
        position: u64,
        /// What is wrong.
        problem: String,
    },
}

impl BagError {
    pub(crate) fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.to_path_buf(), source }
    }

    pub(crate) fn invalid(path: &Path, problem: impl Into<String>) -> Self {
        Self::Invalid { path: path.to_path_buf(), problem: problem.into() }
    }

    pub(crate) fn sqlite(path: &Path, source: rusqlite::Error) -> Self {
        Self::Sqlite { path: path.to_path_buf(), source }
    }

    pub(crate) fn message(path: &Path, position: u64, problem: impl Into<String>) -> Self {
        Self::Message { path: path.to_path_buf(), position, problem: problem.into() }
    }
}
