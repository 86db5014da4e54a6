//! The ledger of sessions in releases: of the whole map, of a cell, and what is new in the next release.

use map::sessions::{RecordedDigest, Session};
use map::{MapContents, edit};
use releases::{Outcome, PublishOptions, Release, ReleaseStore, fetch, fetch_cell, publish};
use testing::{Place, PlaceOptions};

fn session(name: &str, begin_s: i64, keyframe_ids: [u64; 2]) -> Session {
    let mut digest = RecordedDigest::default();
    for at in 200 * begin_s..200 * (begin_s + 60) {
        digest.add_reading(at * 5_000_000, [at as f64 * 1e-3, 0.1, 0.2, 0.3, 0.4, 9.8]);
    }
    digest.add_image(begin_s * 1_000_000_000);
    digest.add_image((begin_s + 60) * 1_000_000_000);
    Session { keyframe_ids, ..Session::new(digest.finish(), name) }
}

/// A map of two drives, with half of its keyframes each.
fn two_drives() -> MapContents {
    let mut map = Place::new(&PlaceOptions { keyframes: 24, landmarks: 600, ..PlaceOptions::default() }).map;
    map.sort();
    let ids: Vec<u64> = map.keyframes.iter().map(|keyframe| keyframe.id).collect();
    map.info.sessions =
        vec![session("monday", 0, [ids[0], ids[11]]), session("tuesday", 100, [ids[12], ids[23]])];
    map
}

async fn published(store: &ReleaseStore, contents: &MapContents) -> Release {
    let mut options = PublishOptions::default();
    options.keyframes_a_cell = 6;
    match publish(store, contents.clone(), &options, |_| {}).await.unwrap() {
        Outcome::Published(published) => published.release,
        Outcome::Unchanged { number } => panic!("release {number} has it already"),
    }
}

#[tokio::test]
async fn a_release_has_the_ledger_and_a_cell_the_part_of_it_that_is_about_its_keyframes() {
    let folder = tempfile::tempdir().unwrap();
    let store = ReleaseStore::open(folder.path().join("city").to_str().unwrap()).unwrap();
    let map = two_drives();
    let mut monday = map.clone();
    let of_tuesday =
        edit::keyframes_where(&map, |keyframe| map.info.sessions[1].ids().contains(&keyframe.id));
    edit::remove_keyframes(&mut monday, &of_tuesday);
    monday.info.sessions.truncate(1);
    let first = published(&store, &monday).await;
    let release = published(&store, &map).await;
    let difference = first.difference(&release).sessions;
    assert_eq!((difference.added.len(), difference.removed.len()), (1, 0));
    assert_eq!((difference.added[0].name.as_str(), difference.added[0].keyframes), ("tuesday", 12));

    let whole = fetch(&store, &release, None).await.unwrap();
    assert!(whole.audit_sessions().is_empty());
    assert_eq!(whole.info.sessions, release.map.sessions);
    assert!(whole.info.sessions.iter().all(|session| session.added_unix_s.is_some()));
    for cell in &release.cells {
        let part = fetch_cell(&store, &release, cell.cell, None).await.unwrap().contents;
        assert!(part.audit_sessions().is_empty());
        let counted: u64 = part.info.sessions.iter().map(|session| session.keyframes).sum();
        assert_eq!(counted as usize, part.keyframes.len());
        assert!(part.info.sessions.iter().all(|session| session.keyframes > 0));
    }
}
