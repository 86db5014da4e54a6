//! Laws of the map store, named after the fault or the change.
#![allow(clippy::unwrap_used, missing_docs)]

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use geometry::{Camera, Distortion};
use map::{ContentsError, KeyframeCrossCovariance, MapContents, MapMetadata, MapStore, StoreError, store};
use nalgebra::{Matrix6, Vector3};
use proptest::prelude::*;
use protocol::{DescriptorKind, Descriptors, FeatureSet};
use testing::{Place, PlaceOptions};

fn small_place(seed: u64) -> MapContents {
    let options = PlaceOptions { seed, keyframes: 6, landmarks: 80, ..PlaceOptions::default() };
    Place::new(&options).map
}

fn created(path: &Path, contents: &MapContents) -> Box<dyn MapStore> {
    let store = store::create(path, &contents.info).unwrap();
    store.replace_all(contents).unwrap();
    store
}

/// Everything but the version, which a store sets.
fn without_version(mut contents: MapContents) -> MapContents {
    contents.info.version = 0;
    contents
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn what_is_written_is_read_back_to_the_last_bit(
        seed in any::<u64>(),
        keyframes in 0usize..7,
        landmarks in 0usize..60,
        gravity_known in any::<bool>(),
        with_features in any::<bool>(),
        distortion in prop_oneof![
            Just(Distortion::None),
            Just(Distortion::Equidistant([0.1, -0.02, 0.003, 0.0])),
            Just(Distortion::Fov(0.92)),
            Just(Distortion::RadialTangential([-0.28, 0.07, 0.0002, 0.00002])),
        ],
    ) {
        let options = PlaceOptions { seed, keyframes, landmarks, gravity_known, ..PlaceOptions::default() };
        let mut contents = Place::new(&options).map;
        contents.info.extractor = if with_features { "sift-1".to_owned() } else { String::new() };
        for keyframe in &mut contents.keyframes {
            keyframe.camera = Camera { distortion, ..keyframe.camera.clone() };
            keyframe.features = with_features.then(|| FeatureSet {
                pixels: vec![[1.5, 2.25], [700.0, 3.0]],
                descriptors: Descriptors { kind: DescriptorKind::Binary, width: 32, bytes: vec![7; 64] },
                extractor: String::new(),
            });
        }
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("map");
        let store = created(&path, &contents);
        prop_assert_eq!(&without_version(store.read_contents().unwrap()), &contents);
        drop(store);
        let reopened = store::open(&path).unwrap();
        prop_assert_eq!(&without_version(reopened.read_contents().unwrap()), &contents);
    }
}

#[test]
fn the_version_grows_by_one_with_every_replacement_and_is_kept() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    let mut contents = small_place(4);
    let store = created(&path, &contents);
    assert_eq!(store.info().unwrap().version, 1);
    contents.landmarks.pop();
    assert_eq!(store.replace_all(&contents).unwrap(), 2);
    contents.info.version = 77; // ignored
    assert_eq!(store.replace_all(&contents).unwrap(), 3);
    drop(store);
    assert_eq!(store::save_map(&path, &contents, true).unwrap(), 4);
    assert_eq!(store::open(&path).unwrap().info().unwrap().version, 4);
}

#[test]
fn what_is_no_longer_in_a_map_is_gone_after_its_replacement() {
    let directory = tempfile::tempdir().unwrap();
    let store = created(&directory.path().join("map"), &small_place(6));
    let smaller =
        Place::new(&PlaceOptions { seed: 6, keyframes: 3, landmarks: 20, ..PlaceOptions::default() });
    store.replace_all(&smaller.map).unwrap();
    assert_eq!(without_version(store.read_contents().unwrap()), smaller.map);
}

#[test]
fn a_replacement_that_violates_an_invariant_changes_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let contents = small_place(5);
    let store = created(&directory.path().join("map"), &contents);
    let before = store.read_contents().unwrap();
    let refused = |change: &dyn Fn(&mut MapContents)| {
        let mut changed = contents.clone();
        changed.keyframes[0].global_from_keyframe.pose.translation.x += 1.0;
        change(&mut changed);
        store.replace_all(&changed).unwrap_err()
    };

    let dangling = refused(&|map| map.landmarks[0].observations[0].keyframe = 999);
    assert!(matches!(dangling, StoreError::Invalid(ContentsError::Landmark { .. })));

    let anchor = contents.landmarks[0].anchor;
    let removal = refused(&|map| map.keyframes.retain(|keyframe| keyframe.id != anchor));
    assert!(removal.to_string().contains("not in the map"), "{removal}");

    let (a, b) = (contents.keyframes[0].id, contents.keyframes[3].id);
    let impossible = KeyframeCrossCovariance { a, b, block: Matrix6::identity() };
    assert!(matches!(
        refused(&|map| map.cross_covariances.push(impossible.clone())),
        StoreError::Invalid(ContentsError::CrossCovariance { .. })
    ));
    // Its cross-covariances are no longer possible.
    let shrunk = refused(&|map| map.keyframes[1].global_from_keyframe.covariance *= 1e-4);
    assert!(matches!(shrunk, StoreError::Invalid(ContentsError::CrossCovariance { .. })));
    let other_descriptors = refused(&|map| map.info.descriptor_width = 16);
    assert!(matches!(other_descriptors, StoreError::Invalid(ContentsError::Landmark { .. })));
    assert_eq!(store.read_contents().unwrap(), before);
}

#[test]
fn validate_names_what_is_wrong() {
    let good = small_place(7);
    good.validate().unwrap();
    let broken = |change: &dyn Fn(&mut MapContents)| {
        let mut contents = good.clone();
        change(&mut contents);
        contents.validate().unwrap_err().to_string()
    };
    assert!(broken(&|map| map.info.gravity_in_global = Some(Vector3::new(0.0, 0.0, -9.81))).contains("unit"));
    assert!(broken(&|map| map.info.sigma_px = 0.0).contains("pixel sigma"));
    assert!(broken(&|map| map.keyframes[1].id = map.keyframes[0].id).contains("twice"));
    assert!(
        broken(&|map| map.keyframes[0].global_from_keyframe.pose.translation.x = f64::NAN).contains("finite")
    );
    assert!(
        broken(&|map| map.keyframes[0].global_from_keyframe.covariance[(0, 1)] = 1.0).contains("symmetric")
    );
    assert!(
        broken(&|map| map.keyframes[0].global_from_keyframe.covariance[(0, 0)] = -1.0).contains("negative")
    );
    assert!(broken(&|map| map.landmarks[0].anchor = 999).contains("999"));
    assert!(broken(&|map| map.landmarks[0].position_in_anchor.z = f64::INFINITY).contains("finite"));
    assert!(broken(&|map| map.landmarks[0].observations[0].pixel = [800.0, 5.0]).contains("outside"));
    assert!(broken(&|map| map.landmarks[0].observations[0].descriptor.truncate(3)).contains("3 bytes"));
    assert!(broken(&|map| map.cross_covariances[0].b = 999).contains("not in the map"));
    assert!(broken(&|map| map.cross_covariances[0].block *= 1e6).contains("negative eigenvalue"));
}

#[test]
fn opening_what_is_not_there_is_an_error_and_makes_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("absent");
    assert!(matches!(store::open(&path), Err(StoreError::Missing { .. })));
    assert!(!path.exists());
    let other = directory.path().join("photos");
    std::fs::create_dir(&other).unwrap();
    assert!(matches!(store::open(&other), Err(StoreError::NotAMap { .. })));
    assert_eq!(std::fs::read_dir(&other).unwrap().count(), 0);
    drop(sled::open(directory.path().join("database")).unwrap());
    assert!(matches!(store::open(directory.path().join("database")), Err(StoreError::NotAMap { .. })));
}

#[test]
fn creating_over_something_is_an_error() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    let contents = small_place(8);
    let store = created(&path, &contents);
    assert!(matches!(store::open(&path), Err(StoreError::InUse { .. })));
    drop(store);
    assert!(matches!(store::create(&path, &contents.info), Err(StoreError::Exists { .. })));
}

#[test]
fn another_schema_is_refused_with_both_numbers() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    drop(created(&path, &small_place(9)));
    let database = testing::open_database(&path);
    let tree = database.open_tree("info").unwrap();
    tree.insert("schema", b"DRFTMAP\x07\x00".as_slice()).unwrap();
    drop((tree, database));
    let error = store::open(&path).err().unwrap();
    assert!(matches!(error, StoreError::Schema { found: 7, expected: 2, .. }), "{error}");
}

/// What record version 1 kept of a map's info.
#[derive(serde::Serialize)]
struct InfoOfVersion1 {
    name: String,
    created_by: String,
    version: u64,
    gravity_in_global: Option<[f64; 3]>,
    descriptor_kind: u8,
    descriptor_width: u16,
    sigma_px: f64,
}

/// Turns a database into what the first release wrote: schema 1, records of version 1, no extractor.
fn make_old(path: &std::path::Path, info: &MapMetadata) {
    let sealed = |table: &str, key: &[u8], payload: &[u8]| {
        let mut hasher = crc32fast::Hasher::new();
        for part in [table.as_bytes(), key, &[1], payload] {
            hasher.update(part);
        }
        [&[1], &hasher.finalize().to_le_bytes()[..], payload].concat()
    };
    let database = testing::open_database(path);
    for table in ["keyframes", "landmarks", "cross_covariances"] {
        let tree = database.open_tree(table).unwrap();
        for (key, value) in tree.iter().map(Result::unwrap) {
            tree.insert(&key, sealed(table, &key, &value[5..])).unwrap();
        }
    }
    let old = InfoOfVersion1 {
        name: info.name.clone(),
        created_by: info.created_by.clone(),
        version: 1,
        gravity_in_global: info.gravity_in_global.map(Into::into),
        descriptor_kind: 0,
        descriptor_width: info.descriptor_width,
        sigma_px: info.sigma_px,
    };
    database.open_tree("references").unwrap().insert([b'l'; 17], b"").unwrap();
    let tree = database.open_tree("info").unwrap();
    tree.insert("info", sealed("info", b"info", &bincode::serialize(&old).unwrap())).unwrap();
    tree.insert("schema", b"DRFTMAP\x01\x00".as_slice()).unwrap();
}

#[test]
fn a_map_of_the_first_release_opens_and_becomes_new_with_its_first_change() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    let mut contents = small_place(11);
    drop(created(&path, &contents));
    make_old(&path, &contents.info);

    let store = store::open(&path).unwrap();
    assert_eq!(without_version(store.read_contents().unwrap()), contents);
    contents.info.extractor = "sift-1".to_owned();
    assert_eq!(store.replace_all(&contents).unwrap(), 2);
    drop(store);
    let database = testing::open_database(&path);
    let schema = database.open_tree("info").unwrap().get("schema").unwrap();
    assert_eq!(schema.unwrap().as_ref(), b"DRFTMAP\x02\x00");
    assert!(!database.tree_names().contains(&"references".into()));
    drop(database);
    assert_eq!(without_version(store::open(&path).unwrap().read_contents().unwrap()), contents);
}

#[test]
fn a_corrupt_record_is_an_error_and_the_rest_stays_readable() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    let contents = small_place(10);
    drop(created(&path, &contents));
    let (landmark, keyframe) = (contents.landmarks[3].id, contents.keyframes[2].id);
    damage(&path, "landmarks", landmark, |bytes| {
        let middle = bytes.len() / 2;
        bytes[middle] ^= 0x10;
    });
    damage(&path, "keyframes", keyframe, |bytes| bytes.truncate(3));

    let store = store::open(&path).unwrap();
    let error = store.landmarks().find_map(Result::err).unwrap();
    assert!(
        matches!(&error, StoreError::Corrupt { record, .. } if *record == format!("landmark {landmark}"))
    );
    assert!(store.read_contents().is_err());
    assert_eq!(store.landmarks().flatten().count(), contents.landmarks.len() - 1);
    assert_eq!(store.keyframes().flatten().count(), contents.keyframes.len() - 1);

    let (readable, errors) = store.read_readable().unwrap();
    readable.validate().unwrap();
    assert_eq!(errors.len(), 2);
    assert_eq!(readable.keyframes.len(), contents.keyframes.len() - 1);

    // What is damaged can be written again.
    store.replace_all(&contents).unwrap();
    assert_eq!(without_version(store.read_contents().unwrap()), contents);
}

#[test]
fn a_record_under_the_wrong_key_is_corrupt() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    let contents = small_place(11);
    drop(created(&path, &contents));
    let database = testing::open_database(&path);
    let tree = database.open_tree("landmarks").unwrap();
    let [first, second] = [0, 1].map(|index: usize| contents.landmarks[index].id.to_be_bytes());
    let bytes = tree.get(first).unwrap().unwrap();
    tree.insert(second, bytes).unwrap();
    drop((tree, database));
    let store = store::open(&path).unwrap();
    let records: Vec<_> = store.landmarks().collect();
    assert!(matches!(records[1], Err(StoreError::Corrupt { .. })));
    assert!(records.iter().enumerate().all(|(index, record)| index == 1 || record.is_ok()));
}

fn damage(path: &Path, tree: &str, id: u64, change: impl Fn(&mut Vec<u8>)) {
    let database = testing::open_database(path);
    let tree = database.open_tree(tree).unwrap();
    let mut bytes = tree.get(id.to_be_bytes()).unwrap().unwrap().to_vec();
    change(&mut bytes);
    tree.insert(id.to_be_bytes(), bytes).unwrap();
    tree.flush().unwrap();
}

/// Not a law by itself: the child process that [`what_was_acknowledged_survives_kill_9`] kills.
#[test]
fn child_that_writes_versions() {
    let Ok(path) = std::env::var("MAP_STORE_TEST_CHILD") else { return };
    let mut contents = small_place(12);
    let store = store::create(path, &contents.info).unwrap();
    println!("acknowledged {}", store.replace_all(&contents).unwrap());
    for round in 0u64.. {
        // Two records that must change together: a keyframe's time and a landmark's depth give the same round.
        contents.keyframes[0].stamp_ns = round as i64;
        contents.landmarks[0].position_in_anchor.z = round as f64;
        println!("acknowledged {}", store.replace_all(&contents).unwrap());
    }
}

#[test]
fn what_was_acknowledged_survives_kill_9() {
    for count in [1, 7, 40] {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("map");
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["child_that_writes_versions", "--exact", "--nocapture"])
            .env("MAP_STORE_TEST_CHILD", &path)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut acknowledged = 0;
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let versions =
            lines.filter_map(|line| line.unwrap().rsplit_once("acknowledged ")?.1.parse::<u64>().ok());
        for version in versions.take(count) {
            acknowledged = version;
        }
        child.kill().unwrap(); // SIGKILL
        child.wait().unwrap();

        let store = store::open(&path).unwrap();
        let contents = store.read_contents().unwrap();
        contents.validate().unwrap();
        assert!(acknowledged > 0 && contents.info.version >= acknowledged);
        assert_eq!(contents.landmarks.len(), small_place(12).landmarks.len());
        if contents.info.version > 1 {
            let round = contents.info.version - 2;
            assert_eq!(contents.keyframes[0].stamp_ns, round as i64);
            assert!((contents.landmarks[0].position_in_anchor.z - round as f64).abs() < 1e-12);
        }
    }
}
