//! A session from the robot into the map, run as programs.

use std::process::Stdio;

use serde_json::Value;

use crate::scratch::{Scratch, in_town};

fn json_of(scratch: &Scratch, line: &str) -> Value {
    let ended = scratch.command(&format!("{line} --json")).stdout(Stdio::piped()).output().unwrap();
    assert!(ended.status.success(), "{line}: {}", String::from_utf8_lossy(&ended.stderr));
    serde_json::from_slice(&ended.stdout).unwrap()
}

fn complaint(scratch: &Scratch, line: &str) -> String {
    let ended = scratch.command(line).output().unwrap();
    assert!(!ended.status.success(), "{line} succeeded");
    String::from_utf8(ended.stderr).unwrap()
}

#[test]
fn a_robot_records_a_session_hands_it_in_and_the_map_learns_from_it_once() {
    let scratch = in_town();
    scratch.run("release-key ada.key");
    std::fs::create_dir(scratch.path("keys")).unwrap();
    std::fs::copy(scratch.path("ada.key.pub"), scratch.path("keys/ada.pub")).unwrap();
    scratch.run("run town/live --map hall.db --out run --robot ada --hand-in recorded --hand-in-key ada.key");
    let listed = json_of(&scratch, "list-sessions recorded");
    let session = &listed[0];
    assert_eq!(listed.as_array().unwrap().len(), 1);
    assert_eq!((session["robot"].as_str(), session["signed"].as_bool()), (Some("ada"), Some(true)));
    assert!(session["candidates"].as_u64().unwrap() >= 5, "{session}");
    assert!(session["matched_landmarks"].as_u64().unwrap() > 50, "{session}");
    let bytes_a_minute = session["bytes"].as_f64().unwrap() * 60.0 / session["seconds"].as_f64().unwrap();
    assert!(bytes_a_minute < 1e6, "{bytes_a_minute}");

    // One that is damaged does not keep the others.
    let file = std::fs::read_dir(scratch.path("recorded")).unwrap().next().unwrap().unwrap().path();
    std::fs::create_dir(scratch.path("several")).unwrap();
    std::fs::write(scratch.path("several/a.session"), "not a session").unwrap();
    std::fs::copy(file, scratch.path("several/b.session")).unwrap();
    assert!(complaint(&scratch, "hand-in several --inbox other").contains("a.session"));
    assert_eq!(json_of(&scratch, "list-sessions other").as_array().unwrap().len(), 1);

    let handed_in = json_of(&scratch, "hand-in recorded --inbox inbox --robot-keys keys --remove");
    assert_eq!(handed_in.as_array().unwrap().len(), 1);
    assert_eq!(json_of(&scratch, "list-sessions recorded"), serde_json::json!([]));
    let in_inbox = json_of(&scratch, "list-sessions inbox");
    assert_eq!(in_inbox[0]["id"], session["id"]);
    let file = in_inbox[0]["file"].as_str().unwrap().to_owned();
    // What lies there is not handed in once more, and removed as what has been.
    let said = complaint(&scratch, "hand-in inbox --inbox inbox --remove");
    assert!(said.contains("lies in the inbox inbox itself") && said.contains(&file), "{said}");
    assert!(scratch.path(&file).exists());

    let before = json_of(&scratch, "map-info --map hall.db");
    scratch.run(&format!("build-map {file} --map hall.db --extend"));
    let after = json_of(&scratch, "map-info --map hall.db --audit");
    assert_eq!(after["ledger_problems"], serde_json::json!([]));
    assert!(after["keyframes"].as_u64() > before["keyframes"].as_u64());
    let entered = &after["sessions"][1];
    assert_eq!((&entered["id"], &entered["robot"]), (&session["id"], &serde_json::json!("ada")));
    assert!(entered["seen_again"].as_u64().unwrap() > 0, "{entered}");

    // The session again, and the drive that it was recorded on: the ledger knows both.
    for again in [file.as_str(), "town/live"] {
        let said = complaint(&scratch, &format!("build-map {again} --map hall.db --extend"));
        assert!(said.contains("in the map already") && said.contains("by ada"), "{said}");
    }
    let said = complaint(&scratch, &format!("build-map {file} --map hall.db --extend --until 5"));
    assert!(said.contains("used as a whole"), "{said}");
}

#[test]
fn a_session_is_a_recording_that_a_robot_can_be_run_on() {
    let scratch = in_town();
    scratch.run("run town/live --map hall.db --out run --hand-in recorded");
    let file = json_of(&scratch, "list-sessions recorded")[0]["file"].as_str().unwrap().to_owned();
    let summary = json_of(&scratch, &format!("run {file} --map hall.db --out again"));
    assert!(summary["queries"]["accepted"].as_u64().unwrap() >= 3, "{}", summary["queries"]);
    // Without a map there is nothing to learn for.
    let said = complaint(&scratch, "run town/live --mode odometry --out run2 --hand-in recorded");
    assert!(said.contains("--hand-in") && said.contains("--map"), "{said}");
}
