//! Commands that write to a disk that is full: a small one, in the memory, in a namespace of its own.
//!
//! Where the system lets nobody make one, the tests are skipped, with a line that says so.

use std::process::Output;

use map::store::save_map;
use map_io::text::write_map;

use crate::scratch::{Scratch, in_town, place, town};

/// Exit status of a script where no disk could be made.
const NO_DISK: i32 = 77;
/// Free space that is tried, kB.
const FREE_KB: [usize; 4] = [0, 8, 64, 1024];

/// What a command does on a full disk.
struct Tried {
    /// Exit status and complaint on the full disk.
    full: (i32, String),
    /// The same with space, behind a failure.
    again: (i32, String),
}

/// Runs a command that writes below `small/` with so many kB of space there, and again when there is more.
///
/// `before` is run before the disk is full, and `check` after each attempt.
fn try_with(scratch: &Scratch, free_kb: usize, [before, line, check]: [&str; 3]) -> Option<Tried> {
    let program = env!("CARGO_BIN_EXE_driftless");
    let script = format!(
        "mount -t tmpfs -o size=16m tmpfs small || exit {NO_DISK}
         set -e
         {before}
         count=$(( $(df --output=avail -k small | tail -1) - {free_kb} ))
         dd if=/dev/zero of=small/filler bs=1024 count=$count 2> /dev/null
         for attempt in full again; do
             test $attempt = full || test $status != 0 || break
             set +e
             {program} {line} > /dev/null 2> $attempt.text
             status=$?
             echo $status > $attempt.status
             set -e
             {check}
             rm -f small/filler
         done"
    );
    let _ = std::fs::create_dir(scratch.path("small"));
    let Output { status, stderr, .. } = std::process::Command::new("unshare")
        .args(["-rm", "sh", "-c", &script])
        .current_dir(scratch.path(""))
        .env("TMPDIR", scratch.path("tmp"))
        .output()
        .ok()?;
    let text = String::from_utf8_lossy(&stderr);
    if status.code() == Some(NO_DISK) || text.starts_with("unshare:") {
        return None;
    }
    assert!(status.success(), "{line} with {free_kb} kB: {text}");
    let read = |name: &str| std::fs::read_to_string(scratch.path(name)).unwrap();
    let attempt = |name: &str| {
        let status = read(&format!("{name}.status")).trim().parse().unwrap();
        (status, read(&format!("{name}.text")))
    };
    let full = attempt("full");
    let again = if full.0 == 0 { full.clone() } else { attempt("again") };
    Some(Tried { full, again })
}

/// Tries a command with more and more space: it succeeds, or says what could not be written, and then succeeds with space.
fn try_all(scratch: &Scratch, before: &str, line: &str, check: &str) {
    let mut failed = 0;
    for free_kb in FREE_KB {
        let Some(Tried { full, again }) = try_with(scratch, free_kb, [before, line, check]) else {
            println!("SKIPPED: no disk can be made here, {line} was not tried");
            return;
        };
        if full.0 != 0 {
            failed += 1;
            let (status, complaint) = &full;
            assert_eq!(*status, 1, "{line} with {free_kb} kB: {complaint}");
            let said = complaint.contains("No space left") && complaint.contains("small/");
            assert!(said && !complaint.contains("panicked"), "{line} with {free_kb} kB: {complaint}");
        }
        assert_eq!(again.0, 0, "{line} after {free_kb} kB: {}", again.1);
    }
    assert!(failed >= 2, "{line} failed {failed} times");
}

#[test]
fn maps_are_written_whole_or_not_at_all() {
    let scratch = in_town();
    write_map(&scratch.path("text"), &place(2)).unwrap();
    let program = env!("CARGO_BIN_EXE_driftless");
    try_all(&scratch, "", "import-map text --map small/hall.db", "");
    try_all(&scratch, "", "build-map town/map --map small/hall.db --sigma-pixel 1 --gravity 0,0,-1", "");
    // The map that was there stays readable.
    let before = "cp -r hall.db small/hall.db";
    let check = format!("{program} map-info --map small/hall.db > /dev/null");
    let first = *crate::scratch::ids(&town().join("hall.db")).first().unwrap();
    try_all(&scratch, before, &format!("edit-map --map small/hall.db --remove {first}"), &check);
    try_all(&scratch, before, "merge-maps small/hall.db second.db --map small/hall.db --force", &check);
}

#[cfg(all(feature = "releases", feature = "secure"))]
#[test]
fn releases_and_fleets_are_there_as_a_whole_or_not_at_all() {
    let scratch = Scratch::new();
    save_map(&scratch.path("hall.db"), &place(1), false).unwrap();
    let list =
        format!("{} list-releases small/city > /dev/null 2>&1 || true", env!("CARGO_BIN_EXE_driftless"));
    try_all(&scratch, "", "publish-map --map hall.db --to small/city", &list);
    try_all(&scratch, "", "fleet init small/fleet --address 10.0.0.1 --servers s1 --robots r1,r2", "");
}

#[cfg(feature = "bags")]
#[test]
fn a_run_says_what_it_could_not_write() {
    let scratch = in_town();
    try_all(&scratch, "", "run town/live --map whole.db --out small/out", "");
    // A robot drives on without its recording; what there is of it can be read.
    let check = format!(
        "test ! -e small/run.mcap || {} info small/run.mcap > /dev/null",
        env!("CARGO_BIN_EXE_driftless")
    );
    for free_kb in FREE_KB {
        let line = "run town/live --map whole.db --out out --record small/run.mcap";
        let Some(Tried { full, .. }) = try_with(&scratch, free_kb, ["", line, &check]) else { return };
        assert_eq!(full.0, 0, "{}", full.1);
        let is_said = full.1.contains("small/run.mcap") && full.1.contains("No space left");
        assert!(is_said || free_kb > 64, "{free_kb} kB: {}", full.1);
    }
}
