//! A file of every released format is read. Nothing is released yet: they are the two that are written today.

use std::path::{Path, PathBuf};

use map::store::StoredMap;
use map::{EXTENDED_STORE_SCHEMA, MapContents, STORE_SCHEMA, store};
use testing::{Place, PlaceOptions, add_aliases, add_common_errors, add_images, add_second_kind};

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

/// Reads a file, after writing it where that is asked for.
fn read(name: &str, written: &MapContents) -> StoredMap {
    let path = file(name);
    if std::env::var_os(UPDATE).is_some() {
        let _ = std::fs::remove_dir_all(&path);
        store::save_map(&path, written, false).unwrap();
        std::fs::remove_file(path.join("lock")).unwrap();
    }
    store::load_map(&path).unwrap()
}

#[test]
fn a_map_of_schema_10_is_read() {
    let mut written = everything();
    add_second_kind(&mut written, "other-1");
    add_images(&mut written);
    let StoredMap { schema, contents, .. } = read("schema_10.db", &written);
    assert_eq!((schema, contents.keyframes.len()), (EXTENDED_STORE_SCHEMA, 4));
    let [added] = &contents.added_features[..] else { panic!("one kind was added") };
    assert_eq!(added.kind.extractor, "other-1");
    assert!(added.landmarks.iter().any(|landmark| landmark.observations.len() > 1));
    assert_eq!(contents.images.len(), written.images.len());
    assert!(
        !contents.images.is_empty()
            && contents.images.iter().all(|image| image.jpeg.starts_with(&[0xff, 0xd8]))
    );
    contents.validate().unwrap();
}

#[test]
fn a_map_of_schema_9_is_read() {
    let StoredMap { schema, contents: read, .. } = read("schema_9.db", &everything());
    assert_eq!(schema, STORE_SCHEMA);
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
