//! Commands that are killed at any time.

use std::time::Duration;

use map::store::save_map;
use map_io::text::write_map;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
#[cfg(feature = "releases")]
use testing::copy_folder;

use crate::scratch::{Scratch, ids, in_town, place, rounds, town};

/// Kills a command again and again; `check` is called after each kill.
///
/// # Arguments
/// * `kills`: how often, where `KILLS` does not say it.
fn kill(
    scratch: &Scratch,
    line: &str,
    (kills, seed): (usize, u64),
    mut prepare: impl FnMut(),
    mut check: impl FnMut(),
) {
    let mut rng = StdRng::seed_from_u64(seed);
    prepare();
    let mut whole = scratch.run(line);
    for kill in 0..rounds(kills) {
        prepare();
        // Half of them at any time, half in the last 50 ms.
        let begin =
            if kill % 2 == 0 { Duration::ZERO } else { whole.saturating_sub(Duration::from_millis(50)) };
        let mut running = scratch.start(line);
        std::thread::sleep(begin + whole.saturating_sub(begin).mul_f64(rng.random_range(0.0..1.0)));
        let has_ended = running.try_wait().unwrap().is_some();
        running.kill().unwrap();
        running.wait().unwrap();
        // What else the machine does changes how long a command takes.
        whole = whole.mul_f64(if has_ended { 0.98 } else { 1.005 });
        check();
    }
    scratch.run("map-info --map whole.db");
    let left = scratch.left_in_temporary_folder();
    assert!(left.is_empty(), "{line}: {left:?}");
}

/// Kills a command that changes `hall.db`: what was there before stays, or what the command makes.
fn kill_a_change(scratch: &Scratch, line: &str, how: (usize, u64), mut restore: impl FnMut()) {
    let hall = scratch.path("hall.db");
    restore();
    let old = ids(&hall);
    scratch.run(line);
    let new = ids(&hall);
    assert_ne!(old, new);
    let mut met = [0, 0];
    kill(scratch, line, how, restore, || {
        let found = ids(&hall);
        let is_new = found == new;
        assert!(is_new || found == old, "{line}: {found:?}");
        met[usize::from(is_new)] += 1;
    });
    println!("{line}: {} times the old map, {} times the new one", met[0], met[1]);
}

#[test]
fn a_killed_edit_or_import_leaves_the_old_map_or_the_new_one() {
    let scratch = Scratch::new();
    let hall = scratch.path("hall.db");
    save_map(&scratch.path("whole.db"), &place(1), false).unwrap();
    write_map(&scratch.path("text"), &place(2)).unwrap();
    let first = place(1).keyframes[0].id;
    let restore = || {
        let _ = std::fs::remove_dir_all(&hall);
        save_map(&hall, &place(1), false).unwrap();
    };
    kill_a_change(&scratch, &format!("edit-map --map hall.db --remove {first}"), (6, 1), restore);
    kill_a_change(&scratch, "import-map text --map hall.db --force", (6, 2), restore);
}

#[test]
fn a_killed_merge_leaves_the_old_map_or_the_new_one() {
    let scratch = in_town();
    let restore = || scratch.copy_map(&town().join("hall.db"), "hall.db");
    kill_a_change(&scratch, "merge-maps hall.db second.db --map hall.db --force", (6, 4), restore);
}

#[test]
fn a_killed_extension_leaves_the_old_map_or_the_new_one() {
    kill_extensions(4);
}

#[test]
#[ignore = "more kills"]
fn a_killed_extension_leaves_the_old_map_or_the_new_one_again_and_again() {
    kill_extensions(20);
}

fn kill_extensions(kills: usize) {
    let scratch = in_town();
    let restore = || scratch.copy_map(&town().join("hall.db"), "hall.db");
    kill_a_change(&scratch, "build-map town/live --map hall.db --extend", (kills, 5), restore);
}

#[test]
fn a_killed_night_leaves_the_old_map_or_the_new_one_and_a_true_ledger() {
    kill_nights(4);
}

#[test]
#[ignore = "more kills"]
fn a_killed_night_leaves_the_old_map_or_the_new_one_and_a_true_ledger_again_and_again() {
    kill_nights(20);
}

fn kill_nights(kills: usize) {
    let scratch = in_town();
    scratch.run("run town/live --map hall.db --out run --hand-in recorded");
    let restore = || {
        scratch.copy_map(&town().join("hall.db"), "hall.db");
        // A session that the program was killed with twice is passed over.
        let _ = std::fs::remove_file(scratch.path("hall.db.refused.json"));
    };
    kill_a_change(&scratch, "maintain --map hall.db --inbox recorded --save-minutes 0", (kills, 7), restore);
    scratch.run("map-info --map hall.db --audit");
}

#[cfg(feature = "releases")]
#[test]
fn a_killed_publication_is_a_release_or_none() {
    let scratch = Scratch::new();
    save_map(&scratch.path("whole.db"), &place(1), false).unwrap();
    let released = scratch.path("city");
    let restore = || {
        let _ = std::fs::remove_dir_all(&released);
    };
    kill(&scratch, "publish-map --map whole.db --to city", (6, 3), restore, || {
        if released.join("releases").is_dir() {
            scratch.start("list-releases city").wait().unwrap();
        }
        scratch.run("publish-map --map whole.db --to city");
        scratch.run("list-releases city");
    });
}

#[cfg(feature = "releases")]
#[test]
fn a_killed_promotion_leaves_the_live_release_or_the_candidate_and_is_ended_by_another() {
    let scratch = Scratch::new();
    save_map(&scratch.path("whole.db"), &place(1), false).unwrap();
    save_map(&scratch.path("next.db"), &place(1), false).unwrap();
    scratch.run("edit-map --map next.db --remove 12");
    scratch.run("publish-map --map whole.db --to before");
    scratch.run("publish-map --map next.db --to before --stage candidate");
    let [old, new] = ["whole.db", "next.db"].map(|map| ids(&scratch.path(map)));
    let restore = || {
        let _ = std::fs::remove_dir_all(scratch.path("city"));
        copy_folder(&scratch.path("before"), &scratch.path("city"));
    };
    kill(&scratch, "promote-release city 1", (6, 6), restore, || {
        scratch.run("list-releases city");
        scratch.run("checkout city --map now.db --force");
        let found = ids(&scratch.path("now.db"));
        assert!(found == old || found == new, "{found:?}");
        scratch.run("promote-release city 1");
        scratch.run("checkout city --map now.db");
        assert_eq!(ids(&scratch.path("now.db")), new);
    });
}
