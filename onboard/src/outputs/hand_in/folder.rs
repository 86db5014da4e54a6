//! The folder of sessions: what a killed robot left, how much there is, names.

use hand_in::{HandInError, Session};
use signing::SecretKey;
use std::fs::{File, TryLockError};
use std::io::{Error, Result};
use std::path::{Path, PathBuf};

/// How the name of a session ends.
const FINISHED: &str = "session";
/// How the name of one ends that is being recorded.
const RECORDING: &str = "recording";

/// The files with an extension, in the order of their names.
fn files_with(folder: &Path, extension: &str) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_file() && path.extension().is_some_and(|of| of == extension) {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// Bytes of all sessions in a folder.
pub(super) fn bytes_in(folder: &Path) -> Result<u64> {
    let sessions = files_with(folder, FINISHED)?;
    sessions.iter().map(|path| Ok(path.metadata()?.len())).sum()
}

/// Where the next session of a robot is recorded.
pub(super) fn next_path(folder: &Path, robot: &str, unix_s: u64) -> PathBuf {
    let name = |number: u32| format!("{robot}_{unix_s}_{number}");
    let is_free = |name: &String| {
        let path = |extension| folder.join(format!("{name}.{extension}"));
        !path(RECORDING).exists() && !path(FINISHED).exists()
    };
    let free = (1..u32::MAX).map(name).find(is_free).unwrap_or_else(|| name(0));
    folder.join(free + "." + RECORDING)
}

/// Marks that a session is being recorded; the mark goes with the file, however the program ends.
pub(super) fn lock(path: &Path) -> Result<File> {
    let file = File::options().read(true).open(path)?;
    file.try_lock().map_err(|error| match error {
        TryLockError::Error(error) => error,
        TryLockError::WouldBlock => Error::other("another program records it"),
    })?;
    Ok(file)
}

/// Makes a session of a recording that has ended, with a signature where there is a key.
pub(super) fn finish(path: &Path, key: Option<&SecretKey>) -> Result<PathBuf> {
    if let Some(key) = key {
        hand_in::sign(path, key).map_err(Error::other)?;
    }
    let finished = path.with_extension(FINISHED);
    std::fs::rename(path, &finished)?;
    Ok(finished)
}

/// Makes sessions of what a killed robot left, up to what it had written as a whole.
pub(super) fn recover(folder: &Path, key: Option<&SecretKey>) -> Result<()> {
    for path in files_with(folder, RECORDING)? {
        // Another program may be recording it.
        if lock(&path).is_err() {
            continue;
        }
        match Session::open(&path) {
            Ok(session) if session.recorded.is_some() => {
                let file = File::options().write(true).open(&path)?;
                file.set_len(session.whole_bytes)?;
                file.sync_all()?;
                let finished = finish(&path, key)?;
                tracing::info!("{} was cut off, and has {:.0} s", finished.display(), session.seconds());
            }
            Ok(_) | Err(HandInError::NoHeader { .. } | HandInError::OtherFormat { .. }) => {
                std::fs::remove_file(&path)?;
                tracing::info!("{} was cut off before anything was recorded, and is removed", path.display());
            }
            Err(error) => tracing::warn!(%error, "a session that was cut off is left as it is"),
        }
    }
    Ok(())
}
