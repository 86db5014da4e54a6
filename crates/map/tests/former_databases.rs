//! Maps that programs of store schema 1 and 2 wrote, without checksums around their database.

use std::path::Path;

use map::{MapContents, StoreError, store};
use testing::{Place, PlaceOptions, write_former_database};

fn place() -> MapContents {
    let mut contents =
        Place::new(&PlaceOptions { keyframes: 6, landmarks: 80, ..PlaceOptions::default() }).map;
    contents.info.version = 4;
    contents
}

/// Everything but the version and the identity, which a store sets.
fn without_version(mut contents: MapContents) -> MapContents {
    contents.info.version = 0;
    contents.info.identity = None;
    contents
}

/// Every file below a folder with its bytes and the time of its last change.
fn listing(folder: &Path) -> Vec<(String, Vec<u8>, std::time::SystemTime)> {
    let mut all = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        all.push((folder.display().to_string(), Vec::new(), folder.metadata().unwrap().modified().unwrap()));
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let changed = path.metadata().unwrap().modified().unwrap();
                all.push((path.display().to_string(), std::fs::read(&path).unwrap(), changed));
            }
        }
    }
    all.sort();
    all
}

#[test]
fn a_former_map_is_read_without_a_change_and_becomes_new_with_its_replacement() {
    for schema in [1, 2] {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("map");
        let mut contents = place();
        contents.info.extractor = if schema == 1 { String::new() } else { "sift-1".to_owned() };
        write_former_database(&path, &contents, schema, &|_, _, _| {});

        let before = listing(&path);
        let stored = store::load_map(&path).unwrap();
        assert_eq!((stored.schema, stored.contents.info.version), (schema, 4));
        assert_eq!(stored.contents.info.identity, Some(contents.digest()));
        assert_eq!(without_version(stored.whole().unwrap()), without_version(contents.clone()));
        assert_eq!(listing(&path), before);

        let identity = contents.digest();
        contents.landmarks.pop();
        assert!(matches!(store::save_map(&path, &contents, false), Err(StoreError::Exists { .. })));
        let saved = store::save_map(&path, &contents, true).unwrap();
        assert_eq!((saved.version, saved.identity), (5, identity));
        let stored = store::load_map(&path).unwrap();
        assert_eq!(stored.schema, map::STORE_SCHEMA);
        assert_eq!(without_version(stored.whole().unwrap()), without_version(contents));
        assert!(!path.join("db").exists() && !path.join("blobs").exists());
    }
}

#[test]
fn the_database_that_a_released_program_wrote_is_read() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/schema_2.db");
    let before = listing(&path);
    let contents = store::load_map(&path).unwrap().whole().unwrap();
    contents.validate().unwrap();
    assert_eq!(
        (contents.keyframes.len(), contents.landmarks.len(), contents.observation_count()),
        (3, 8, 24)
    );
    assert_eq!((contents.info.version, contents.info.name.as_str()), (1, "map"));
    assert_eq!(listing(&path), before);
}

#[test]
fn a_damaged_record_is_named_and_left_out() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    let contents = place();
    let (landmark, keyframe) = (contents.landmarks[3].id, contents.keyframes[2].id);
    write_former_database(&path, &contents, 2, &|table, key, bytes| match table {
        "landmarks" if key == landmark.to_be_bytes() => {
            let middle = bytes.len() / 2;
            bytes[middle] ^= 0x10;
        }
        "keyframes" if key == keyframe.to_be_bytes() => bytes.truncate(3),
        _ => {}
    });
    let stored = store::load_map(&path).unwrap();
    stored.contents.validate().unwrap();
    assert_eq!((stored.damaged.len(), stored.contents.keyframes.len()), (2, contents.keyframes.len() - 1));
    let names: Vec<String> = stored.damaged.iter().map(ToString::to_string).collect();
    assert!(names[0].contains(&format!("keyframe {keyframe} in the map")), "{names:?}");
    assert!(names[1].contains(&format!("landmark {landmark} in the map")), "{names:?}");
    let (mut opened, landmarks) = store::open_map(&path).unwrap();
    landmarks.read(|landmark| opened.contents.landmarks.push(landmark)).unwrap();
    assert_eq!((opened.damaged.len(), &opened.contents), (2, &stored.contents));
    assert!(matches!(stored.whole(), Err(StoreError::Corrupt { .. })));
    // It can be written again.
    store::save_map(&path, &contents, true).unwrap();
    assert_eq!(without_version(store::load_map(&path).unwrap().whole().unwrap()), without_version(contents));
}

#[test]
fn a_record_under_the_key_of_another_is_damaged() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    let contents = place();
    let [first, second] = [0, 1].map(|at: usize| contents.landmarks[at].id.to_be_bytes());
    let moved = std::cell::RefCell::new(Vec::new());
    write_former_database(&path, &contents, 2, &|table, key, bytes| {
        if table == "landmarks" && key == first {
            moved.replace(bytes.clone());
        } else if table == "landmarks" && key == second {
            bytes.clone_from(&moved.borrow());
        }
    });
    assert_eq!(store::load_map(&path).unwrap().damaged.len(), 1);
}

#[test]
fn a_map_that_was_only_begun_is_unfinished_and_is_made_anew() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    let mut contents = place();
    contents.info.version = 0;
    write_former_database(&path, &contents, 2, &|_, _, _| {});
    let error = store::load_map(&path).unwrap_err();
    assert!(matches!(error, StoreError::Unfinished { .. }), "{error}");
    assert_eq!(store::save_map(&path, &contents, false).unwrap().version, 1);
}

#[test]
fn a_former_map_that_an_older_program_writes_is_in_use() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    write_former_database(&path, &place(), 2, &|_, _, _| {});
    let database = sled::open(&path).unwrap();
    assert!(matches!(store::load_map(&path), Err(StoreError::InUse { .. })));
    assert!(matches!(store::save_map(&path, &place(), true), Err(StoreError::InUse { .. })));
    drop(database);
}

/// The first error of the database ends reading: sled's iterator repeats it for ever.
#[test]
fn a_damaged_former_database_is_read_or_refused_soon() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    write_former_database(&path, &place(), 2, &|_, _, _| {});
    let whole = std::fs::read(path.join("db")).unwrap();
    for length in (0..whole.len()).step_by(whole.len() / 40) {
        std::fs::write(path.join("db"), &whole[..length]).unwrap();
        let started = std::time::Instant::now();
        match store::load_map(&path) {
            // What a former database lost at its end cannot be noticed; what is read is a map.
            Ok(stored) => stored.contents.validate().unwrap(),
            Err(error) => assert!(error.to_string().contains("map"), "{error}"),
        }
        assert!(started.elapsed().as_secs() < 15, "{length} bytes of {}", whole.len());
    }
}
