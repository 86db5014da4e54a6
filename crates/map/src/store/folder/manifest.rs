//! `manifest.json`: which folder holds the map, and the checksums of its files.
//!
//! It is written last and replaced by renaming, so it names a complete map whenever the program or the machine stops.

use std::fs::File;
use std::io::Write as _;
use std::path::{Component, Path};

use protocol::MapIdentity;
use serde::{Deserialize, Serialize};

use crate::store::STORE_SCHEMA;
use crate::store::error::{Damage, StoreError, WriteProblem};

/// Its name in the folder of a map.
pub(in crate::store) const MANIFEST: &str = "manifest.json";
/// Its name while it is written.
pub(in crate::store) const NEW_MANIFEST: &str = "manifest.json.new";
/// What the names of the folders of versions begin with.
pub(in crate::store) const VERSION_FOLDER: &str = "version-";
/// A manifest lists a few files per megabyte of map.
const MAX_MANIFEST_BYTES: u64 = 64 << 20;

/// A file of a map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::store) struct FileSum {
    /// Relative to the folder of the version, with `/`.
    pub path: String,
    pub bytes: u64,
    /// Hexadecimal.
    pub sha256: String,
}

/// See the module's documentation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::store) struct Manifest {
    /// The layout of the folder and of the database in it.
    pub schema: u16,
    /// Name of the folder of the version.
    pub folder: String,
    pub version: u64,
    pub identity: MapIdentity,
    /// Digest of the map, see [`crate::MapContents::digest`].
    pub digest: MapIdentity,
    pub files: Vec<FileSum>,
}

impl Manifest {
    /// Reads the manifest of a map.
    pub(in crate::store) fn read(map: &Path) -> Result<Manifest, StoreError> {
        let path = map.join(MANIFEST);
        let damaged = |reason: String| StoreError::Damaged {
            path: map.to_owned(),
            damage: Damage::Manifest { file: MANIFEST, reason },
        };
        let failed = |source| StoreError::Read { path: path.clone(), source };
        let text = files::read(&path, MAX_MANIFEST_BYTES).map_err(|error| match error.kind() {
            std::io::ErrorKind::FileTooLarge => damaged(error.to_string()),
            _ => failed(error),
        })?;
        let value: serde_json::Value =
            serde_json::from_slice(&text).map_err(|error| damaged(error.to_string()))?;
        // Another layout may have other fields.
        let schema = value.get("schema").and_then(serde_json::Value::as_u64);
        if let Some(found) =
            schema.and_then(|schema| u16::try_from(schema).ok()).filter(|&found| found != STORE_SCHEMA)
        {
            return Err(StoreError::Schema { path: map.to_owned(), found, expected: STORE_SCHEMA });
        }
        let manifest: Manifest = serde_json::from_value(value).map_err(|error| damaged(error.to_string()))?;
        let names = manifest.files.iter().map(|file| &file.path).chain([&manifest.folder]);
        if let Some(name) = names.into_iter().find(|name| !is_inside(name)) {
            return Err(damaged(format!("it names the file {name:?}")));
        }
        // The next version is written beside this one, and must not be taken for it.
        let (folder, version) = (&manifest.folder, manifest.version);
        if *folder != folder_of(version) || version == u64::MAX {
            return Err(damaged(format!("it names the folder {folder:?} for version {version}")));
        }
        Ok(manifest)
    }

    /// Makes this the manifest of a map: from then on, its readers see this version.
    pub(in crate::store) fn publish(&self, map: &Path) -> Result<(), WriteProblem> {
        let (new, path) = (map.join(NEW_MANIFEST), map.join(MANIFEST));
        let failed = |source| WriteProblem::File { file: path.clone(), source };
        let mut text = serde_json::to_vec_pretty(self).map_err(|error| failed(error.into()))?;
        text.push(b'\n');
        let mut file = File::create(&new).map_err(failed)?;
        file.write_all(&text).and_then(|()| file.sync_all()).map_err(failed)?;
        drop(file);
        for folder in [&map.join(&self.folder), map] {
            sync_folder(folder).map_err(failed)?;
        }
        std::fs::rename(&new, &path).map_err(failed)?;
        // From here on the new version is the map, whatever happens.
        if let Err(error) = sync_folder(map) {
            tracing::warn!(map = %map.display(), "the new version may be lost if the power fails now: {error}");
        }
        Ok(())
    }

    /// Bytes of all files.
    pub(in crate::store) fn bytes(&self) -> u64 {
        self.files.iter().map(|file| file.bytes).fold(0, u64::saturating_add)
    }
}

/// Whether a relative path stays in its folder.
fn is_inside(path: &str) -> bool {
    !path.is_empty() && Path::new(path).components().all(|part| matches!(part, Component::Normal(_)))
}

/// Name of the folder of a version.
pub(in crate::store) fn folder_of(version: u64) -> String {
    format!("{VERSION_FOLDER}{version}")
}

/// Waits until the names in a folder are on the disk.
pub(in crate::store) fn sync_folder(folder: &Path) -> std::io::Result<()> {
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}
