//! Folders that were made to harm: their checksums are right, and what they state is not.

use std::path::Path;

use map::file::segment::sha256;
use map::file::{SegmentName, SegmentWriter};
use map::store::{StoreError, load_map, open_map, save_map};
use serde_json::{Value, json};
use testing::{Place, PlaceOptions};

fn write(path: &Path, manifest: &Value, segments: &[u8]) {
    forge(path, map::STORE_SCHEMA, manifest, segments);
}

/// Writes a manifest and the file of its version, 1, with right checksums.
pub(crate) fn forge(path: &Path, schema: u16, manifest: &Value, segments: &[u8]) {
    let text = serde_json::to_string(manifest).unwrap();
    let sealed = format!(
        "{{\"schema\": {schema}, \"sha256\": \"{}\", \"manifest\": {text}}}",
        sha256(text.as_bytes())
    );
    std::fs::write(path.join("manifest.json"), sealed).unwrap();
    std::fs::write(path.join("version-1.segments"), segments).unwrap();
}

#[test]
fn what_a_manifest_must_not_state_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("hall.db");
    let place = Place::new(&PlaceOptions { keyframes: 4, landmarks: 40, ..PlaceOptions::default() }).map;
    save_map(&path, &place, false).unwrap();
    let text = std::fs::read(path.join("manifest.json")).unwrap();
    let good = serde_json::from_slice::<Value>(&text).unwrap()["manifest"].clone();
    let segments = std::fs::read(path.join("version-1.segments")).unwrap();
    let (frame, landmarks) = (good["frame"][0].clone(), good["landmarks"][0].clone());
    let with = |key: &str, value: Value| {
        let mut manifest = good.clone();
        manifest[key] = value;
        manifest
    };
    let of_map = |key: &str, value: Value| {
        let mut manifest = good.clone();
        manifest["map"][key] = value;
        manifest
    };
    let refused = |manifest: &Value, segments: &[u8]| {
        write(&path, manifest, segments);
        let error = load_map(&path).unwrap_err();
        let opened = open_map(&path).err().unwrap();
        assert_eq!(error.to_string(), opened.to_string());
        assert!(matches!(error, StoreError::Damaged { .. }), "{error}");
        error.to_string()
    };
    write(&path, &good, &segments);
    assert_eq!(load_map(&path).unwrap().contents.landmarks.len(), place.landmarks.len());

    let swapped = [&segments[frame["bytes"].as_u64().unwrap() as usize..], &segments[..]].concat();
    let swapped = &swapped[..segments.len()];
    let mut exchanged = with("frame", json!([landmarks]));
    exchanged["landmarks"] = json!([frame]);
    assert!(refused(&exchanged, swapped).contains("landmarks where none belong"));
    let doubled = with("landmarks", json!([landmarks, landmarks]));
    let twice = [&segments[..], &segments[frame["bytes"].as_u64().unwrap() as usize..]].concat();
    let said = refused(&doubled, &twice);
    assert!(said.contains("landmark") && said.contains("out of order"), "{said}");
    let frames = [&segments[..frame["bytes"].as_u64().unwrap() as usize], &segments[..]].concat();
    let said = refused(&with("frame", json!([frame, frame])), &frames);
    assert!(said.contains("keyframe 10 is out of order"), "{said}");

    for bytes in [0_u64, 1, 1 << 62, u64::MAX] {
        let named = json!([{ "sha256": landmarks["sha256"], "bytes": bytes }]);
        assert!(refused(&with("landmarks", named), &segments).contains("version-1.segments has"));
    }
    for (key, value) in [
        ("version", json!(0)),
        ("version", json!(u64::MAX)),
        ("version", json!(-1)),
        ("identity", Value::Null),
        ("descriptor_width", json!(1 << 20)),
        ("descriptor_kind", json!("smell")),
        ("unknown", json!(1)),
    ] {
        assert!(refused(&of_map(key, value), &segments).contains("manifest.json cannot be understood"));
    }
    // Whoever writes over it makes the next version, whatever it stated.
    assert!(save_map(&path, &place, true).unwrap().version >= 2);
}

#[test]
fn a_segment_of_something_else_is_named_with_its_file() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("hall.db");
    let place = Place::new(&PlaceOptions { keyframes: 4, landmarks: 40, ..PlaceOptions::default() }).map;
    save_map(&path, &place, false).unwrap();
    let text = std::fs::read(path.join("manifest.json")).unwrap();
    let mut manifest = serde_json::from_slice::<Value>(&text).unwrap()["manifest"].clone();
    let mut writer = SegmentWriter::default();
    writer.add(&place.landmarks[0]).unwrap();
    let good = writer.finish();
    for (bytes, problem) in [
        (b"%PDF-1.7".to_vec(), "does not begin as a segment"),
        (good[..good.len() - 1].to_vec(), "in the middle of a record"),
        ([&good[..], b"x"].concat(), "1 bytes follow its last record"),
    ] {
        let SegmentName { sha256, bytes: length } = SegmentName::of(&bytes);
        manifest["frame"] = json!([]);
        manifest["landmarks"] = json!([{ "sha256": sha256, "bytes": length }]);
        write(&path, &manifest, &bytes);
        let said = load_map(&path).unwrap_err().to_string();
        for part in ["hall.db", "version-1.segments", "at byte 0", problem, "backup"] {
            assert!(said.contains(part), "{part}: {said}");
        }
    }
}
