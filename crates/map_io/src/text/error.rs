//! What can be wrong with a map in plain text: always the file, the line where it is known, and what to do.

use std::path::{Path, PathBuf};

/// Why a plain-text map could not be read or written. The reason is part of each message, so there is no source.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MapFileError {
    /// A file or folder could not be read.
    #[error("cannot read {}: {reason}; {remedy}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        reason: std::io::Error,
        /// What to do.
        remedy: String,
    },
    /// A file or folder could not be written.
    #[error("cannot write {}: {reason}; check the folder's rights and free space", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        reason: std::io::Error,
    },
    /// The camera's calibration is missing or unusable.
    #[error(transparent)]
    Camera(#[from] calibration::CalibrationError),
    /// One line is unusable.
    #[error("{}, line {line}: {problem}; {remedy}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// What is wrong.
        problem: String,
        /// What to do.
        remedy: String,
    },
    /// A file as a whole is unusable.
    #[error("{}: {problem}; {remedy}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
        /// What to do.
        remedy: String,
    },
    /// The folder already holds files of a map.
    #[error("{} already holds a map ({file}); choose another folder, or empty this one", path.display())]
    Occupied {
        /// The folder.
        path: PathBuf,
        /// The file that is in the way.
        file: String,
    },
    /// Every line can be read, but together they are no valid map.
    #[error("{}: {reason}; correct the named record and import again", path.display())]
    Contents {
        /// The folder.
        path: PathBuf,
        /// The invariant that is violated.
        reason: map::contents::ContentsError,
    },
}

impl MapFileError {
    /// A [`MapFileError::Line`].
    pub(super) fn line(
        path: &Path,
        line: usize,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> MapFileError {
        MapFileError::Line { path: path.to_owned(), line, problem: problem.into(), remedy: remedy.into() }
    }

    /// A [`MapFileError::File`].
    pub(super) fn file(path: &Path, problem: impl Into<String>, remedy: impl Into<String>) -> MapFileError {
        MapFileError::File { path: path.to_owned(), problem: problem.into(), remedy: remedy.into() }
    }
}
