//! Folders for copies, which are removed whatever happens.
//!
//! A killed program cannot remove anything. Each folder therefore has a file that is locked as long as the program lives that made it;
//! the next one that needs such a folder removes those whose lock is free.

use std::fs::{File, TryLockError};
use std::io::Result;
use std::path::Path;

use tempfile::TempDir;

/// How the names of all folders begin.
const PREFIX: &str = "driftless-";
/// File in a folder that is locked while it is in use.
const LOCK: &str = ".in-use";
/// Name of that file until it is locked.
const NEW_LOCK: &str = ".new";

/// A folder in the temporary folder (`TMPDIR`) that is removed with this value.
#[derive(Debug)]
pub struct TemporaryFolder {
    folder: TempDir,
    /// Locked.
    _lock: File,
}

impl TemporaryFolder {
    /// Makes a folder, and removes those of killed programs.
    ///
    /// # Errors
    /// Those of the file system, for a new folder.
    pub fn new() -> Result<TemporaryFolder> {
        Self::new_in(&std::env::temp_dir())
    }

    /// Makes a folder in another one than the temporary folder.
    ///
    /// # Errors
    /// As of [`TemporaryFolder::new`].
    pub fn new_in(parent: &Path) -> Result<TemporaryFolder> {
        remove_abandoned(parent);
        let folder = tempfile::Builder::new().prefix(PREFIX).tempdir_in(parent)?;
        let new = folder.path().join(NEW_LOCK);
        let lock = File::create(&new)?;
        lock.lock()?;
        // Whoever sees it under its name finds it locked.
        std::fs::rename(&new, folder.path().join(LOCK))?;
        Ok(TemporaryFolder { folder, _lock: lock })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// Removes the folders whose programs ended without removing them.
fn remove_abandoned(parent: &Path) {
    let Ok(entries) = std::fs::read_dir(parent) else { return };
    for entry in entries.flatten() {
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if !is_folder || !entry.file_name().to_string_lossy().starts_with(PREFIX) {
            continue;
        }
        let path = entry.path();
        if is_abandoned(&path) {
            match std::fs::remove_dir_all(&path) {
                Ok(()) => tracing::info!(path = %path.display(), "removed what a killed program left"),
                // Another program removes it, or it is of another user.
                Err(error) => tracing::debug!(path = %path.display(), "not removed: {error}"),
            }
        }
    }
}

/// Whether a folder has a lock that nobody holds. One without is not of these, or was made a moment ago.
fn is_abandoned(folder: &Path) -> bool {
    let Ok(file) = crate::open(folder.join(LOCK)) else { return false };
    !matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock | TryLockError::Error(_)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_killed_program_left_is_removed_and_what_is_in_use_stays() {
        let parent = tempfile::tempdir().unwrap();
        let killed = TemporaryFolder::new_in(parent.path()).unwrap();
        std::fs::write(killed.path().join("copy"), "a map").unwrap();
        let left = killed.path().to_owned();
        // A killed program: its locks are free, its folder is there.
        let TemporaryFolder { folder, _lock: lock } = killed;
        assert_eq!(folder.keep(), left);
        drop(lock);
        let foreign = parent.path().join("driftless-of-somebody-else");
        std::fs::create_dir(&foreign).unwrap();
        let in_use = TemporaryFolder::new_in(parent.path()).unwrap();
        assert!(!left.exists());
        let another = TemporaryFolder::new_in(parent.path()).unwrap();
        assert!(in_use.path().exists() && foreign.exists());
        let paths = [in_use.path().to_owned(), another.path().to_owned()];
        drop((in_use, another));
        assert!(paths.iter().all(|path| !path.exists()));
    }
}
