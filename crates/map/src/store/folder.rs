//! What a folder holds.

use std::io::ErrorKind;
use std::path::Path;

use protocol::MapIdentity;

use super::error::{Damage, StoreError};

use crate::file::manifest::{EXTENDED_STORE_SCHEMA, Manifest, ManifestError};

/// Its name in the folder of a map.
pub(super) const MANIFEST: &str = "manifest.json";
/// Its name while it is written, that of [`files::write_whole`].
const NEW_MANIFEST: &str = "manifest.json.unfinished";
/// Held by the program that writes.
pub(super) const LOCK: &str = "lock";
/// How the names of the files of versions begin and end.
const VERSION: [&str; 2] = ["version-", ".segments"];
/// A manifest lists a segment for some megabytes of map, and the sessions of its ledger, some 800 bytes each.
pub(super) const MAX_MANIFEST_BYTES: u64 = 64 << 20;

/// Name of the file of a version.
pub(super) fn file_of(version: u64) -> String {
    let [begin, end] = VERSION;
    format!("{begin}{version}{end}")
}

/// The version whose file has a name.
pub(super) fn version_of(name: &str) -> Option<u64> {
    let [begin, end] = VERSION;
    name.strip_prefix(begin)?.strip_suffix(end)?.parse().ok()
}

/// What a folder holds.
pub(super) enum Kind {
    Missing,
    /// An empty folder.
    Empty,
    /// Something that was begun and not completed.
    Unfinished,
    Complete(Box<Manifest>),
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
        identity: Option<MapIdentity>,
        digest: MapIdentity,
    },
}

impl Seen {
    /// What is there now; a damaged map counts as none.
    pub(super) fn at(map: &Path) -> Result<Seen, StoreError> {
        match kind_of(map) {
            Ok(Kind::Complete(manifest)) => Ok(Seen::Version {
                version: manifest.map.version,
                identity: manifest.map.identity,
                digest: manifest.digest,
            }),
            Ok(_) | Err(StoreError::Damaged { .. }) => Ok(Seen::Nothing),
            Err(error) => Err(error),
        }
    }

    /// Of the map that is there, where it states one.
    pub(super) fn identity(&self) -> Option<MapIdentity> {
        match self {
            Seen::Nothing => None,
            Seen::Version { identity, .. } => *identity,
        }
    }

    /// 0 for none.
    pub(super) fn version(&self) -> u64 {
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
pub(super) fn kind_of(map: &Path) -> Result<Kind, StoreError> {
    let failed = |source| StoreError::Read { path: map.to_owned(), source };
    match std::fs::metadata(map) {
        Ok(metadata) if metadata.is_dir() => {}
        Ok(_) => return Ok(Kind::Other("it is not a folder")),
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Kind::Missing),
        Err(source) => return Err(failed(source)),
    }
    if map.join(MANIFEST).is_file() {
        return read_manifest(map).map(|manifest| Kind::Complete(Box::new(manifest)));
    }
    let names = entries(map).map_err(failed)?;
    if names.is_empty() {
        return Ok(Kind::Empty);
    }
    let begun = |name: &String| [LOCK, NEW_MANIFEST].contains(&name.as_str()) || version_of(name).is_some();
    if names.iter().all(begun) { Ok(Kind::Unfinished) } else { Ok(Kind::Other("it holds other files")) }
}

/// Reads the manifest of a map.
pub(super) fn read_manifest(map: &Path) -> Result<Manifest, StoreError> {
    let damaged = |reason: String| StoreError::Damaged {
        path: map.to_owned(),
        damage: Damage::Manifest { file: MANIFEST, reason },
    };
    let path = map.join(MANIFEST);
    let text = files::read(&path, MAX_MANIFEST_BYTES).map_err(|error| match error.kind() {
        ErrorKind::FileTooLarge => damaged(error.to_string()),
        _ => StoreError::Read { path: path.clone(), source: error },
    })?;
    Manifest::decode(&text).map_err(|error| match error {
        ManifestError::Schema { found } => {
            StoreError::Schema { path: map.to_owned(), found, expected: EXTENDED_STORE_SCHEMA }
        }
        error => damaged(error.to_string()),
    })
}

/// Whether a folder holds a map, finished or not, whole or damaged.
pub fn is_map(path: &Path) -> bool {
    !matches!(kind_of(path), Ok(Kind::Missing | Kind::Empty | Kind::Other(_)))
}

/// Ensures that [`save_map`](super::save_map) would not write over something that must stay: to be asked before a map is built.
///
/// # Errors
/// [`StoreError::Exists`] without `replace`, and with it [`StoreError::NotAMap`]; [`StoreError::Schema`], [`StoreError::Read`].
pub fn ensure_free(path: &Path, replace: bool) -> Result<(), StoreError> {
    match kind_of(path) {
        Ok(Kind::Missing | Kind::Empty | Kind::Unfinished) => Ok(()),
        Ok(Kind::Other(problem)) if replace => Err(StoreError::NotAMap { path: path.to_owned(), problem }),
        // A map whose manifest is damaged is a map that can be replaced.
        Ok(Kind::Complete(_)) | Err(StoreError::Damaged { .. }) if replace => Ok(()),
        Ok(_) | Err(StoreError::Damaged { .. }) => Err(StoreError::Exists { path: path.to_owned() }),
        Err(error) => Err(error),
    }
}

/// The names in a folder.
pub(super) fn entries(folder: &Path) -> std::io::Result<Vec<String>> {
    let name =
        |entry: std::io::Result<std::fs::DirEntry>| Ok(entry?.file_name().to_string_lossy().into_owned());
    std::fs::read_dir(folder)?.map(name).collect()
}
