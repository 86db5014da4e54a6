//! Cells that are served by themselves: each has all that the map has about its keyframes, and releases say what changed.

use map::{CommonError, Keyframe, KeyframeAliases, KeyframeCrossCovariance, MapContents};
use nalgebra::Matrix6;
use protocol::{KeyframeId, KeyframeMotion};
use releases::{
    Cell, Note, Outcome, PublishOptions, Release, ReleaseError, ReleaseStore, ReleasedChange, fetch,
    fetch_cell, fetch_coarse, publish, roll_back,
};
use std::collections::{BTreeMap, BTreeSet};
use tempfile::TempDir;
use testing::{Place, PlaceOptions, add_aliases, add_common_errors, add_existence};

/// A map in which every keyframe is correlated with many others, as after a bundle adjustment.
fn place(seed: u64) -> MapContents {
    let mut contents =
        Place::new(&PlaceOptions { seed, keyframes: 36, landmarks: 1200, ..PlaceOptions::default() }).map;
    contents.sort();
    let variance = contents.keyframes[0].global_from_keyframe.covariance;
    contents.cross_covariances.clear();
    for (at, a) in contents.keyframes.iter().enumerate() {
        for b in contents.keyframes.iter().skip(at + 1).step_by(3) {
            let block = variance * (0.4 / (1.0 + b.id as f64 - a.id as f64));
            contents.cross_covariances.push(KeyframeCrossCovariance { a: a.id, b: b.id, block });
        }
    }
    contents.sort();
    contents.info.identity = Some(contents.digest());
    contents.info.version = 1;
    contents
}

fn store() -> (TempDir, ReleaseStore) {
    let folder = tempfile::tempdir().unwrap();
    let store = ReleaseStore::open(folder.path().join("city").to_str().unwrap()).unwrap();
    (folder, store)
}

async fn published(store: &ReleaseStore, contents: &MapContents, keyframes_a_cell: usize) -> Release {
    let mut options = PublishOptions::default();
    options.keyframes_a_cell = keyframes_a_cell;
    match publish(store, contents.clone(), &options, |_| {}).await.unwrap() {
        Outcome::Published(published) => published.release,
        Outcome::Unchanged { number } => panic!("release {number} has it already"),
    }
}

type Blocks = BTreeMap<(KeyframeId, KeyframeId), Matrix6<f64>>;

fn blocks<'a>(crosses: impl IntoIterator<Item = &'a KeyframeCrossCovariance>) -> Blocks {
    crosses.into_iter().map(|cross| ((cross.a, cross.b), cross.block)).collect()
}

#[tokio::test]
async fn a_cell_has_all_that_the_map_has_about_its_keyframes_and_those_of_its_border() {
    for (seed, keyframes_a_cell) in [(1, 6), (2, 10), (3, 20), (4, 100)] {
        let (_folder, store) = store();
        let mut contents = place(seed);
        if seed % 2 == 0 {
            add_common_errors(&mut contents, 3);
        }
        if seed > 2 {
            add_aliases(&mut contents);
        }
        if seed > 1 {
            add_existence(&mut contents);
        }
        let release = published(&store, &contents, keyframes_a_cell).await;
        assert_eq!(fetch(&store, &release, None).await.unwrap(), contents);
        let all = blocks(&contents.cross_covariances);
        let mut owned = BTreeSet::new();
        for released in &release.cells {
            let Cell { own, contents: part, far_cross_covariances, aliases } =
                fetch_cell(&store, &release, released.cell, None).await.unwrap();
            assert_eq!(own.len(), released.keyframes);
            assert!(own.iter().all(|id| owned.insert(*id)), "keyframes of two cells");
            assert_eq!(part.info.identity, contents.info.identity);

            // Every landmark that a keyframe of the cell observes, with all its observations.
            let is_own = |id: KeyframeId| own.binary_search(&id).is_ok();
            let observed = contents
                .landmarks
                .iter()
                .filter(|landmark| landmark.observations.iter().any(|seen| is_own(seen.keyframe)));
            assert_eq!(part.landmarks, observed.cloned().collect::<Vec<_>>());

            // Every correlation of the keyframes that an answer of the cell can have, with any other.
            let inside: BTreeSet<KeyframeId> = part.keyframes.iter().map(|keyframe| keyframe.id).collect();
            let expected: Blocks = all
                .iter()
                .filter(|((a, b), _)| inside.contains(a) || inside.contains(b))
                .map(|(pair, block)| (*pair, *block))
                .collect();
            let near = blocks(&part.cross_covariances);
            let far = blocks(&far_cross_covariances);
            let is_part = |common: &&CommonError| part.keyframes.iter().any(|own| own.id == common.keyframe);
            let common: Vec<CommonError> = contents.common_errors.iter().filter(is_part).cloned().collect();
            assert_eq!(part.common_errors, common);
            // What its own keyframes could be taken for, in whatever cell that is.
            let of_own: Vec<KeyframeAliases> =
                contents.aliases.iter().filter(|aliases| is_own(aliases.keyframe)).cloned().collect();
            assert_eq!(aliases, of_own);
            assert_eq!(near.len() + far.len(), expected.len());
            assert_eq!(near.into_iter().chain(far).collect::<Blocks>(), expected);
            for keyframe in &part.keyframes {
                let of_map = contents.keyframes.iter().find(|other| other.id == keyframe.id).unwrap();
                assert_eq!(of_map.global_from_keyframe, keyframe.global_from_keyframe);
            }
        }
        assert_eq!(owned.len(), contents.keyframes.len());
        let coarse = fetch_coarse(&store, &release, None).await.unwrap();
        let keyframes: usize = coarse.values().map(|cell| cell.keyframes.len()).sum();
        assert_eq!(keyframes, contents.keyframes.len());
    }
}

#[tokio::test]
async fn a_release_says_what_changed_and_so_do_several() {
    let (_folder, store) = store();
    let first = place(5);
    let release = published(&store, &first, 6).await;
    assert_eq!(release.change, None);

    // One keyframe moves, another one loses a landmark's observation, a third one is more correlated with a fourth.
    let mut second = first.clone();
    second.keyframes[4].global_from_keyframe.pose.translation.x += 0.3;
    second.keyframes[9].global_from_keyframe.pose.translation.x += 1e-9;
    let observed_by = |contents: &MapContents, keyframe: KeyframeId| {
        let is_seen = |landmark: &map::Landmark| {
            landmark.anchor != keyframe && landmark.observations.iter().any(|seen| seen.keyframe == keyframe)
        };
        contents.landmarks.iter().position(is_seen).unwrap()
    };
    let lost = second.keyframes[20].id;
    let landmark = observed_by(&second, lost);
    second.landmarks[landmark].observations.retain(|seen| seen.keyframe != lost);
    second.cross_covariances[100].block *= 1.5;
    let pair = [second.cross_covariances[100].a, second.cross_covariances[100].b];
    let change = published(&store, &second, 6).await.change.unwrap();
    let mut moved = vec![second.keyframes[4].id, pair[0], pair[1]];
    moved.sort_unstable();
    moved.dedup();
    assert_eq!((change.from_version, &change.moved, change.removed.len()), (1, &moved, 0));
    let mut changed = moved.clone();
    changed.push(lost);
    changed.sort_unstable();
    changed.dedup();
    assert_eq!(change.changed, changed);
    // One of 36 keyframes by 0.3 m along one axis.
    let size = change.stated_change.unwrap();
    assert!((size.sigma_p_m - (0.3_f64.powi(2) / (3.0 * 36.0)).sqrt()).abs() < 1e-6, "{size:?}");
    assert!(size.sigma_theta_rad < 1e-9);

    // The last keyframe goes; who has the first release learns of both changes.
    let mut third = second.clone();
    let last = third.keyframes.last().unwrap().id;
    let removed = map::edit::keyframes_where(&third, |keyframe: &Keyframe| keyframe.id == last);
    map::edit::remove_keyframes(&mut third, &removed);
    third.sort();
    let newest = published(&store, &third, 6).await;
    let only_last = store.change_since(2, &newest).await.unwrap().unwrap();
    assert_eq!((only_last.from_version, &only_last.removed, only_last.moved.len()), (2, &vec![last], 0));
    let both = store.change_since(1, &newest).await.unwrap().unwrap();
    assert_eq!((both.from_version, &both.removed, &both.moved), (1, &vec![last], &moved));
    assert!(both.stated_change.unwrap().sigma_p_m >= size.sigma_p_m);
    // Keyframe 4 by 0.3 m; those with other correlations not at all, and of the last one, which is gone, it is not known.
    let distances = |change: &ReleasedChange| -> Vec<(u64, f32)> {
        let length = |motion: &KeyframeMotion| motion.translation_m.iter().map(|m| m * m).sum::<f32>().sqrt();
        change.keyframe_motions.iter().map(|motion| (motion.keyframe, length(motion))).collect()
    };
    let stays = |id: &&u64| **id != last;
    let expected: Vec<(u64, f32)> = moved
        .iter()
        .filter(stays)
        .map(|&id| (id, if id == second.keyframes[4].id { 0.3 } else { 0.0 }))
        .collect();
    for (told, expected) in std::iter::zip(distances(&both), &expected) {
        assert!(told.0 == expected.0 && (told.1 - expected.1).abs() < 1e-6, "{told:?} {expected:?}");
    }
    assert_eq!(distances(&both).len(), expected.len());
    assert_eq!(store.change_since(0, &newest).await.unwrap(), None);

    // Back again: the same keyframes move, and the one that was removed is new.
    let Outcome::Published(back) = roll_back(&store, 1, &Note::default()).await.unwrap() else {
        panic!("nothing changed")
    };
    let change = back.release.change.unwrap();
    assert_eq!((change.from_version, &change.moved, change.removed.len()), (3, &moved, 0));
    // Forth and back.
    let there = both.keyframe_motions.iter().find(|motion| motion.keyframe == second.keyframes[4].id);
    let back = change.keyframe_motions.iter().find(|motion| motion.keyframe == second.keyframes[4].id);
    let (there, back) = (there.unwrap().translation_m, back.unwrap().translation_m);
    assert!(std::iter::zip(there, back).all(|(there, back)| (there + back).abs() < 1e-6));
    let size = change.stated_change.unwrap().sigma_p_m;
    assert!((size - (0.3_f64.powi(2) / (3.0 * 35.0)).sqrt()).abs() < 1e-6, "{size}");
}

#[tokio::test]
async fn a_release_of_another_schema_is_refused_with_both_numbers() {
    let (folder, store) = store();
    let contents = place(6);
    let release = published(&store, &contents, 6).await;
    let error = fetch_cell(&store, &release, 999, None).await.unwrap_err();
    assert!(matches!(error, ReleaseError::NoCell { cell: 999, .. }), "{error}");
    let path = folder.path().join("city/releases/00000000000000000001.json");
    let mut value: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    value["schema"] = 3.into();
    value["unknown"] = 1.into();
    std::fs::write(&path, value.to_string()).unwrap();
    let error = store.newest().await.unwrap_err().to_string();
    assert!(error.contains("schema 3") && error.contains("reads 8"), "{error}");
}
