//! Commands in a folder of their own.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use map::store::load_map;
use testing::{Place, PlaceOptions, copy_folder};

/// How often a test kills its command, or has its writers meet: `KILLS`, where `just kills` takes 200.
pub fn rounds(without: usize) -> usize {
    std::env::var("KILLS").map_or(without, |text| text.parse().unwrap())
}

/// A folder in which commands run, with a temporary folder that nobody else uses.
pub struct Scratch {
    folder: tempfile::TempDir,
}

impl Scratch {
    pub fn new() -> Scratch {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("tmp")).unwrap();
        Scratch { folder }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The command of a line.
    pub fn command(&self, line: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_driftless"));
        command.args(line.split_whitespace()).current_dir(self.folder.path()).env("TMPDIR", self.path("tmp"));
        command.stdout(Stdio::null()).stderr(Stdio::piped());
        command
    }

    pub fn start(&self, line: &str) -> Child {
        self.command(line).spawn().unwrap()
    }

    /// Runs a command that must succeed; returns how long it took.
    pub fn run(&self, line: &str) -> Duration {
        let begin = Instant::now();
        let ended = self.start(line).wait_with_output().unwrap();
        assert!(ended.status.success(), "{line}: {}", String::from_utf8_lossy(&ended.stderr));
        begin.elapsed()
    }

    pub fn left_in_temporary_folder(&self) -> Vec<PathBuf> {
        std::fs::read_dir(self.path("tmp")).unwrap().map(|entry| entry.unwrap().path()).collect()
    }

    /// Replaces a map by a copy of another.
    pub fn copy_map(&self, from: &Path, name: &str) {
        let to = self.path(name);
        let _ = std::fs::remove_dir_all(&to);
        copy_folder(from, &to);
    }
}

/// A map of a place without images; those of different seeds have different numbers of keyframes.
pub fn place(seed: u64) -> map::MapContents {
    let keyframes = 20 + seed as usize;
    Place::new(&PlaceOptions { seed, keyframes, landmarks: 800, ..PlaceOptions::default() }).map
}

/// The keyframes of a map.
pub fn ids(path: &Path) -> BTreeSet<u64> {
    load_map(path).unwrap().contents.keyframes.iter().map(|keyframe| keyframe.id).collect()
}

/// A town that was driven through twice: `town/live`, and a map of each drive, `hall.db` and `second.db`. Made once.
pub fn town() -> PathBuf {
    testing::made_once("town", &[Path::new(env!("CARGO_BIN_EXE_driftless"))], |folder| {
        let scratch = Scratch::new();
        scratch.run("simulate --out town --duration 12");
        for (drive, map) in [("map", "hall.db"), ("live", "second.db")] {
            scratch.run(&format!("build-map town/{drive} --map {map} --sigma-pixel 1 --gravity 0,0,-1"));
        }
        for name in ["town", "hall.db", "second.db"] {
            copy_folder(&scratch.path(name), &folder.join(name));
        }
    })
}

/// Another folder with what the town has, as far as a command needs it.
pub fn in_town() -> Scratch {
    let (scratch, town) = (Scratch::new(), town());
    for name in ["hall.db", "second.db"] {
        scratch.copy_map(&town.join(name), name);
    }
    scratch.copy_map(&town.join("hall.db"), "whole.db");
    std::os::unix::fs::symlink(town.join("town"), scratch.path("town")).unwrap();
    scratch
}
