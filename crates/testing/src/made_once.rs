//! What many tests need, made by the first of them.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

/// A folder that is made by the first test that needs it, and again when a program has been built anew: where each test is a process of
/// its own, a static would be made by each. Nobody may change what is in it.
///
/// # Arguments
/// * `programs`: what it depends on, besides the program of the tests.
/// * `make`: fills an empty folder.
///
/// # Returns
/// The folder, in that of the build.
pub fn made_once(name: &str, programs: &[&Path], make: impl FnOnce(&Path)) -> PathBuf {
    let own = std::env::current_exe().unwrap();
    let built = |path: &Path| -> Duration {
        fs::metadata(path).unwrap().modified().unwrap().duration_since(UNIX_EPOCH).unwrap()
    };
    let newest = programs.iter().map(|path| built(path)).fold(built(&own), Duration::max);
    let all = own.ancestors().nth(2).unwrap().join("made-once");
    let of_any_build = format!("{name}-{}-", own.file_stem().unwrap().to_string_lossy());
    let made = all.join(format!("{of_any_build}{}", newest.as_nanos()));
    if made.exists() {
        return made;
    }
    fs::create_dir_all(&all).unwrap();
    // Others that need it meanwhile wait for it.
    let lock = fs::File::create(all.join(format!("{of_any_build}lock"))).unwrap();
    lock.lock().unwrap();
    if made.exists() {
        return made;
    }
    for entry in fs::read_dir(&all).unwrap().flatten() {
        if entry.file_name().to_string_lossy().starts_with(&of_any_build) && entry.path().is_dir() {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
    let part = all.join(format!("part-{}-{name}", std::process::id()));
    fs::create_dir_all(&part).unwrap();
    make(&part);
    fs::rename(&part, &made).unwrap();
    made
}
