//! Folders for copies, which are removed whatever happens.
//!
//! A killed program cannot remove anything. Each folder therefore has a file that is locked as long as the program lives that made it;
//! the next one that needs such a folder removes those whose lock is free. The file is the first thing that a folder has and the last
//! that is removed from it, so that a folder is known for what it is whenever its program was killed: it has the file, or it is empty.

use std::fs::File;
use std::io::{ErrorKind, Result};
use std::path::{Path, PathBuf};

/// How the names of all folders begin.
const PREFIX: &str = "driftless-";
/// How many letters and digits follow.
const RANDOM: usize = 6;
/// File in a folder that is locked while it is in use.
const LOCK: &str = ".in-use";
/// How often a folder is made again that was taken for an abandoned one before its file was locked.
const ATTEMPTS: usize = 100;

/// A folder in the temporary folder (`TMPDIR`) that is removed with this value.
#[derive(Debug)]
pub struct TemporaryFolder {
    path: PathBuf,
    /// Locked as long as the folder is in use.
    lock: File,
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
        for _ in 0..ATTEMPTS {
            let path = tempfile::Builder::new().prefix(PREFIX).rand_bytes(RANDOM).tempdir_in(parent)?.keep();
            if let Some(lock) = lock(&path)? {
                return Ok(TemporaryFolder { path, lock });
            }
        }
        Err(std::io::Error::other("other programs remove each temporary folder as soon as it is made"))
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        if let Err(error) = remove(&self.path) {
            tracing::debug!(path = %self.path.display(), "not removed: {error}");
        }
        let _ = self.lock.unlock();
    }
}

/// Locks the file of a new folder; none if another program took the folder for an abandoned one and removed it.
fn lock(folder: &Path) -> Result<Option<File>> {
    let path = folder.join(LOCK);
    let file = match File::create(&path) {
        Ok(file) => file,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error),
    };
    file.lock()?;
    Ok(path.try_exists()?.then_some(file))
}

/// Removes the folders whose programs ended without removing them.
fn remove_abandoned(parent: &Path) {
    let Ok(entries) = std::fs::read_dir(parent) else { return };
    for entry in entries.flatten() {
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if !is_folder || !is_ours(&entry.file_name().to_string_lossy()) {
            continue;
        }
        let path = entry.path();
        let removed = match crate::open(path.join(LOCK)) {
            // The lock is held until the folder is gone.
            Ok(file) => file.try_lock_shared().map_err(Into::into).and_then(|()| remove(&path)),
            // Killed before the file was made, or after it was removed; a folder of somebody else that has anything in it stays.
            Err(error) if error.kind() == ErrorKind::NotFound => std::fs::remove_dir(&path),
            Err(error) => Err(error),
        };
        match removed {
            Ok(()) => tracing::info!(path = %path.display(), "removed what a killed program left"),
            // It is in use, another program removes it, or it is of another user.
            Err(error) => tracing::debug!(path = %path.display(), "not removed: {error}"),
        }
    }
}

/// Whether a folder has a name like those made here.
fn is_ours(name: &str) -> bool {
    name.strip_prefix(PREFIX)
        .is_some_and(|rest| rest.len() == RANDOM && rest.bytes().all(|byte| byte.is_ascii_alphanumeric()))
}

/// Removes a folder, its lock last.
fn remove(folder: &Path) -> Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_name() == LOCK {
            continue;
        }
        if entry.file_type()?.is_dir() {
            std::fs::remove_dir_all(entry.path())?;
        } else {
            std::fs::remove_file(entry.path())?;
        }
    }
    std::fs::remove_file(folder.join(LOCK))?;
    std::fs::remove_dir(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Leaves a folder as a killed program does, whose locks are free.
    fn kill(folder: TemporaryFolder) -> PathBuf {
        let left = folder.path().to_owned();
        let held = std::mem::ManuallyDrop::new(folder);
        File::unlock(&held.lock).unwrap();
        left
    }

    #[test]
    fn what_a_killed_program_left_is_removed_and_what_is_in_use_stays() {
        let parent = tempfile::tempdir().unwrap();
        let killed = TemporaryFolder::new_in(parent.path()).unwrap();
        std::fs::create_dir(killed.path().join("copy")).unwrap();
        std::fs::write(killed.path().join("copy/file"), "a map").unwrap();
        std::fs::write(killed.path().join("download"), "a map").unwrap();
        let left = kill(killed);
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

    #[test]
    fn a_program_may_be_killed_while_it_makes_or_removes_a_folder() {
        let parent = tempfile::tempdir().unwrap();
        // Before the file is made or after it is removed, before it is locked, and with the file as the last thing.
        let empty = parent.path().join("driftless-aB3dE6");
        let unlocked = parent.path().join("driftless-000000");
        for folder in [&empty, &unlocked] {
            std::fs::create_dir(folder).unwrap();
        }
        File::create(unlocked.join(LOCK)).unwrap();
        // Of somebody else, whatever its name.
        let foreign = parent.path().join("driftless-abcdef");
        std::fs::create_dir(&foreign).unwrap();
        std::fs::write(foreign.join("file"), "not ours").unwrap();
        let made = TemporaryFolder::new_in(parent.path()).unwrap();
        assert!(!empty.exists() && !unlocked.exists());
        assert!(made.path().exists() && foreign.exists());
    }

    #[test]
    fn a_folder_that_others_take_for_abandoned_is_made_again() {
        let parent = tempfile::tempdir().unwrap();
        std::thread::scope(|threads| {
            for _ in 0..8 {
                threads.spawn(|| {
                    for _ in 0..50 {
                        let made = TemporaryFolder::new_in(parent.path()).unwrap();
                        std::fs::write(made.path().join("file"), "mine").unwrap();
                        assert_eq!(std::fs::read(made.path().join("file")).unwrap(), b"mine");
                    }
                });
            }
        });
        assert_eq!(std::fs::read_dir(parent.path()).unwrap().count(), 0);
    }
}
