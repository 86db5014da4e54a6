//! Writing a map: beside the present one, read back, and made the map in one step.

use std::fs::{File, TryLockError};
use std::path::Path;

use super::files;
use super::manifest::{Manifest, VERSION_FOLDER, folder_of, sync_folder};
use super::reading::open_version;
use super::{Kind, LOCK, Seen, entries, kind_of};
use crate::contents::MapContents;
use crate::store::error::{StoreError, WriteProblem};
use crate::store::map_store::MapStore;
use crate::store::stored_map::SavedMap;
use crate::store::{STORE_SCHEMA, guarded};
use protocol::MapIdentity;

/// Writes a map into a folder, see [`crate::store::save_map`].
///
/// # Arguments
/// * `contents`: valid and sorted.
/// * `seen`: what must still be there.
pub(in crate::store) fn write(
    map: &Path,
    mut contents: MapContents,
    replace: bool,
    seen: Option<&Seen>,
    store: &'static dyn MapStore,
) -> Result<SavedMap, StoreError> {
    let write_failed = |file: &Path, source| StoreError::Write {
        path: map.to_owned(),
        problem: WriteProblem::File { file: file.to_owned(), source },
    };
    ensure_free(map, replace)?;
    let is_new = !map.exists();
    std::fs::create_dir_all(map).map_err(|source| write_failed(map, source))?;
    if let Some(parent) = map.parent().filter(|parent| is_new && !parent.as_os_str().is_empty()) {
        sync_folder(parent).map_err(|source| write_failed(parent, source))?;
    }
    let _lock = Lock::take(map)?;
    // Another program may have completed a map until the lock was free.
    ensure_free(map, replace)?;
    let found = Seen::at(map)?;
    if let Some(seen) = seen.filter(|seen| **seen != found) {
        let (seen, found) = (seen.version(), found.version());
        return Err(StoreError::Changed { path: map.to_owned(), seen, found });
    }

    let digest = contents.digest();
    let present = Present::of(map);
    let identity = present.identity.unwrap_or(digest);
    contents.info.version = present.version + 1;
    contents.info.identity = Some(identity);
    let version = contents.info.version;
    // A folder of that name was left by a program that was stopped.
    let folder = map.join(folder_of(version));
    let manifest = Manifest {
        schema: STORE_SCHEMA,
        folder: folder_of(version),
        version,
        identity,
        digest,
        files: Vec::new(),
    };
    if let Err(error) = write_version(map, &folder, manifest, &contents, store) {
        // What it left is no map, and is removed before the next one is written.
        let _ = std::fs::remove_dir_all(&folder);
        return Err(error);
    }
    remove_all_but(map, &folder_of(version));
    Ok(SavedMap { version, identity })
}

/// Refuses to write over something that must stay.
pub(in crate::store) fn ensure_free(map: &Path, replace: bool) -> Result<(), StoreError> {
    let path = || map.to_owned();
    match kind_of(map) {
        Ok(Kind::Missing | Kind::Empty | Kind::Unfinished) => Ok(()),
        Ok(Kind::Other(problem)) if replace => Err(StoreError::NotAMap { path: path(), problem }),
        // A map whose manifest is damaged is a map that can be replaced.
        Ok(Kind::Complete(_)) | Err(StoreError::Damaged { .. }) if replace => Ok(()),
        Ok(_) | Err(StoreError::Damaged { .. }) => Err(StoreError::Exists { path: path() }),
        Err(error) => Err(error),
    }
}

/// The map that is replaced.
struct Present {
    /// 0 where there is none.
    version: u64,
    /// `None`: there is no map, or its identity cannot be read.
    identity: Option<MapIdentity>,
}

impl Present {
    fn of(map: &Path) -> Present {
        match kind_of(map) {
            Ok(Kind::Complete(manifest)) => {
                Present { version: manifest.version, identity: Some(manifest.identity) }
            }
            // The number of a version must not come again: robots would take the new map for the old one.
            Err(StoreError::Damaged { .. }) => {
                let names = entries(map).unwrap_or_default();
                let numbers = names.iter().filter_map(|name| name.strip_prefix(VERSION_FOLDER)?.parse().ok());
                Present { version: numbers.max().unwrap_or(0), identity: None }
            }
            _ => Present { version: 0, identity: None },
        }
    }
}

fn write_version(
    map: &Path,
    folder: &Path,
    mut manifest: Manifest,
    contents: &MapContents,
    store: &dyn MapStore,
) -> Result<(), StoreError> {
    let failed = |problem| StoreError::Write { path: map.to_owned(), problem };
    let file_failed = |source| failed(WriteProblem::File { file: folder.to_owned(), source });
    match std::fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(file_failed(error)),
        _ => {}
    }
    std::fs::create_dir(folder).map_err(file_failed)?;
    let written = guarded::call(|| store.write(folder, contents)).and_then(|result| result);
    written.map_err(|error| failed(WriteProblem::Database(error)))?;
    manifest.files = files::sums(folder).map_err(file_failed)?;
    // Databases have acknowledged what a full disk did not take.
    open_version(map, &manifest, store)
        .and_then(|(_, landmarks)| landmarks.close())
        .map_err(|error| failed(WriteProblem::NotReadBack(Box::new(error))))?;
    manifest.publish(map).map_err(failed)
}

/// Removes older versions. What cannot be removed takes space until the next version.
fn remove_all_but(map: &Path, folder: &str) {
    for name in entries(map).unwrap_or_default() {
        let path = map.join(&name);
        if !name.starts_with(VERSION_FOLDER) || name == folder {
            continue;
        }
        if let Err(error) = std::fs::remove_dir_all(&path) {
            tracing::warn!(path = %path.display(), "a former version of the map was not removed: {error}");
        }
    }
}

/// Lets one program at a time write a map; released when it is dropped, and when the program ends.
struct Lock {
    file: File,
}

impl Drop for Lock {
    fn drop(&mut self) {
        // Closing is not enough: a child process that was just started has the file open until it runs its program.
        let _ = self.file.unlock();
    }
}

impl Lock {
    fn take(map: &Path) -> Result<Lock, StoreError> {
        let path = map.join(LOCK);
        let failed = |source| StoreError::Write {
            path: map.to_owned(),
            problem: WriteProblem::File { file: path.clone(), source },
        };
        let file = File::options().create(true).truncate(false).write(true).open(&path).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => Ok(Lock { file }),
            Err(TryLockError::WouldBlock) => Err(StoreError::InUse { path: map.to_owned() }),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_that_a_child_process_has_open_is_free_once_it_is_released() {
        let map = tempfile::tempdir().unwrap();
        let lock = Lock::take(map.path()).unwrap();
        assert!(matches!(Lock::take(map.path()), Err(StoreError::InUse { .. })));
        let of_child = lock.file.try_clone().unwrap();
        drop(lock);
        Lock::take(map.path()).unwrap();
        drop(of_child);
    }
}
