//! Reading files of weights with their checksums.

use super::{MAX_WEIGHTS_BYTES, WeightsFile};
use crate::features::state_dict::{StateDict, StateDictError};
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
    /// Only the file of an earlier version is there.
    #[error("{} is missing, and {} is no longer read; make it with `{command}`", path.display(), old.display())]
    Unconverted {
        /// The missing file.
        path: PathBuf,
        /// The old file.
        old: PathBuf,
        /// The command that makes the new one.
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
        source: Box<StateDictError>,
        /// The command that fetches it.
        command: &'static str,
    },
}

impl WeightsError {
    fn unusable(path: &Path, file: &WeightsFile, error: StateDictError) -> Self {
        Self::Unusable { path: path.to_path_buf(), source: Box::new(error), command: file.command }
    }
}

/// Makes something of the weights of a file in a folder.
///
/// # Errors
/// [`WeightsError`]: the file is missing, damaged, or does not hold the weights that `make` needs.
pub(crate) fn open<T>(
    folder: &Path,
    file: &WeightsFile,
    make: impl Fn(&StateDict) -> Result<T, StateDictError>,
) -> Result<T, WeightsError> {
    let path = folder.join(file.file);
    let state = StateDict::read(&read_checked(&path, file)?);
    state.and_then(|state| make(&state)).map_err(|error| WeightsError::unusable(&path, file, error))
}

/// Reads a file of weights and checks its SHA-256 against the known one, or against its checksum file if there is one.
fn read_checked(path: &Path, file: &WeightsFile) -> Result<Vec<u8>, WeightsError> {
    let bytes = files::read(path, MAX_WEIGHTS_BYTES).map_err(|source| {
        let (path, old) = (path.to_path_buf(), path.with_extension(file.old_extension));
        if source.kind() == std::io::ErrorKind::NotFound && old.exists() {
            return WeightsError::Unconverted { path, old, command: file.command };
        }
        WeightsError::Unreadable { name: file.name, path, source, command: file.command }
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
