//! Reading files of weights: the right file or an error that says how to get it.

use crate::features::weights::WeightsFile;
use sha2::{Digest as _, Sha256};
use std::path::{Path, PathBuf};

/// Why there are no weights.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// The file is not there, or cannot be read.
    #[error("the weights of {name} cannot be read from {}: {source}; get them with `{command}`", path.display())]
    Unreadable {
        /// The extractor.
        name: &'static str,
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: std::io::Error,
        /// How to get them.
        command: &'static str,
    },
    /// The file is not the right one.
    #[error(
        "{} is not the right file or is damaged (SHA-256 {found}, {needed} is needed); get it again with `{command}`",
        path.display()
    )]
    Checksum {
        /// The file.
        path: PathBuf,
        /// SHA-256 of the file.
        found: String,
        /// SHA-256 of the right file.
        needed: String,
        /// How to get it.
        command: &'static str,
    },
    /// The file holds something else than the weights of this network.
    #[error("{} cannot be used: {reason}; get it again with `{command}`", path.display())]
    Unusable {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
        /// How to get it.
        command: &'static str,
    },
}

impl WeightsError {
    pub(super) fn unusable(path: &Path, file: &WeightsFile, reason: String) -> Self {
        Self::Unusable { path: path.to_path_buf(), reason, command: file.command }
    }
}

/// Reads a file of weights and checks its SHA-256: against the known one, or else against the one beside it, where
/// there is one.
pub(super) fn read_checked(path: &Path, file: &WeightsFile) -> Result<Vec<u8>, WeightsError> {
    let bytes = std::fs::read(path).map_err(|source| {
        let (path, command) = (path.to_path_buf(), file.command);
        WeightsError::Unreadable { name: file.name, path, source, command }
    })?;
    let beside = || {
        let text = std::fs::read_to_string(WeightsFile::checksum_path(path)).ok()?;
        text.split_whitespace().next().map(str::to_owned)
    };
    if let Some(needed) = file.sha256.map(str::to_owned).or_else(beside) {
        let found = hexadecimal(&Sha256::digest(&bytes));
        if found != needed {
            return Err(WeightsError::Checksum {
                path: path.to_path_buf(),
                found,
                needed,
                command: file.command,
            });
        }
    }
    Ok(bytes)
}

fn hexadecimal(bytes: &[u8]) -> String {
    let digit = |number: u8| char::from_digit(number.into(), 16).unwrap_or_default();
    bytes.iter().flat_map(|byte| [digit(byte >> 4), digit(byte & 15)]).collect()
}
