//! Commands that are killed at any time, and commands that change one map at once.
//!
//! `KILLS` is how often each command is killed; `just kills` takes 200.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use map::store::{load_map, save_map};
use map::text::write_map;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use testing::{Place, PlaceOptions};

fn kills() -> usize {
    std::env::var("KILLS").map_or(6, |text| text.parse().unwrap())
}

struct Scratch {
    folder: tempfile::TempDir,
}

impl Scratch {
    fn new() -> Scratch {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("tmp")).unwrap();
        Scratch { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A command whose temporary folder nobody else uses.
    fn start(&self, line: &str) -> Child {
        let mut command = Command::new(env!("CARGO_BIN_EXE_driftless"));
        command.args(line.split_whitespace()).current_dir(self.folder.path()).env("TMPDIR", self.path("tmp"));
        command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    }

    fn run(&self, line: &str) -> Duration {
        let begin = Instant::now();
        let ended = self.start(line).wait_with_output().unwrap();
        assert!(ended.status.success(), "{line}: {}", String::from_utf8_lossy(&ended.stderr));
        begin.elapsed()
    }

    fn left_in_temporary_folder(&self) -> Vec<PathBuf> {
        std::fs::read_dir(self.path("tmp")).unwrap().map(|entry| entry.unwrap().path()).collect()
    }
}

fn place(seed: u64) -> map::MapContents {
    Place::new(&PlaceOptions { seed, keyframes: 20, landmarks: 800, ..PlaceOptions::default() }).map
}

fn ids(path: &Path) -> BTreeSet<u64> {
    load_map(path).unwrap().whole().unwrap().keyframes.iter().map(|keyframe| keyframe.id).collect()
}

/// Kills a command again and again; `check` is called after each kill.
fn kill(scratch: &Scratch, line: &str, seed: u64, mut prepare: impl FnMut(), mut check: impl FnMut()) {
    let mut rng = StdRng::seed_from_u64(seed);
    prepare();
    let whole = scratch.run(line);
    for kill in 0..kills() {
        prepare();
        // Half of them at any time, half in the last 50 ms.
        let begin =
            if kill % 2 == 0 { Duration::ZERO } else { whole.saturating_sub(Duration::from_millis(50)) };
        let mut running = scratch.start(line);
        std::thread::sleep(begin + whole.saturating_sub(begin).mul_f64(rng.random_range(0.0..1.0)));
        running.kill().unwrap();
        running.wait().unwrap();
        check();
    }
    scratch.run("map-info --map whole.db");
    let left = scratch.left_in_temporary_folder();
    assert!(left.is_empty(), "{line}: {left:?}");
}

/// What was there before, or what the command makes; both must have been met where there are enough kills.
#[test]
fn a_killed_edit_import_or_merge_leaves_the_old_map_or_the_new_one() {
    let scratch = Scratch::new();
    let (hall, whole) = (scratch.path("hall.db"), scratch.path("whole.db"));
    save_map(&whole, &place(1), false).unwrap();
    write_map(&scratch.path("text"), &place(2)).unwrap();
    let all = ids(&whole);
    let without_first: BTreeSet<u64> = all.iter().copied().skip(1).collect();
    let first = all.first().unwrap();
    let restore = || {
        let _ = std::fs::remove_dir_all(&hall);
        save_map(&hall, &place(1), false).unwrap();
    };
    let is_old_or_new = |new: &BTreeSet<u64>| {
        let found = ids(&hall);
        assert!(found == all || found == *new, "{found:?}");
    };
    kill(&scratch, &format!("edit-map --map hall.db --remove {first}"), 1, restore, || {
        is_old_or_new(&without_first);
    });
    scratch.run("import-map text --map second.db");
    let second = ids(&scratch.path("second.db"));
    kill(&scratch, "import-map text --map hall.db --force", 2, restore, || is_old_or_new(&second));
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
    kill(&scratch, "publish-map --map whole.db --to city", 3, restore, || {
        if released.join("releases").is_dir() {
            scratch.start("list-releases city").wait().unwrap();
        }
        scratch.run("publish-map --map whole.db --to city");
        scratch.run("list-releases city");
    });
}

#[test]
fn of_two_edits_at_once_one_is_refused_and_says_why() {
    let scratch = Scratch::new();
    let hall = scratch.path("hall.db");
    let (all, mut refused) = (place(1), 0);
    let [first, second] = [all.keyframes[0].id, all.keyframes[1].id];
    for _ in 0..kills() {
        let _ = std::fs::remove_dir_all(&hall);
        save_map(&hall, &all, false).unwrap();
        let edits = [first, second].map(|id| scratch.start(&format!("edit-map --map hall.db --remove {id}")));
        let ended = edits.map(|edit| edit.wait_with_output().unwrap());
        let taken = ended.iter().filter(|ended| ended.status.success()).count();
        let left = ids(&hall);
        assert_eq!(left.len(), all.keyframes.len() - taken, "nothing that was acknowledged is lost");
        assert!(taken >= 1);
        for ended in ended.iter().filter(|ended| !ended.status.success()) {
            let complaint = String::from_utf8_lossy(&ended.stderr);
            assert!(
                complaint.contains("was changed meanwhile") || complaint.contains("in use"),
                "{complaint}"
            );
            refused += 1;
        }
    }
    println!("{refused} of {} were refused", kills());
}
