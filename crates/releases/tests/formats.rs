//! A folder of every released format is read. Nothing is released yet: those are the one that is written today, and the one before,
//! which differs in the change only.

use std::path::Path;

use releases::{PublishOptions, ReleaseStore, fetch, fetch_cell, fetch_coarse, publish};
use testing::{Place, PlaceOptions, add_aliases, add_common_errors};

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

async fn is_read(schema: u16) {
    let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/data/release_{schema}"));
    let store = ReleaseStore::open(kept.to_str().unwrap()).unwrap();
    if schema == releases::release::RELEASE_SCHEMA && std::env::var_os(UPDATE).is_some() {
        let _ = std::fs::remove_dir_all(&kept);
        let mut map =
            Place::new(&PlaceOptions { keyframes: 4, landmarks: 12, ..PlaceOptions::default() }).map;
        add_common_errors(&mut map, 2);
        add_aliases(&mut map);
        map.ensure_sessions("drive_1");
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
    assert_eq!((map.digest(), map.info), (release.digest, release.map.clone()));
    assert_eq!(fetch_coarse(&store, &release, None).await.unwrap().len(), 2);
    for cell in &release.cells {
        let fetched = fetch_cell(&store, &release, cell.cell, None).await.unwrap();
        assert_eq!(fetched.own.len(), cell.keyframes);
    }
}
