//! A map is unchanged after its server was killed, and after export and import.

use crate::common::requests::{images, request};
use crate::common::scenario::MappedScenario;
use map::store;
use map_io::text::{read_map, write_map};
use protocol::MatchReply;
use recognition::{LoadedMap, RecognitionOptions};
use testing::copy_folder;

/// The answers to all images of the live run, but for how long they took.
fn answers(map: &LoadedMap, scenario: &MappedScenario) -> Vec<MatchReply> {
    let live = &scenario.recordings.live;
    let mut all = Vec::new();
    for frame in images(live) {
        let mut replies = map.answer(&request(live, frame), &RecognitionOptions::default()).unwrap();
        if let Some(MatchReply::Done(status)) = replies.last_mut() {
            status.elapsed_us = 0;
        }
        all.extend(replies);
    }
    all
}

#[test]
fn a_map_that_was_acknowledged_is_whole_after_a_kill_and_answers_alike() {
    let scenario = MappedScenario::shared();
    let folder = tempfile::tempdir().unwrap();
    let (path, killed) = (folder.path().join("ring.db"), folder.path().join("killed.db"));
    let saved = store::save_map(&path, &scenario.map, false).unwrap();
    // What the disk holds when writing is acknowledged is what a kill leaves behind.
    copy_folder(&path, &killed);
    let contents = store::load_map(&killed).unwrap().contents;
    assert_eq!((contents.info.version, contents.info.identity), (saved.version, Some(saved.identity)));
    assert_eq!(contents.keyframes, scenario.map.keyframes);
    assert_eq!(contents.landmarks, scenario.map.landmarks);
    let found = answers(&LoadedMap::read(&path).unwrap(), scenario);
    assert!(found.iter().filter(|reply| matches!(reply, MatchReply::Keyframe(_))).count() > 100);
    assert_eq!(found, answers(&LoadedMap::from_contents(contents).unwrap(), scenario));
}

#[test]
fn a_map_that_was_exported_and_imported_answers_alike_and_is_the_same_map() {
    let scenario = MappedScenario::shared();
    let folder = tempfile::tempdir().unwrap();
    let path = scenario.database(folder.path());
    let text = folder.path().join("text");
    write_map(&text, &store::load_map(&path).unwrap().contents).unwrap();
    let second = folder.path().join("second.db");
    store::save_map(&second, &read_map(&text).unwrap(), false).unwrap();
    let (original, imported) = (LoadedMap::read(&path).unwrap(), LoadedMap::read(&second).unwrap());
    assert_eq!(original.identity(), imported.identity());
    assert_eq!(answers(&original, scenario), answers(&imported, scenario));
}

#[test]
fn what_is_no_map_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let photos = folder.path().join("photos");
    std::fs::create_dir(&photos).unwrap();
    std::fs::write(photos.join("a.png"), b"not a map").unwrap();
    let error = LoadedMap::read(&photos).err().unwrap().to_string();
    assert!(error.contains("photos") && error.contains("not a Driftless map"), "{error}");
    let error = LoadedMap::read(folder.path().join("nowhere")).err().unwrap().to_string();
    assert!(error.contains("nowhere") && error.contains("build-map"), "{error}");
    assert!(!folder.path().join("nowhere").exists());
}
