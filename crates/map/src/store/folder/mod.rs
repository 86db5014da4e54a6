//! The folder of a map.
//!
//! ```text
//! manifest.json    which version is the map, and the SHA-256 of its files; written last
//! version-7/       the database of version 7
//! lock             held by the program that writes
//! ```
//! A new version is written beside the present one, read back, and made the map by renaming the manifest over the old one;
//! then the old version is removed. A folder without a manifest is unfinished: nobody reads it, and the next map that is
//! written to it replaces it. Reading writes nothing into the folder.

mod files;
mod manifest;
mod reading;
mod writing;

use std::path::Path;

use protocol::MapIdentity;

use super::error::StoreError;
use manifest::{MANIFEST, Manifest, NEW_MANIFEST, VERSION_FOLDER};
pub(super) use reading::{TemporaryCopy, open, read};
pub(super) use writing::{ensure_free, write};

/// Held by the program that writes.
const LOCK: &str = "lock";

/// What a folder holds.
enum Kind {
    Missing,
    /// An empty folder.
    Empty,
    /// Something that was begun and not completed.
    Unfinished,
    Complete(Manifest),
    /// No map.
    Other(&'static str),
}

/// Which version of a map a folder has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Seen {
    /// None that a manifest names.
    Nothing,
    Version {
        version: u64,
        identity: MapIdentity,
        digest: MapIdentity,
    },
}

impl Seen {
    /// What is there now; a damaged map counts as none.
    pub(super) fn at(map: &Path) -> Result<Seen, StoreError> {
        match kind_of(map) {
            Ok(Kind::Complete(Manifest { version, identity, digest, .. })) => {
                Ok(Seen::Version { version, identity, digest })
            }
            Ok(_) | Err(StoreError::Damaged { .. }) => Ok(Seen::Nothing),
            Err(error) => Err(error),
        }
    }

    /// 0 for none.
    fn version(&self) -> u64 {
        match self {
            Seen::Nothing => 0,
            Seen::Version { version, .. } => *version,
        }
    }
}

/// What a folder holds.
///
/// # Errors
/// [`StoreError::Read`], and those of a manifest that cannot be understood.
fn kind_of(map: &Path) -> Result<Kind, StoreError> {
    let failed = |source| StoreError::Read { path: map.to_owned(), source };
    match std::fs::metadata(map) {
        Ok(metadata) if metadata.is_dir() => {}
        Ok(_) => return Ok(Kind::Other("it is not a folder")),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Kind::Missing),
        Err(source) => return Err(failed(source)),
    }
    if map.join(MANIFEST).is_file() {
        return Manifest::read(map).map(Kind::Complete);
    }
    let names = entries(map).map_err(failed)?;
    if names.is_empty() {
        return Ok(Kind::Empty);
    }
    if map.join("conf").is_file() && map.join("db").is_file() {
        return Ok(Kind::Other("it is a database without a manifest; give the folder around it"));
    }
    let begun = |name: &String| *name == LOCK || *name == NEW_MANIFEST || name.starts_with(VERSION_FOLDER);
    if names.iter().all(begun) { Ok(Kind::Unfinished) } else { Ok(Kind::Other("it holds no database")) }
}

/// Whether a folder holds a map, or something that was to be one.
pub(super) fn is_map(map: &Path) -> bool {
    !matches!(kind_of(map), Ok(Kind::Missing | Kind::Empty | Kind::Other(_)))
}

/// The names in a folder.
fn entries(folder: &Path) -> std::io::Result<Vec<String>> {
    let name =
        |entry: std::io::Result<std::fs::DirEntry>| Ok(entry?.file_name().to_string_lossy().into_owned());
    std::fs::read_dir(folder)?.map(name).collect()
}
