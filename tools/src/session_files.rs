//! Session files that robots hand in.

use anyhow::{Context as _, bail};
use hand_in::{RecordedSoFar, Session};
use map::sessions::{ReadingSamples, Recorded, SessionId};
use std::path::{Path, PathBuf};

/// How the name of a session file ends.
pub const EXTENSION: &str = "session";

/// The identity of a session, as the ledger of a map has it.
pub fn recorded(session: &RecordedSoFar) -> Recorded {
    Recorded {
        id: SessionId::from_bytes(session.id),
        begin_ns: session.begin_ns,
        end_ns: session.end_ns,
        images: session.images,
        readings: session.readings,
        samples: ReadingSamples::of_digests(session.new_samples.clone()),
    }
}

/// A session that a map can be built of: the robot that recorded it, and its identity. `None` for another recording.
///
/// # Errors
/// A session file that cannot be read, or in which nothing was recorded.
pub fn of_recording(path: &Path) -> anyhow::Result<Option<(String, Recorded)>> {
    if !Session::is_session(path) {
        return Ok(None);
    }
    let session = Session::open(path)?;
    let Some(so_far) = &session.recorded else {
        bail!("{} was cut off before anything was recorded: delete it", path.display());
    };
    Ok(Some((session.header.robot.clone(), recorded(so_far))))
}

/// The session files that some paths name: files, and folders of them and of folders of them.
///
/// # Errors
/// A path that cannot be read.
pub fn find(paths: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for path in paths {
        if path.is_dir() {
            add_folder(path, &mut found).with_context(|| format!("{}", path.display()))?;
        } else {
            found.push(path.clone());
        }
    }
    Ok(found)
}

fn add_folder(folder: &Path, found: &mut Vec<PathBuf>) -> std::io::Result<()> {
    let entries = std::fs::read_dir(folder)?.map(|entry| Ok(entry?.path()));
    let mut paths = entries.collect::<std::io::Result<Vec<_>>>()?;
    paths.sort();
    for path in paths {
        if path.is_dir() && !path.is_symlink() {
            add_folder(&path, found)?;
        } else if path.extension().is_some_and(|extension| extension == EXTENSION) {
            found.push(path);
        }
    }
    Ok(())
}
