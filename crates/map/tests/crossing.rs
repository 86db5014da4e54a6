//! Two programs that change one map at once, and folders that are not what they seem.

use map::store::{MapTarget, StoreError, load_map, save_map};
use map::{MapContents, MapMetadata};
use protocol::DescriptorKind;

fn map() -> MapContents {
    MapContents::empty(MapMetadata::new("hall", "test", DescriptorKind::Binary, 32))
}

#[test]
fn a_version_that_was_written_meanwhile_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hall.db");
    let fresh = MapTarget::new(&path, true).unwrap();
    save_map(&path, &map(), false).unwrap();
    let refused = fresh.save(&map()).unwrap_err();
    assert!(matches!(refused, StoreError::Changed { seen: 0, found: 1, .. }), "{refused}");
    for round in 1..20 {
        let targets = [MapTarget::new(&path, true).unwrap(), MapTarget::new(&path, true).unwrap()];
        let results: Vec<_> = std::thread::scope(|scope| {
            let tasks: Vec<_> = targets.iter().map(|target| scope.spawn(|| target.save(&map()))).collect();
            tasks.into_iter().map(|task| task.join().unwrap()).collect()
        });
        let written: Vec<u64> =
            results.iter().filter_map(|result| Some(result.as_ref().ok()?.version)).collect();
        assert_eq!(written, [round + 1], "one of two");
        let refused = results.iter().find_map(|result| result.as_ref().err()).unwrap();
        let is_named = matches!(refused, StoreError::Changed { .. } | StoreError::InUse { .. });
        assert!(is_named, "{refused}");
        assert_eq!(load_map(&path).unwrap().contents.info.version, round + 1);
    }
}

#[cfg(unix)]
#[test]
fn pipes_and_devices_in_the_folder_of_a_map_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hall.db");
    save_map(&path, &map(), false).unwrap();
    let file = path.join("version-1.segments");
    for kind in ["pipe", "device"] {
        std::fs::remove_file(&file).unwrap();
        if kind == "pipe" {
            assert!(std::process::Command::new("mkfifo").arg(&file).status().unwrap().success());
        } else {
            std::os::unix::fs::symlink("/dev/zero", &file).unwrap();
        }
        let error = with_causes(&load_map(&path).unwrap_err());
        assert!(error.contains(kind) && error.contains("version-1.segments"), "{error}");
    }
}

/// An error with its causes.
#[cfg(unix)]
fn with_causes(error: &dyn std::error::Error) -> String {
    std::iter::successors(Some(error), |error| error.source())
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join(": ")
}
