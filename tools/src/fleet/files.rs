//! Files of a fleet: private ones are readable by their owner only, and whatever is written is there as a whole or not at all.

use super::error::FleetError;
use std::path::Path;

fn failed(path: &Path) -> impl FnOnce(std::io::Error) -> FleetError {
    let path = path.to_owned();
    move |problem| match problem.kind() {
        std::io::ErrorKind::AlreadyExists => FleetError::Exists { path },
        _ => FleetError::File { path, problem },
    }
}

pub(super) fn write(path: &Path, text: &str) -> Result<(), FleetError> {
    files::write_whole(path, text.as_bytes()).map_err(failed(path))
}

/// Mode 0600 where there are modes.
pub(super) fn write_secret(path: &Path, text: &str) -> Result<(), FleetError> {
    files::write_whole_secret(path, text.as_bytes()).map_err(failed(path))
}

/// Makes a folder with all that `fill` writes, or none.
pub(super) fn create_folder(
    path: &Path,
    fill: impl FnOnce(&Path) -> Result<(), FleetError>,
) -> Result<(), FleetError> {
    files::create_whole_folder(path, |inside| fill(inside).map_err(Filling::Fleet)).map_err(|error| {
        match error {
            Filling::Fleet(error) => error,
            Filling::Folder(error) => failed(path)(error),
        }
    })
}

/// Why a folder was not made.
enum Filling {
    Fleet(FleetError),
    Folder(std::io::Error),
}

impl From<std::io::Error> for Filling {
    fn from(error: std::io::Error) -> Self {
        Self::Folder(error)
    }
}

pub(super) fn remove_folder(path: &Path) -> Result<(), FleetError> {
    std::fs::remove_dir_all(path).map_err(failed(path))
}

pub(super) fn read(path: &Path) -> Result<String, FleetError> {
    files::read_to_string(path).map_err(failed(path))
}
