//! Laws of the map store, named after the fault or the change.

use std::path::Path;

use geometry::{Camera, Distortion};
use map::model::MAX_ID;
use map::store::{self, SavedMap};
use map::{ContentsError, KeyframeCrossCovariance, MapContents, StoreError};
use nalgebra::{Matrix6, Vector3};
use proptest::prelude::*;
use protocol::{DescriptorKind, Descriptors, FeatureSet};
use testing::{Place, PlaceOptions};

fn small_place(seed: u64) -> MapContents {
    let options = PlaceOptions { seed, keyframes: 6, landmarks: 80, ..PlaceOptions::default() };
    Place::new(&options).map
}

fn replaced(path: &Path, contents: &MapContents) -> SavedMap {
    store::save_map(path, contents, true).unwrap()
}

fn read(path: &Path) -> MapContents {
    store::load_map(path).unwrap().contents
}

/// Everything but the version and the identity, which a store sets.
fn without_version(mut contents: MapContents) -> MapContents {
    contents.info.version = 0;
    contents.info.identity = None;
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
            Just(Distortion::Rational([0.51, -2.7, 3e-4, 0.0, 1.5, 0.4, -2.5, 1.4, 1e-3, -4e-4, 8e-4, 0.0])),
            Just(Distortion::ThinPrismFisheye([-0.04, 0.01, 2e-4, 0.0, -0.004, 8e-4, 6e-4, 0.0])),
            Just(Distortion::DoubleSphere { xi: -0.2, alpha: 0.57 }),
            Just(Distortion::Eucm { alpha: 0.63, beta: 1.04 }),
            Just(Distortion::Omni { xi: 1.85, distortion: [-0.07, 0.4, -1e-3, 0.0] }),
        ],
    ) {
        let options = PlaceOptions { seed, keyframes, landmarks, gravity_known, ..PlaceOptions::default() };
        let mut contents = without_version(Place::new(&options).map);
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
        let saved = store::save_map(&path, &contents, false).unwrap();
        prop_assert_eq!(saved.identity, contents.digest());
        prop_assert_eq!(&without_version(read(&path)), &contents);
    }
}

#[test]
fn the_version_grows_by_one_with_every_replacement_and_the_identity_stays() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    let mut contents = small_place(4);
    let first = replaced(&path, &contents);
    assert_eq!((first.version, first.identity), (1, contents.digest()));
    contents.landmarks.pop();
    let second = replaced(&path, &contents);
    assert_eq!((second.version, second.identity), (2, first.identity));
    contents.info.version = 77; // ignored
    contents.info.identity = Some(contents.digest()); // ignored
    let third = replaced(&path, &contents);
    assert_eq!((third.version, third.identity), (3, first.identity));
    let info = read(&path).info;
    assert_eq!((info.version, info.identity), (3, Some(first.identity)));
}

#[test]
fn different_maps_have_different_identities_and_equal_ones_the_same() {
    let directory = tempfile::tempdir().unwrap();
    let saved =
        |name: &str, contents: &MapContents| replaced(&directory.path().join(name), contents).identity;
    let place = small_place(4);
    let mut renamed = place.clone();
    renamed.info.name = "another name".to_owned();
    renamed.keyframes.reverse();
    renamed.landmarks[0].observations.reverse();
    assert_eq!(saved("a", &place), saved("b", &renamed));
    let mut nudged = place.clone();
    nudged.landmarks[0].position_in_anchor.x += 1e-12;
    assert_ne!(saved("c", &nudged), place.digest());
    let mut noisier = place.clone();
    noisier.info.sigma_px *= 2.0;
    assert_ne!(saved("d", &noisier), place.digest());
}

#[test]
fn what_is_no_longer_in_a_map_is_gone_after_its_replacement() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    replaced(&path, &small_place(6));
    let smaller =
        Place::new(&PlaceOptions { seed: 6, keyframes: 3, landmarks: 20, ..PlaceOptions::default() });
    replaced(&path, &smaller.map);
    assert_eq!(without_version(read(&path)), without_version(smaller.map));
    // Nor does the former version take space.
    let mut names: Vec<_> =
        std::fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["lock", "manifest.json", "version-2.segments"]);
}

#[test]
fn a_replacement_that_violates_an_invariant_changes_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    let contents = small_place(5);
    replaced(&path, &contents);
    let before = read(&path);
    let refused = |change: &dyn Fn(&mut MapContents)| {
        let mut changed = contents.clone();
        changed.keyframes[0].global_from_keyframe.pose.translation.x += 1.0;
        change(&mut changed);
        store::save_map(&path, &changed, true).unwrap_err()
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
    assert_eq!(read(&path), before);
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
    assert!(broken(&|map| map.keyframes[1].id = u64::MAX).contains("its id is larger than"));
    assert!(broken(&|map| map.landmarks[1].id = MAX_ID + 1).contains("its id is larger than"));
    let mut largest = good.clone();
    largest.landmarks[1].id = MAX_ID;
    largest.validate().unwrap();
    assert!(
        broken(&|map| map.keyframes[0].global_from_keyframe.pose.translation.x = f64::NAN).contains("finite")
    );
    let far = broken(&|map| map.keyframes[0].global_from_keyframe.pose.translation.x = 1e300);
    assert!(far.contains("keyframe 10: its position") && far.contains("1e7 m"), "{far}");
    assert!(broken(&|map| map.landmarks[0].position_in_anchor.y = -1.1e7).contains("its position"));
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
    assert!(matches!(store::load_map(&path), Err(StoreError::Missing { .. })));
    assert!(!path.exists());
    let other = directory.path().join("photos");
    std::fs::create_dir(&other).unwrap();
    let empty = store::load_map(&other).unwrap_err();
    assert!(empty.to_string().contains("the folder is empty"), "{empty}");
    assert_eq!(std::fs::read_dir(&other).unwrap().count(), 0);
    std::fs::write(other.join("a.png"), b"no map").unwrap();
    assert!(matches!(store::load_map(&other), Err(StoreError::NotAMap { .. })));
    assert!(matches!(store::save_map(&other, &small_place(8), true), Err(StoreError::NotAMap { .. })));
    assert!(matches!(store::save_map(&other, &small_place(8), false), Err(StoreError::Exists { .. })));
    let file = directory.path().join("map.zip");
    std::fs::write(&file, b"no map").unwrap();
    assert!(matches!(store::load_map(&file), Err(StoreError::NotAMap { .. })));
}

#[test]
fn writing_over_a_map_needs_to_be_asked_for() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    let contents = small_place(8);
    store::save_map(&path, &contents, false).unwrap();
    assert!(matches!(store::save_map(&path, &contents, false), Err(StoreError::Exists { .. })));
    assert!(matches!(store::ensure_free(&path, false), Err(StoreError::Exists { .. })));
    store::ensure_free(&path, true).unwrap();
    store::ensure_free(&directory.path().join("another"), false).unwrap();
}

#[test]
fn a_newer_schema_is_refused_with_both_numbers() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    replaced(&path, &small_place(9));
    let manifest = path.join("manifest.json");
    let text = std::fs::read_to_string(&manifest).unwrap();
    let written = format!("\"schema\": {}", map::STORE_SCHEMA);
    std::fs::write(&manifest, text.replace(&written, "\"schema\": 11, \"unknown\": 1")).unwrap();
    let error = store::load_map(&path).unwrap_err();
    let expected = map::EXTENDED_STORE_SCHEMA;
    assert!(
        matches!(error, StoreError::Schema { found: 11, expected: newest, .. } if newest == expected),
        "{error}"
    );
    assert!(matches!(store::save_map(&path, &small_place(9), true), Err(StoreError::Schema { .. })));
}

#[test]
fn landmarks_that_are_read_one_at_a_time_are_those_of_the_whole_map() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    store::save_map(&path, &small_place(5), false).unwrap();
    let whole = read(&path);
    let (stored, mut landmarks) = store::open_map(&path).unwrap();
    assert_eq!(landmarks.count(0), whole.landmarks.len());
    let observations = whole.landmarks.iter().flat_map(|landmark| &landmark.observations);
    let mut counts = vec![0; whole.keyframes.len()];
    for observation in observations {
        counts[whole.keyframes.binary_search_by_key(&observation.keyframe, |found| found.id).unwrap()] += 1;
    }
    assert_eq!(landmarks.observation_counts(0), counts);
    let mut contents = stored.contents;
    assert!(contents.landmarks.is_empty());
    landmarks.read(0, |landmark| contents.landmarks.push(landmark)).unwrap();
    assert_eq!(contents, whole);
}

#[test]
fn a_map_can_be_replaced_while_the_landmarks_of_the_former_are_read() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    store::save_map(&path, &small_place(5), false).unwrap();
    let former = read(&path);
    let (_, mut landmarks) = store::open_map(&path).unwrap();
    replaced(&path, &small_place(6));
    let mut read_now = Vec::new();
    landmarks.read(0, |landmark| read_now.push(landmark)).unwrap();
    assert_eq!(read_now, former.landmarks);
    assert_eq!(store::open_map(&path).unwrap().0.contents.info.version, 2);
    assert_ne!(read(&path).landmarks, former.landmarks);
}

#[test]
fn a_damaged_number_of_the_version_never_takes_the_map_away() {
    let place = |seed| Place::new(&PlaceOptions { seed, keyframes: 3, ..PlaceOptions::default() }).map;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hall.db");
    for seed in 1..=3 {
        store::save_map(&path, &place(seed), path.exists()).unwrap();
    }
    let manifest = path.join("manifest.json");
    let text = std::fs::read_to_string(&manifest).unwrap();
    for damaged in ["2", "4", "18446744073709551615"] {
        std::fs::write(&manifest, text.replace("\"version\": 3", &format!("\"version\": {damaged}")))
            .unwrap();
        let error = store::load_map(&path).unwrap_err().to_string();
        assert!(error.contains("damaged"), "{damaged}: {error}");
        assert!(path.join("version-3.segments").is_file());
    }
    // The number of a version does not come again.
    assert_eq!(store::save_map(&path, &place(4), true).unwrap().version, 4);
}

#[test]
fn a_map_that_is_cut_into_many_segments_is_read_back() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    let options = PlaceOptions { seed: 12, keyframes: 6, landmarks: 160, ..PlaceOptions::default() };
    let mut contents = Place::new(&options).map;
    // So large that neither keyframes nor landmarks fit in one segment.
    contents.info.descriptor_width = 60_000;
    for (number, observation) in
        contents.landmarks.iter_mut().flat_map(|landmark| &mut landmark.observations).enumerate()
    {
        observation.descriptor = vec![number as u8; 60_000];
    }
    for keyframe in &mut contents.keyframes {
        let descriptors =
            Descriptors { kind: DescriptorKind::Binary, width: 60_000, bytes: vec![3; 6_000_000] };
        let pixels = vec![[1.0, 2.0]; 100];
        keyframe.features = Some(FeatureSet { pixels, descriptors, extractor: String::new() });
    }
    store::save_map(&path, &contents, false).unwrap();
    let manifest = std::fs::read_to_string(path.join("manifest.json")).unwrap();
    let manifest = &serde_json::from_str::<serde_json::Value>(&manifest).unwrap()["manifest"];
    for part in ["frame", "landmarks"] {
        assert!(manifest[part].as_array().unwrap().len() > 1, "{part}: {manifest}");
    }
    let read = read(&path);
    assert_eq!(read.digest(), contents.digest());
    assert!(without_version(read) == without_version(contents.clone()));
    let (stored, mut landmarks) = store::open_map(&path).unwrap();
    assert_eq!(stored.contents.keyframes.len(), 6);
    let mut opened = Vec::new();
    landmarks.read(0, |landmark| opened.push(landmark)).unwrap();
    assert!(opened == contents.landmarks);
}
