//! Maps with features of several kinds and with images: stored, read, and refused where they are impossible.

use std::path::Path;

use map::contents::{AddedFeaturesProblem, ImageProblem, LandmarkProblem};
use map::file::{SegmentName, SegmentWriter};
use map::model::MAX_ID;
use map::store::{StoreError, StoredImages, load_map, open_map, save_map};
use map::{ContentsError, EXTENDED_STORE_SCHEMA, KeptImage, Landmark, MapContents, STORE_SCHEMA};
use proptest::prelude::*;
use serde_json::{Value, json};
use testing::{Place, PlaceOptions, add_images, add_second_kind};

use crate::hostile::forge;

fn plain() -> MapContents {
    let options = PlaceOptions { keyframes: 6, landmarks: 80, ..PlaceOptions::default() };
    let mut map = Place::new(&options).map;
    map.sort();
    map
}

fn extended() -> MapContents {
    let mut map = plain();
    add_second_kind(&mut map, "other-1");
    add_second_kind(&mut map, "third-2");
    add_images(&mut map);
    map
}

fn manifest(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path.join("manifest.json")).unwrap()).unwrap()
}

#[test]
fn all_kinds_and_images_are_read_back_as_a_whole_and_one_by_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hall.db");
    let written = extended();
    save_map(&path, &written, false).unwrap();
    let stored = load_map(&path).unwrap();
    assert_eq!(stored.schema, EXTENDED_STORE_SCHEMA);
    let read = stored.contents;
    assert_eq!(read.added_features, written.added_features);
    assert_eq!(read.images, written.images);
    assert_eq!((read.digest(), read.store_schema()), (written.digest(), EXTENDED_STORE_SCHEMA));
    read.validate().unwrap();

    let (opened, mut landmarks) = open_map(&path).unwrap();
    assert!(opened.contents.images.is_empty());
    for (kind, (of, expected)) in written.landmarks_of_kinds().enumerate() {
        assert_eq!(opened.contents.feature_kinds().nth(kind).unwrap(), of);
        let mut visited: Vec<Landmark> = Vec::new();
        landmarks.read(kind, |landmark| visited.push(landmark)).unwrap();
        assert_eq!(visited, expected);
        assert_eq!(landmarks.count(kind), expected.len());
        let observations: u32 = landmarks.observation_counts(kind).iter().sum();
        let counted: usize = expected.iter().map(|landmark| landmark.observations.len()).sum();
        assert_eq!(observations as usize, counted);
    }
    let mut images = StoredImages::open(&path).unwrap();
    assert_eq!(images.len(), written.images.len());
    for keyframe in &written.keyframes {
        let expected = written.images.iter().find(|image| image.keyframe == keyframe.id);
        assert_eq!(images.read(keyframe.id).unwrap().as_ref(), expected);
    }
    // What is replaced meanwhile is read to its end as it was.
    save_map(&path, &plain(), true).unwrap();
    assert_eq!(images.read(written.images[0].keyframe).unwrap().unwrap(), written.images[0]);
    assert!(StoredImages::open(&path).unwrap().is_empty());
}

#[test]
fn what_a_map_does_not_have_leaves_no_trace_in_its_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hall.db");
    save_map(&path, &plain(), false).unwrap();
    let stated = manifest(&path);
    assert_eq!(stated["schema"], STORE_SCHEMA);
    let fields: Vec<&String> = stated["manifest"].as_object().unwrap().keys().collect();
    assert!(["added_features", "images"].iter().all(|field| fields.iter().all(|other| other != field)));
    // Taking the additions out of a map gives the map without them.
    let mut without = extended();
    without.added_features.clear();
    without.images.clear();
    assert_eq!(without.digest(), plain().digest());
    assert_ne!(extended().digest(), plain().digest());
}

#[test]
fn the_stated_bytes_of_landmarks_are_those_of_the_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hall.db");
    let map = extended();
    save_map(&path, &map, false).unwrap();
    let stated = &manifest(&path)["manifest"];
    let bytes = |segments: &Value| {
        let segments = segments.as_array().unwrap();
        // Each begins with a line and the lengths of five lists.
        let beside = (b"driftless segment 4\n".len() + 5 * 8) as u64;
        segments.iter().map(|segment| segment["bytes"].as_u64().unwrap() - beside).sum::<u64>()
    };
    let of = |landmarks: &[Landmark]| landmarks.iter().map(Landmark::bytes_on_disk).sum::<u64>();
    assert_eq!(bytes(&stated["landmarks"]), of(&map.landmarks));
    for (at, added) in map.added_features.iter().enumerate() {
        assert_eq!(bytes(&stated["added_features"][at]["landmarks"]), of(&added.landmarks));
    }
}

#[test]
fn ids_for_which_there_is_no_room_are_refused_after_renumbering() {
    let mut map = extended();
    for landmarks in [&mut map.landmarks, &mut map.added_features[0].landmarks] {
        landmarks.last_mut().unwrap().id = MAX_ID;
    }
    map.renumber_added();
    let error = map.validate().unwrap_err();
    let ContentsError::AddedFeatures { problem, .. } = &error else { panic!("{error}") };
    let AddedFeaturesProblem::Landmark { problem, .. } = problem else { panic!("{error}") };
    assert_eq!(*problem, LandmarkProblem::Id);
}

#[test]
fn impossible_additions_are_named() {
    let refused = |change: &dyn Fn(&mut MapContents)| {
        let mut map = extended();
        change(&mut map);
        map.validate().unwrap_err()
    };
    let features = |change: &dyn Fn(&mut MapContents)| match refused(change) {
        ContentsError::AddedFeatures { problem, .. } => problem,
        other => panic!("{other}"),
    };
    let image = |change: &dyn Fn(&mut MapContents)| match refused(change) {
        ContentsError::Image { problem, .. } => problem,
        other => panic!("{other}"),
    };
    let duplicate = |map: &mut MapContents| map.added_features[1].kind.extractor = "other-1".to_owned();
    assert_eq!(features(&duplicate), AddedFeaturesProblem::Duplicate);
    let unnamed = |map: &mut MapContents| map.added_features[0].kind.extractor.clear();
    assert_eq!(features(&unnamed), AddedFeaturesProblem::Unnamed);
    let width = |map: &mut MapContents| map.added_features[0].kind.descriptor_width = 0;
    assert!(matches!(features(&width), AddedFeaturesProblem::Kind(_)));
    let narrow = |map: &mut MapContents| map.added_features[0].kind.descriptor_width = 16;
    assert!(matches!(features(&narrow), AddedFeaturesProblem::Landmark { .. }));
    let swapped = |map: &mut MapContents| map.added_features.swap(0, 1);
    assert!(matches!(features(&swapped), AddedFeaturesProblem::Order { .. }));
    let taken = |map: &mut MapContents| {
        let id = map.landmarks[3].id;
        map.added_features[0].landmarks[5].id = id;
    };
    assert!(matches!(features(&taken), AddedFeaturesProblem::Order { .. }));
    let twice = |map: &mut MapContents| {
        let copy = map.added_features[0].landmarks[2].clone();
        map.added_features[0].landmarks.push(copy);
    };
    assert!(matches!(features(&twice), AddedFeaturesProblem::Order { .. }));
    let lost = |map: &mut MapContents| map.added_features[0].landmarks[0].observations[0].keyframe = 77_777;
    assert!(matches!(features(&lost), AddedFeaturesProblem::Landmark { .. }));

    assert_eq!(image(&|map| map.images[0].keyframe = 77_777), ImageProblem::UnknownKeyframe);
    assert_eq!(image(&|map| map.images[1].keyframe = map.images[0].keyframe), ImageProblem::Duplicate);
    assert_eq!(image(&|map| map.images[1].jpeg = b"\x89PNG".to_vec()), ImageProblem::NotJpeg);
}

#[test]
fn forged_additions_are_refused_by_all_readers() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hall.db");
    save_map(&path, &extended(), false).unwrap();
    let good = manifest(&path)["manifest"].clone();
    let segments = std::fs::read(path.join("version-1.segments")).unwrap();
    forge(&path, EXTENDED_STORE_SCHEMA, &good, &segments);
    load_map(&path).unwrap();
    let refused = |schema: u16, manifest: &Value, segments: &[u8]| {
        forge(&path, schema, manifest, segments);
        let error = load_map(&path).unwrap_err();
        assert_eq!(error.to_string(), open_map(&path).err().unwrap().to_string());
        assert!(matches!(error, StoreError::Damaged { .. }), "{error}");
        error.to_string()
    };
    // Of a schema that has not these fields, and of one that must have them.
    assert!(refused(STORE_SCHEMA, &good, &segments).contains("schema 9"));
    let mut without = good.clone();
    without
        .as_object_mut()
        .unwrap()
        .retain(|field, _| !["added_features", "images"].contains(&field.as_str()));
    assert!(refused(EXTENDED_STORE_SCHEMA, &without, &segments).contains("schema 10"));
    let mut unknown = good.clone();
    unknown["added_features"][0]["smell"] = json!(1);
    assert!(refused(EXTENDED_STORE_SCHEMA, &unknown, &segments).contains("manifest.json"));

    // Images where landmarks belong, and the other way round.
    let sum = |segments: &Value| -> u64 {
        segments.as_array().unwrap().iter().map(|segment| segment["bytes"].as_u64().unwrap()).sum()
    };
    let before = (sum(&good["frame"]) + sum(&good["landmarks"])) as usize;
    let mut of_images = SegmentWriter::of_images();
    of_images.add(&KeptImage { keyframe: 10, jpeg: vec![0xff, 0xd8, 1, 2] }).unwrap();
    assert!(of_images.add(&extended().landmarks[0]).is_err());
    let of_images = of_images.finish();
    let mut of_landmarks = SegmentWriter::default();
    assert!(of_landmarks.add(&KeptImage { keyframe: 10, jpeg: vec![0xff, 0xd8] }).is_err());
    of_landmarks.add(&extended().landmarks[0]).unwrap();
    let of_landmarks = of_landmarks.finish();
    let with = |field: &str, bytes: &[u8]| {
        let mut forged = without.clone();
        let SegmentName { sha256, bytes: length } = SegmentName::of(bytes);
        let names = json!([{ "sha256": sha256, "bytes": length }]);
        forged[field] = match field {
            "images" => names,
            _ => json!([{ "kind": good["added_features"][0]["kind"], "landmarks": names }]),
        };
        (forged, [&segments[..before], bytes].concat())
    };
    for (field, bytes, problem) in [
        ("added_features", of_images.clone(), "does not begin as a segment"),
        ("images", of_landmarks, "does not begin as a segment"),
        ("images", of_images[..of_images.len() - 1].to_vec(), "in the middle of a record"),
        ("images", [&of_images[..], b"x"].concat(), "1 bytes follow its last record"),
    ] {
        let (forged, file) = with(field, &bytes);
        let said = refused(EXTENDED_STORE_SCHEMA, &forged, &file);
        assert!(said.contains(problem), "{field}: {said}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// Bytes under a right checksum are an image of its keyframe, or refused; none makes a reader panic.
    #[test]
    fn no_bytes_of_an_image_segment_make_a_reader_panic(
        cut in 0..1_000_usize, at in 0..1_000_usize, bit in 0..8_u8, noise: Vec<u8>,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("hall.db");
        let map = plain();
        save_map(&path, &map, false).unwrap();
        let good = manifest(&path)["manifest"].clone();
        let segments = std::fs::read(path.join("version-1.segments")).unwrap();
        let mut writer = SegmentWriter::of_images();
        for image in &extended().images {
            writer.add(image).unwrap();
        }
        let bytes = writer.finish();
        let mut flipped = bytes.clone();
        flipped[at % bytes.len()] ^= 1 << bit;
        for damaged in [
            bytes[..cut % bytes.len()].to_vec(), flipped,
            [&b"driftless images 1\n"[..], &noise].concat(), [&bytes[..], &[0]].concat(),
        ] {
            let SegmentName { sha256, bytes: length } = SegmentName::of(&damaged);
            let mut forged = good.clone();
            forged["images"] = json!([{ "sha256": sha256, "bytes": length }]);
            forge(&path, EXTENDED_STORE_SCHEMA, &forged, &[&segments[..], &damaged].concat());
            prop_assert!(load_map(&path).is_err());
            prop_assert!(StoredImages::open(&path).is_err());
        }
    }
}

/// New landmarks of the primary kind take ids that those of added kinds had.
#[test]
fn landmarks_of_added_kinds_get_ids_beyond_those_before() {
    let ordered = extended();
    let mut same = ordered.clone();
    same.renumber_added();
    assert_eq!(same, ordered);

    let mut grown = ordered.clone();
    let last = grown.landmarks.last().unwrap().clone();
    grown.landmarks.extend((1..=5).map(|more| Landmark { id: last.id + more, ..last.clone() }));
    assert!(matches!(grown.validate(), Err(ContentsError::AddedFeatures { .. })));
    grown.renumber_added();
    grown.validate().unwrap();
    // There is room for more.
    let others = grown.added_features.clone();
    grown.landmarks.extend((6..=1000).map(|more| Landmark { id: last.id + more, ..last.clone() }));
    grown.renumber_added();
    grown.validate().unwrap();
    assert_eq!(grown.added_features, others);
    let anonymous = |map: &MapContents| -> Vec<Landmark> {
        let landmarks = map.added_features.iter().flat_map(|added| added.landmarks.clone());
        landmarks.map(|landmark| Landmark { id: 0, ..landmark }).collect()
    };
    assert_eq!(anonymous(&grown), anonymous(&ordered));
}
