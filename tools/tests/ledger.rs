//! Each recording is in a map once: the ledger through build, extension, merge, edit, text and releases, run as programs.

use std::process::Stdio;

use map::store::{load_map, save_map};
use serde_json::Value;
use testing::copy_folder;

use crate::scratch::{Scratch, in_town};

/// What a command that succeeds prints.
fn printed(scratch: &Scratch, line: &str) -> String {
    let ended = scratch.command(line).stdout(Stdio::piped()).output().unwrap();
    assert!(ended.status.success(), "{line}: {}", String::from_utf8_lossy(&ended.stderr));
    String::from_utf8(ended.stdout).unwrap()
}

fn json_of(scratch: &Scratch, line: &str) -> Value {
    serde_json::from_str(&printed(scratch, &format!("{line} --json"))).unwrap()
}

/// Standard error of a command that fails.
fn complaint(scratch: &Scratch, line: &str) -> String {
    let ended = scratch.command(line).output().unwrap();
    assert!(!ended.status.success(), "{line} succeeded");
    String::from_utf8(ended.stderr).unwrap()
}

/// Names of the sessions of a map whose ledger is true, and how many keyframes the map has of each.
fn audited(scratch: &Scratch, map: &str) -> Vec<(String, u64)> {
    let info = json_of(scratch, &format!("map-info --map {map} --audit"));
    assert_eq!(info["ledger_problems"], serde_json::json!([]));
    let sessions = info["sessions"].as_array().unwrap();
    for count in ["keyframes", "observations"] {
        let counted: u64 = sessions.iter().map(|session| session[count].as_u64().unwrap()).sum();
        assert_eq!(counted, info[count].as_u64().unwrap(), "{count} of {map}");
    }
    let session = |session: &Value| {
        (session["name"].as_str().unwrap().to_owned(), session["keyframes"].as_u64().unwrap())
    };
    sessions.iter().map(session).collect()
}

fn names(sessions: &[(String, u64)]) -> Vec<&str> {
    sessions.iter().map(|(name, _)| name.as_str()).collect()
}

#[test]
fn a_recording_is_in_a_map_once_however_it_is_handed_in() {
    let scratch = in_town();
    let before = audited(&scratch, "hall.db");
    assert_eq!(names(&before), ["map"]);
    scratch.run("publish-map --map hall.db --to city");

    // The recording itself, a part of it, and a copy with another name; odometry is not run for it.
    let extend = "build-map town/map --map hall.db --extend";
    let said = complaint(&scratch, extend);
    assert!(
        said.contains("\"map\" is the recording of session \"map\"") && said.contains("added 2"),
        "{said}"
    );
    assert!(said.contains("--from and --until"), "{said}");
    let said = complaint(&scratch, &format!("{extend} --from 4 --until 8"));
    assert!(said.contains("has readings of the IMU of session \"map\""), "{said}");
    copy_folder(&scratch.path("town/map"), &scratch.path("drive_7"));
    let said = complaint(&scratch, "build-map drive_7 --map hall.db --extend");
    assert!(said.contains("\"drive_7\" is the recording of session \"map\""), "{said}");
    assert_eq!(audited(&scratch, "hall.db"), before);

    scratch.run("build-map town/live --map hall.db --extend --robot ada");
    let both = audited(&scratch, "hall.db");
    assert_eq!((names(&both), &both[0]), (vec!["map", "live"], &before[0]));
    let shown = printed(&scratch, "map-info --map hall.db --audit");
    assert!(shown.contains("by ada") && shown.contains("the ledger is true"), "{shown}");
    assert!(shown.contains("of other sessions' landmarks; added 2"), "{shown}");

    let said = complaint(&scratch, "merge-maps hall.db second.db --map site.db");
    assert!(said.contains("\"live\" is the recording of session \"live\""), "{said}");
    assert!(said.contains("by ada, added 2") && said.contains("Build one of them without"), "{said}");
    scratch.run("merge-maps whole.db second.db --map site.db");
    assert_eq!(names(&audited(&scratch, "site.db")), ["map", "live"]);
    let said = complaint(&scratch, "build-map town/live --map site.db --extend");
    assert!(said.contains("is the recording of session \"live\""), "{said}");

    releases_have_the_ledger(&scratch, &both);
    text_has_the_ledger(&scratch, &both);

    // What was learned from a drive stays in the poses of the others when its keyframes are taken out.
    let info = json_of(&scratch, "map-info --map hall.db");
    let ids = &info["sessions"][1]["keyframe_ids"];
    scratch.run(&format!("edit-map --map hall.db --remove {}-{}", ids[0], ids[1]));
    assert_eq!(audited(&scratch, "hall.db")[1], ("live".to_owned(), 0));
    let said = complaint(&scratch, "build-map town/live --map hall.db --extend");
    assert!(said.contains("is the recording of session \"live\""), "{said}");
}

#[test]
fn parts_of_a_recording_that_follow_each_other_are_two_sessions() {
    let scratch = in_town();
    scratch.run("build-map town/map --map half.db --sigma-pixel 1 --gravity 0,0,-1 --until 8");
    let extend = "build-map town/map --map half.db --extend";
    let said = complaint(&scratch, &format!("{extend} --from 7"));
    assert!(said.contains("has readings of the IMU of session \"map\""), "{said}");
    scratch.run(&format!("{extend} --from 8.1"));
    assert_eq!(names(&audited(&scratch, "half.db")), ["map", "map"]);
    let said = complaint(&scratch, extend);
    assert!(said.contains("has readings of the IMU of session \"map\""), "{said}");
}

fn releases_have_the_ledger(scratch: &Scratch, both: &[(String, u64)]) {
    scratch.run("publish-map --map hall.db --to city");
    let listed = printed(scratch, "list-releases city");
    assert!(
        listed.contains("2 sessions, since release 1:") && listed.contains("session new   live"),
        "{listed}"
    );
    let difference = json_of(scratch, "diff-releases city 1 2");
    assert_eq!(difference["cells"]["sessions"]["added"][0]["robot"], "ada");
    let shown = printed(scratch, "diff-releases city 1 2");
    assert!(shown.contains("session new   live") && shown.contains("by ada"), "{shown}");
    scratch.run("checkout city --map copy.db");
    assert_eq!(audited(scratch, "copy.db"), both);
    assert_eq!(names(&audited(scratch, "city@1")), ["map"]);

    // An older copy takes no session away, unless that is meant.
    scratch.run("checkout city@1 --map old.db");
    let said = complaint(scratch, "publish-map --map old.db --to city");
    assert!(said.contains("has 1 sessions that this map lacks, the first of them live"), "{said}");
    scratch.run("publish-map --map old.db --to city --replace");
    assert_eq!(names(&audited(scratch, "city@3")), ["map"]);
}

fn text_has_the_ledger(scratch: &Scratch, both: &[(String, u64)]) {
    scratch.run("export-map --map hall.db --to text");
    scratch.run("import-map text --map imported.db");
    assert_eq!(audited(scratch, "imported.db"), both);
    let sessions = |map: &str| json_of(scratch, &format!("map-info --map {map}"))["sessions"].clone();
    assert_eq!(sessions("imported.db"), sessions("hall.db"));

    // A ledger that has one drive twice, under two ids.
    let path = scratch.path("text/sessions.json");
    let mut ledger: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    for fact in ["begin_ns", "end_ns", "samples"] {
        ledger[1][fact] = ledger[0][fact].clone();
    }
    std::fs::write(&path, ledger.to_string()).unwrap();
    let said = complaint(scratch, "import-map text --map twice.db");
    assert!(said.contains("sessions.json") && said.contains("of session \"map\""), "{said}");
    let mut twice = load_map(scratch.path("hall.db")).unwrap().contents;
    let first = twice.info.sessions[0].clone();
    let second = &mut twice.info.sessions[1];
    (second.begin_ns, second.end_ns, second.samples) = (first.begin_ns, first.end_ns, first.samples);
    save_map(&scratch.path("twice.db"), &twice, false).unwrap();
    let said = complaint(scratch, "map-info --map twice.db --audit");
    assert!(
        said.contains("the ledger of sessions is not true") && said.contains("of session \"map\""),
        "{said}"
    );

    std::fs::remove_file(&path).unwrap();
    scratch.run("import-map text --map one.db");
    assert_eq!(names(&audited(scratch, "one.db")), ["text"]);
    // Without readings, images are what is known of a recording.
    let said = complaint(scratch, "build-map town/live --map one.db --extend");
    assert!(said.contains("when the recording has an image too"), "{said}");
}
