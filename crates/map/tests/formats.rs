//! A file of every released format is read. Nothing is released yet: it is the one that is written today.

use std::path::{Path, PathBuf};

use map::{MapContents, store};
use testing::{Place, PlaceOptions, add_aliases, add_common_errors};

/// Set to write the file again, for a format that was not released.
const UPDATE: &str = "UPDATE";

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// A map with something in every table.
fn everything() -> MapContents {
    let mut contents =
        Place::new(&PlaceOptions { keyframes: 4, landmarks: 12, ..PlaceOptions::default() }).map;
    add_common_errors(&mut contents, 2);
    add_aliases(&mut contents);
    contents.ensure_sessions("drive_1");
    contents
}

#[test]
fn a_map_of_schema_9_is_read() {
    let path = file("schema_9.db");
    if std::env::var_os(UPDATE).is_some() {
        let _ = std::fs::remove_dir_all(&path);
        store::save_map(&path, &everything(), false).unwrap();
        std::fs::remove_file(path.join("lock")).unwrap();
    }
    let read = store::load_map(&path).unwrap().contents;
    assert_eq!((read.info.name.as_str(), read.info.version), ("place", 1));
    assert_eq!((read.keyframes.len(), read.cross_covariances.len()), (4, 3));
    assert_eq!((read.common_errors.len(), read.aliases.len()), (4, 4));
    assert!(!read.landmarks.is_empty() && read.observation_count() > read.landmarks.len());
    assert!(read.common_errors.iter().all(|common| common.factor.ncols() == 2));
    assert_eq!(read.keyframes[0].camera, testing::camera());
    assert_eq!((read.info.sessions.len(), read.info.sessions[0].keyframes), (1, 4));
    assert!(read.audit_sessions().is_empty());
    read.validate().unwrap();
}
