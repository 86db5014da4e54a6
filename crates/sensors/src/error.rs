//! What can be wrong with a recording, said so that it can be mended.

use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a recording could not be read or written.
#[derive(Debug, Error)]
pub enum SequenceError {
    /// A file that every recording needs is not there.
    #[error("{} is missing: {advice}", path.display())]
    Missing {
        /// The file or folder.
        path: PathBuf,
        /// What to do about it.
        advice: String,
    },
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Its reason.
        source: std::io::Error,
    },
    /// A `sensor.yaml` does not say what it must.
    #[error("{}: {problem}", path.display())]
    Calibration {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// A line of a table is wrong.
    #[error("{}, line {line}: {problem}", path.display())]
    Row {
        /// The file.
        path: PathBuf,
        /// The line, counted from 1.
        line: u64,
        /// What is wrong, and what to do.
        problem: String,
    },
    /// A table has no rows at all.
    #[error("{} holds no rows: {advice}", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
        /// What to do about it.
        advice: String,
    },
}

impl SequenceError {
    /// A file that cannot be read or written.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.to_path_buf(), source }
    }

    /// A calibration that cannot be used.
    pub fn calibration(path: &Path, problem: impl Into<String>) -> Self {
        Self::Calibration { path: path.to_path_buf(), problem: problem.into() }
    }

    /// A file or folder that is needed and not there.
    pub fn missing(path: &Path, advice: impl Into<String>) -> Self {
        Self::Missing { path: path.to_path_buf(), advice: advice.into() }
    }

    /// A table without rows.
    pub fn empty(path: &Path, advice: impl Into<String>) -> Self {
        Self::Empty { path: path.to_path_buf(), advice: advice.into() }
    }
}
