//! Reading files of weights with their checksums.

use super::network::NetworkError;
use crate::features::weights::{MAX_WEIGHTS_BYTES, WeightsFile};
use sha2::{Digest as _, Sha256};
use std::path::{Path, PathBuf};

/// Why weights could not be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WeightsError {
    /// The file is missing or cannot be read.
    #[error("the weights of {name} cannot be read from {}: {source}; get them with `{command}`", path.display())]
    Unreadable {
        /// The extractor.
        name: &'static str,
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
        /// The command that fetches them.
        command: &'static str,
    },
    /// Only the PyTorch file of an earlier version is there.
    #[error("{} is missing, and {} is no longer read; convert it with `{command} --from {}`", path.display(), old.display(), old.display())]
    Unconverted {
        /// The missing file.
        path: PathBuf,
        /// The PyTorch file.
        old: PathBuf,
        /// The command that fetches or converts the weights.
        command: &'static str,
    },
    /// The checksum is wrong.
    #[error(
        "{} is damaged or not the expected file (SHA-256 {found}, {needed} is needed); get it again with `{command}`",
        path.display()
    )]
    Checksum {
        /// The file.
        path: PathBuf,
        /// SHA-256 of the file.
        found: String,
        /// The expected SHA-256.
        needed: String,
        /// The command that fetches it.
        command: &'static str,
    },
    /// The file does not hold the weights of this network.
    #[error("{} cannot be used: {source}; get it again with `{command}`", path.display())]
    Unusable {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: Box<NetworkError>,
        /// The command that fetches it.
        command: &'static str,
    },
}

impl WeightsError {
    pub(super) fn unusable(path: &Path, file: &WeightsFile, error: NetworkError) -> Self {
        Self::Unusable { path: path.to_path_buf(), source: Box::new(error), command: file.command }
    }
}

/// Reads a file of weights and checks its SHA-256 against the known one, or against its checksum file if there is one.
pub(super) fn read_checked(path: &Path, file: &WeightsFile) -> Result<Vec<u8>, WeightsError> {
    let bytes = files::read(path, MAX_WEIGHTS_BYTES).map_err(|source| {
        let (path, old, command) = (path.to_path_buf(), path.with_extension("pt"), file.command);
        if source.kind() == std::io::ErrorKind::NotFound && old.exists() {
            return WeightsError::Unconverted { path, old, command };
        }
        WeightsError::Unreadable { name: file.name, path, source, command }
    })?;
    if let Some(needed) = file.needed_sha256(path) {
        let found = sha256(&bytes);
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

/// The SHA-256 of a file's bytes, hexadecimal.
pub fn sha256(bytes: &[u8]) -> String {
    let digit = |number: u8| char::from_digit(number.into(), 16).unwrap_or_default();
    Sha256::digest(bytes).iter().flat_map(|byte| [digit(byte >> 4), digit(byte & 15)]).collect()
}
