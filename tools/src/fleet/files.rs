//! Files of a fleet: private ones are readable by their owner only, and nothing is overwritten but by renewal.

use super::error::FleetError;
use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::Path;

fn failed(path: &Path) -> impl FnOnce(std::io::Error) -> FleetError {
    let path = path.to_owned();
    move |problem| match problem.kind() {
        std::io::ErrorKind::AlreadyExists => FleetError::Exists { path },
        _ => FleetError::File { path, problem },
    }
}

/// A new file with the permissions of a secret, or the usual ones.
fn create(path: &Path, secret: bool) -> std::io::Result<File> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    if secret {
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    }
    options.open(path)
}

fn write(path: &Path, text: &str, secret: bool) -> Result<(), FleetError> {
    let mut file = create(path, secret).map_err(failed(path))?;
    file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(failed(path))
}

/// Writes beside the present file, then takes its place.
fn write_over(path: &Path, text: &str, secret: bool) -> Result<(), FleetError> {
    let beside = path.with_extension("new");
    // What an interrupted attempt left.
    let _ = std::fs::remove_file(&beside);
    write(&beside, text, secret)?;
    std::fs::rename(&beside, path).map_err(failed(path))
}

pub(super) fn create_folder(path: &Path) -> Result<(), FleetError> {
    std::fs::create_dir_all(path).map_err(failed(path))
}

pub(super) fn write_new(path: &Path, text: &str) -> Result<(), FleetError> {
    write(path, text, false)
}

/// Mode 0600 where there are modes.
pub(super) fn write_secret(path: &Path, text: &str) -> Result<(), FleetError> {
    write(path, text, true)
}

pub(super) fn replace(path: &Path, text: &str) -> Result<(), FleetError> {
    write_over(path, text, false)
}

pub(super) fn replace_secret(path: &Path, text: &str) -> Result<(), FleetError> {
    write_over(path, text, true)
}

pub(super) fn read(path: &Path) -> Result<String, FleetError> {
    std::fs::read_to_string(path).map_err(failed(path))
}
