//! Commands that change one map or one store at once.

use std::process::Output;

use map::store::save_map;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use crate::scratch::{Scratch, ids, in_town, place, rounds, town};

/// Whether a command was refused, which it must say.
fn is_refused(ended: &Output) -> bool {
    let complaint = String::from_utf8_lossy(&ended.stderr);
    let said = complaint.contains("was changed meanwhile") || complaint.contains("in use");
    assert!(ended.status.success() || said, "{complaint}");
    !ended.status.success()
}

#[test]
fn of_two_edits_at_once_one_is_refused_and_says_why() {
    let scratch = Scratch::new();
    let hall = scratch.path("hall.db");
    let (all, mut refused) = (place(1), 0);
    let [first, second] = [all.keyframes[0].id, all.keyframes[1].id];
    for _ in 0..rounds(6) {
        let _ = std::fs::remove_dir_all(&hall);
        save_map(&hall, &all, false).unwrap();
        let edits = [first, second].map(|id| scratch.start(&format!("edit-map --map hall.db --remove {id}")));
        let ended = edits.map(|edit| edit.wait_with_output().unwrap());
        let taken = 2 - ended.iter().filter(|ended| is_refused(ended)).count();
        assert_eq!(ids(&hall).len(), all.keyframes.len() - taken, "nothing that was acknowledged is lost");
        assert!(taken >= 1);
        refused += 2 - taken;
    }
    println!("{refused} of {} were refused", rounds(6));
}

#[test]
fn a_merge_beside_an_edit_loses_neither() {
    let scratch = in_town();
    let hall = scratch.path("hall.db");
    let mut rng = StdRng::seed_from_u64(6);
    let merge = "merge-maps hall.db second.db --map hall.db --force";
    let before = ids(&hall);
    let first = *before.first().unwrap();
    let whole = scratch.run(merge);
    let merged = ids(&hall);
    let mut refused = [0, 0];
    for _ in 0..rounds(6) {
        scratch.copy_map(&town().join("hall.db"), "hall.db");
        let merging = scratch.start(merge);
        std::thread::sleep(whole.mul_f64(rng.random_range(0.0..1.1)));
        let editing = scratch.start(&format!("edit-map --map hall.db --remove {first}"));
        let [merging, editing] =
            [merging, editing].map(|running| is_refused(&running.wait_with_output().unwrap()));
        let expected = if merging { &before } else { &merged };
        let mut expected = expected.clone();
        if !editing {
            expected.remove(&first);
        }
        assert!(!merging || !editing);
        let found = ids(&hall);
        // A merge that began after the edit numbers the other map's keyframes beyond what is left.
        assert!(found == expected || !merging && !editing && found.len() == expected.len(), "{found:?}");
        refused[0] += usize::from(merging);
        refused[1] += usize::from(editing);
    }
    println!("{} merges and {} edits of {} were refused", refused[0], refused[1], rounds(6));
}

#[cfg(feature = "releases")]
#[test]
fn a_publication_beside_a_merge_is_of_one_version_as_a_whole() {
    let scratch = in_town();
    let mut rng = StdRng::seed_from_u64(7);
    let merge = "merge-maps hall.db second.db --map hall.db --force";
    let publish = "publish-map --map hall.db --to city";
    let (old, whole) = (ids(&scratch.path("hall.db")), scratch.run(merge));
    let new = ids(&scratch.path("hall.db"));
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let mut met = [0, 0];
    for _ in 0..rounds(6) {
        let _ = std::fs::remove_dir_all(scratch.path("city"));
        scratch.copy_map(&town().join("hall.db"), "hall.db");
        let merging = scratch.start(merge);
        std::thread::sleep(whole.mul_f64(rng.random_range(0.0..1.1)));
        let publishing = scratch.start(publish);
        let ended = [merging, publishing].map(|running| running.wait_with_output().unwrap());
        for ended in &ended {
            assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
        }
        let published = || {
            let store = releases::ReleaseStore::open(scratch.path("city").to_str().unwrap()).unwrap();
            runtime.block_on(async {
                let release = store.newest().await.unwrap().unwrap();
                let contents = releases::fetch(&store, &release, None).await.unwrap();
                contents.keyframes.iter().map(|keyframe| keyframe.id).collect()
            })
        };
        let found: std::collections::BTreeSet<u64> = published();
        assert!(found == old || found == new, "{found:?}");
        met[usize::from(found == new)] += 1;
        scratch.run(publish);
        assert_eq!(published(), new, "the next one has what was merged");
    }
    println!("{} releases of the map before, {} of the merged one", met[0], met[1]);
}
