//! The recordings, which are not part of the repository.

use std::path::{Path, PathBuf};

/// Folder into which the recordings are unpacked.
pub fn data_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/data")
}

/// The folder of a recording.
///
/// # Panics
/// Where it is not unpacked: a test that needs it must not pass without it.
pub fn recording(name: &str) -> PathBuf {
    let folder = data_folder().join(name);
    assert!(
        folder.is_dir(),
        "the recording {name} is missing: there is no {}. docs/src/benchmarks.md says which recordings the tests need",
        folder.display()
    );
    folder
}
