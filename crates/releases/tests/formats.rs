//! A folder of every released format is read. Nothing is released yet: those are the two that are written today, of a map without and
//! with added features and images, and the one before, which differs in the change only.

use std::path::Path;

use map::MapContents;
use releases::release::{EXTENDED_RELEASE_SCHEMA, RELEASE_SCHEMA};
use releases::{
    PublishOptions, ReleaseStore, fetch, fetch_cell, fetch_coarse, fetch_without_images, publish,
};
use testing::{Place, PlaceOptions, add_aliases, add_common_errors, add_images, add_second_kind};

/// Set to write the folder of the newest one again, for a format that was not released.
const UPDATE: &str = "UPDATE";

#[tokio::test]
async fn a_release_of_schema_8_is_read() {
    is_read(8).await;
}

#[tokio::test]
async fn a_release_of_schema_9_is_read() {
    is_read(9).await;
}

#[tokio::test]
async fn a_release_of_schema_10_is_read() {
    is_read(10).await;
}

async fn is_read(schema: u16) {
    let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/data/release_{schema}"));
    let store = ReleaseStore::open(kept.to_str().unwrap()).unwrap();
    let is_written = [RELEASE_SCHEMA, EXTENDED_RELEASE_SCHEMA].contains(&schema);
    if is_written && std::env::var_os(UPDATE).is_some() {
        let _ = std::fs::remove_dir_all(&kept);
        let mut map =
            Place::new(&PlaceOptions { keyframes: 4, landmarks: 12, ..PlaceOptions::default() }).map;
        add_common_errors(&mut map, 2);
        add_aliases(&mut map);
        map.ensure_sessions("drive_1");
        if schema == EXTENDED_RELEASE_SCHEMA {
            add_second_kind(&mut map, "other-1");
            add_images(&mut map);
        }
        let mut options = PublishOptions::default();
        options.keyframes_a_cell = 2;
        publish(&store, map.clone(), &options, |_| {}).await.unwrap();
        map.keyframes[1].global_from_keyframe.pose.translation.x += 0.25;
        publish(&store, map, &options, |_| {}).await.unwrap();
    }
    let release = store.newest().await.unwrap().unwrap();
    let number = if schema == 8 { 1 } else { 2 };
    assert_eq!(
        (release.schema, release.number, release.cells.len(), release.keyframes()),
        (schema, number, 2, 4)
    );
    if let Some(change) = &release.change {
        let motion = change.keyframe_motions[0];
        assert_eq!((motion.keyframe, motion.translation_m), (change.moved[0], [0.25, 0.0, 0.0]));
    }
    let map = fetch(&store, &release, None).await.unwrap();
    map.validate().unwrap();
    assert!(map.info.sessions.len() == 1 && map.audit_sessions().is_empty());
    assert_eq!((map.keyframes.len(), map.common_errors.len(), map.aliases.len()), (4, 4, 4));
    let is_extended = schema == EXTENDED_RELEASE_SCHEMA;
    let expected = if is_extended { (1, 3) } else { (0, 0) };
    assert_eq!((map.added_features.len(), map.images.len()), expected);
    assert!(map.added_features.iter().all(|added| !added.landmarks.is_empty()));
    assert_eq!((map.digest(), &map.info), (release.digest, &release.map));
    let without = fetch_without_images(&store, &release, None).await.unwrap();
    assert_eq!(without, MapContents { images: Vec::new(), ..map });
    assert_eq!(fetch_coarse(&store, &release, None).await.unwrap().len(), 2);
    for cell in &release.cells {
        let fetched = fetch_cell(&store, &release, cell.cell, None).await.unwrap();
        assert_eq!(fetched.own.len(), cell.keyframes);
    }
}
