//! What can be wrong with a calibration.

use std::path::{Path, PathBuf};

/// Why a calibration could not be read: always the file, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// A required file does not exist.
    #[error("{} is missing: {advice}", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// What to do about it.
        advice: String,
    },
    /// The operating system reports an error.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error.
        source: std::io::Error,
    },
    /// An entry is missing or wrong, or two contradict each other.
    #[error("{}: {problem}", path.display())]
    Entry {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what to do.
        problem: String,
    },
}

impl CalibrationError {
    /// [`CalibrationError::Entry`] of a file.
    pub fn entry(path: &Path, problem: impl Into<String>) -> Self {
        Self::Entry { path: path.to_path_buf(), problem: problem.into() }
    }
}
