//! Writing a map is interrupted: by a kill, by a full disk, by another writer. The map that was there remains.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use map::sessions::{Session, SessionId};
use map::{MapContents, StoreError, store};
use testing::{Place, PlaceOptions};

const CHILD_PATH: &str = "MAP_STORE_TEST_CHILD";
const CHILD_SEED: &str = "MAP_STORE_TEST_SEED";

fn place(seed: u64) -> MapContents {
    let options = PlaceOptions { seed, keyframes: 12, landmarks: 600, ..PlaceOptions::default() };
    let mut map = Place::new(&options).map;
    map.ensure_sessions(&format!("drive_{seed}"));
    map
}

fn read(path: &Path) -> MapContents {
    store::load_map(path).unwrap().contents
}

/// A child process that writes a map over and over; `before` is a shell command that is run first.
fn child(before: &str, path: &Path, seed: u64) -> Command {
    let mut command = Command::new("sh");
    let program = std::env::current_exe().unwrap();
    let run =
        format!("{before} exec '{}' interrupted::child_that_writes --exact --nocapture", program.display());
    command.args(["-c", &run]).env(CHILD_PATH, path).env(CHILD_SEED, seed.to_string()).stdin(Stdio::null());
    command
}

/// Not a law by itself: what the child processes of the others do.
#[test]
fn child_that_writes() {
    let Ok(path) = std::env::var(CHILD_PATH) else { return };
    let seed: u64 = std::env::var(CHILD_SEED).unwrap().parse().unwrap();
    let contents = place(seed);
    println!("begins");
    match store::save_map(Path::new(&path), &contents, true) {
        Ok(saved) => println!("acknowledged {}", saved.version),
        Err(error) => println!("refused: {error}"),
    }
}

#[test]
fn a_killed_first_import_is_no_map_and_a_killed_replacement_changes_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let places = [1, 2, 3].map(place);
    let place = |seed: usize| &places[seed - 1];
    let (mut unfinished, mut intact) = (0, 0);
    for step in 0..30_u64 {
        // A map is written in some milliseconds.
        let wait = Duration::from_micros(500 * step);
        for replace in [false, true] {
            let path = directory.path().join(format!("{step}-{replace}"));
            if replace {
                store::save_map(&path, place(1), false).unwrap();
            }
            let mut writer =
                child("", &path, 2).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
            let mut lines = std::io::BufRead::lines(std::io::BufReader::new(writer.stdout.take().unwrap()));
            lines.find(|line| line.as_ref().unwrap().contains("begins")).unwrap().unwrap();
            std::thread::sleep(wait);
            writer.kill().unwrap(); // SIGKILL
            writer.wait().unwrap();
            let acknowledged = lines.any(|line| line.unwrap_or_default().contains("acknowledged"));
            match store::load_map(&path) {
                Ok(stored) => {
                    let contents = stored.contents;
                    let seed = if contents.info.version == 1 + u64::from(replace) { 2 } else { 1 };
                    assert!(seed == 2 || !acknowledged);
                    assert_eq!(contents.landmarks, place(seed).landmarks);
                    assert_eq!(contents.info.sessions[0].id, place(seed).info.sessions[0].id);
                    assert!(contents.audit_sessions().is_empty());
                    intact += usize::from(seed == 1);
                }
                Err(error) => {
                    assert!(!replace && !acknowledged, "{error}");
                    let nothing = matches!(
                        error,
                        StoreError::Unfinished { .. }
                            | StoreError::Missing { .. }
                            | StoreError::NotAMap { .. }
                    );
                    assert!(nothing, "{error}");
                    unfinished += 1;
                }
            }
            // Made anew without being asked to replace anything, where there was no map.
            let next = store::save_map(&path, place(3), path.join("manifest.json").exists());
            assert_eq!(read(&path).info.version, next.unwrap().version);
        }
    }
    assert!(unfinished > 0 && intact > 0, "{unfinished} unfinished, {intact} intact");
}

#[test]
fn an_unfinished_map_says_so() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("hall.db");
    store::save_map(&path, &place(1), false).unwrap();
    std::fs::remove_file(path.join("manifest.json")).unwrap();
    let error = store::load_map(&path).unwrap_err();
    assert!(matches!(error, StoreError::Unfinished { .. }), "{error}");
    let said = error.to_string();
    assert!(said.contains("hall.db") && said.contains("unfinished") && said.contains("again"), "{said}");
    assert_eq!(store::save_map(&path, &place(1), false).unwrap().version, 1);
}

#[test]
fn a_full_disk_is_an_error_and_the_old_map_stays() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    store::save_map(&path, &place(1), false).unwrap();
    let before = read(&path);
    let mut whole = 0;
    // Files may grow to so many blocks of 512 bytes; beyond, writing fails as on a full disk.
    for blocks in [0, 1, 40, 400, 800] {
        for target in [&path, &directory.path().join("first")] {
            let output = child(&format!("trap '' XFSZ; ulimit -f {blocks};"), target, 2)
                .stderr(Stdio::piped())
                .output();
            let output = output.unwrap();
            let said = String::from_utf8_lossy(&output.stdout);
            let written = said.contains("acknowledged");
            assert!(written || said.contains("refused: "), "{blocks} blocks: {said}");
            assert!(!String::from_utf8_lossy(&output.stderr).contains("panicked"));
            whole += usize::from(written);
            if written {
                assert_eq!(read(target).landmarks, place(2).landmarks);
            } else if target == &path {
                assert!(said.contains("cannot be written") && said.contains("unchanged"), "{said}");
                assert_eq!(read(target), before);
            }
        }
    }
    assert!((2..6).contains(&whole), "{whole} of 10 were written");
}

#[test]
fn a_ledger_that_nobody_could_read_is_not_written_and_the_old_map_stays() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    store::save_map(&path, &place(1), false).unwrap();
    let before = read(&path);
    let mut long = before.clone();
    let last = long.info.last_session_keyframe().unwrap();
    let template = Session { robot: Some("r".repeat(256)), ..long.info.sessions[0].clone() };
    long.info.sessions.extend((1..90_000_u64).map(|at| Session {
        id: SessionId::from_bytes(u128::from(at).to_le_bytes()),
        name: "n".repeat(256),
        keyframe_ids: [last + at; 2],
        ..template.clone()
    }));
    let refused = store::save_map(&path, &long, true).unwrap_err().to_string();
    assert!(refused.contains("ledger of its 90000 sessions") && refused.contains("unchanged"), "{refused}");
    assert_eq!(read(&path), before);
    let files: Vec<_> = std::fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(files.iter().all(|file| file != "version-2.segments" && file != "manifest.json.unfinished"));
    long.info.sessions.truncate(1000);
    assert_eq!(store::save_map(&path, &long, true).unwrap().version, 2);
    assert_eq!(read(&path).info.sessions.len(), 1000);
}

#[test]
fn one_program_writes_at_a_time_and_others_read_meanwhile() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    store::save_map(&path, &place(1), false).unwrap();
    let lock = std::fs::File::open(path.join("lock")).unwrap();
    lock.lock().unwrap();
    assert!(matches!(store::save_map(&path, &place(2), true), Err(StoreError::InUse { .. })));
    assert_eq!(read(&path).landmarks, place(1).landmarks);
    drop(lock);
    store::save_map(&path, &place(2), true).unwrap();
}

#[test]
fn a_map_that_is_replaced_while_it_is_read_is_read_whole() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    let contents = place(1);
    store::save_map(&path, &contents, false).unwrap();
    std::thread::scope(|scope| {
        let writing = scope.spawn(|| {
            for _ in 0..10 {
                store::save_map(&path, &contents, true).unwrap();
            }
        });
        while !writing.is_finished() {
            assert_eq!(read(&path).landmarks, contents.landmarks);
        }
    });
}

#[test]
fn a_read_only_map_is_read_and_nothing_under_it_changes() {
    use std::os::unix::fs::PermissionsExt as _;
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("map");
    store::save_map(&path, &place(1), false).unwrap();
    let mut all = vec![path.clone()];
    let mut next = 0;
    while next < all.len() {
        if all[next].is_dir() {
            all.extend(std::fs::read_dir(&all[next]).unwrap().map(|entry| entry.unwrap().path()));
        }
        next += 1;
    }
    let state = || -> Vec<_> {
        let of = |path: &std::path::PathBuf| {
            (path.metadata().unwrap().modified().unwrap(), std::fs::read(path).unwrap_or_default())
        };
        all.iter().map(of).collect()
    };
    let before = state();
    let permit = |file: u32, folder: u32| {
        for path in &all {
            let mode = if path.is_dir() { folder } else { file };
            std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
        }
    };
    permit(0o444, 0o555);
    let contents = store::load_map(&path).map(|stored| stored.contents);
    permit(0o644, 0o755);
    assert_eq!(contents.unwrap().landmarks, place(1).landmarks);
    assert_eq!(state(), before);
    assert_eq!(std::fs::read_dir(&path).unwrap().count(), 3);
}
