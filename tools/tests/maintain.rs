//! A night's job on the sessions that robots handed in, run as a program.

use std::process::Stdio;

use serde_json::Value;

use crate::scratch::{Scratch, in_town};

fn json_of(scratch: &Scratch, line: &str) -> Value {
    let ended = scratch.command(&format!("{line} --json")).stdout(Stdio::piped()).output().unwrap();
    assert!(ended.status.success(), "{line}: {}", String::from_utf8_lossy(&ended.stderr));
    serde_json::from_slice(&ended.stdout).unwrap()
}

fn kinds(report: &Value) -> Vec<&str> {
    report["refused"].as_array().unwrap().iter().map(|refused| refused["kind"].as_str().unwrap()).collect()
}

/// The session that a robot recorded.
fn file_of(scratch: &Scratch, robot: &str) -> String {
    let files = std::fs::read_dir(scratch.path("recorded")).unwrap();
    let mut names = files.map(|file| file.unwrap().file_name().into_string().unwrap());
    format!("recorded/{}", names.find(|name| name.starts_with(robot)).unwrap())
}

#[test]
fn sessions_are_taken_once_and_bad_ones_are_named() {
    let scratch = in_town();
    scratch.run("run town/live --map hall.db --out run --robot ada --hand-in recorded");
    // A robot in another town that believes that it is in this one.
    scratch.run("simulate --out village --seed 77 --duration 12");
    scratch.run("run village/live --map hall.db --out lost --robot eve --hand-in recorded");
    let of_eve = file_of(&scratch, "eve");
    let elsewhere = json_of(&scratch, &format!("maintain --map hall.db {of_eve} --dry-run"));
    assert_eq!((kinds(&elsewhere), &elsewhere["taken"]), (vec!["other-place"], &serde_json::json!([])));
    std::fs::write(scratch.path("recorded/broken.session"), "not a session").unwrap();

    let before = json_of(&scratch, "map-info --map hall.db");
    let planned = json_of(&scratch, "maintain --map hall.db --inbox recorded --dry-run");
    assert_eq!(json_of(&scratch, "map-info --map hall.db"), before);
    let report = json_of(&scratch, "maintain --map hall.db --inbox recorded --report night.json");
    for of_run in [&planned, &report] {
        let mut refused = kinds(of_run);
        refused.sort_unstable();
        // What was of another place is looked at again when the map has grown: now it has images of the same times.
        assert_eq!(refused, ["twice", "unreadable"], "{of_run:#}");
        assert_eq!(of_run["taken"].as_array().unwrap().len(), 1);
    }
    assert_eq!((&planned["version"], &report["version"]), (&Value::Null, &serde_json::json!(2)));
    assert_eq!((&planned["after"], &planned["taken"]), (&report["after"], &report["taken"]));
    let broken = report["refused"].as_array().unwrap().iter().find(|refused| refused["kind"] == "unreadable");
    assert!(broken.unwrap()["file"].as_str().unwrap().ends_with("broken.session"), "{broken:?}");
    let written: Value = serde_json::from_slice(&std::fs::read(scratch.path("night.json")).unwrap()).unwrap();
    assert_eq!(written, report);
    let taken = &report["taken"][0];
    assert_eq!(taken["robot"], "ada");
    assert!(taken["report"]["seen"].as_u64().unwrap() > 50, "{taken:#}");

    let after = json_of(&scratch, "map-info --map hall.db --audit");
    assert_eq!(after["ledger_problems"], serde_json::json!([]));
    assert_eq!(after["sessions"][1]["id"], taken["id"]);
    // The town has not changed.
    assert_eq!(taken["report"]["gone_m"], serde_json::json!([]), "{taken:#}");

    // The same again, and another copy of what was taken: nothing is new.
    let file = taken["file"].as_str().unwrap();
    std::fs::copy(scratch.path(file), scratch.path("copy.session")).unwrap();
    let again = json_of(&scratch, "maintain --map hall.db copy.session --inbox recorded");
    assert_eq!((&again["version"], again["taken"].as_array().unwrap().len()), (&Value::Null, 0));
    assert_eq!(again["known"].as_array().unwrap().len(), 2);
    assert_eq!(json_of(&scratch, "map-info --map hall.db --audit"), after);

    // Those that were refused are not looked at again while the map and the settings are as they were.
    let is_before = |report: &Value| -> Vec<(String, bool)> {
        let refused = report["refused"].as_array().unwrap().iter();
        let mut of: Vec<_> = refused
            .map(|of| (of["kind"].as_str().unwrap().to_owned(), of["before"].as_bool().unwrap()))
            .collect();
        of.sort_unstable();
        of
    };
    let kinds_and = |before| vec![("twice".to_owned(), before), ("unreadable".to_owned(), false)];
    assert!(scratch.path("hall.db.refused.json").exists());
    let once_more = json_of(&scratch, "maintain --map hall.db --inbox recorded");
    assert_eq!(is_before(&once_more), kinds_and(true), "{once_more:#}");
    let other_settings =
        json_of(&scratch, "maintain --map hall.db --inbox recorded --half-life 80 --dry-run");
    assert_eq!(is_before(&other_settings), kinds_and(false), "{other_settings:#}");

    // An inbox of several maps: another one passes over the sessions of this one. It was made of the drive of one of them.
    scratch.copy_map(&scratch.path("second.db"), "office.db");
    let office = json_of(&scratch, "maintain --map office.db --inbox recorded --dry-run");
    let count = |of: &str| office[of].as_array().unwrap().len();
    assert_eq!((count("other_maps"), count("known"), kinds(&office)), (1, 1, vec!["unreadable"]));

    // Two copies at once: one of them is taken.
    scratch.copy_map(&scratch.path("whole.db"), "hall.db");
    let twice = json_of(&scratch, &format!("maintain --map hall.db copy.session {file} --to city"));
    assert_eq!((kinds(&twice), twice["taken"].as_array().unwrap().len()), (vec!["twice"], 1), "{twice:#}");
    assert_eq!(twice["candidate"], 1);
    let said = String::from_utf8(
        scratch.command("list-releases city").stdout(Stdio::piped()).output().unwrap().stdout,
    );
    assert!(said.unwrap().contains("candidate"));

    // A night whose store is away: the map and the report are there, and the next night proposes what was not.
    scratch.copy_map(&scratch.path("whole.db"), "hall.db");
    std::fs::write(scratch.path("away"), "").unwrap();
    let fails = |line: &str| {
        let ended = scratch.command(&format!("maintain --map hall.db {line}")).output().unwrap();
        assert!(!ended.status.success(), "{line} succeeded");
        String::from_utf8(ended.stderr).unwrap()
    };
    assert!(fails("copy.session --to away/hall --sign no.key").contains("no.key"));
    assert!(fails("copy.session --comment racks").contains("--to"));
    assert!(fails("--inbox nowhere").contains("no such folder"));
    assert_eq!(json_of(&scratch, "map-info --map hall.db"), before);
    assert!(fails("copy.session --to away/hall --report away.json").contains("not proposed"));
    let written: Value = serde_json::from_slice(&std::fs::read(scratch.path("away.json")).unwrap()).unwrap();
    assert_eq!((&written["version"], &written["candidate"]), (&serde_json::json!(2), &Value::Null));
    std::fs::remove_file(scratch.path("away")).unwrap();
    for candidate in [serde_json::json!(1), Value::Null] {
        let next = json_of(&scratch, "maintain --map hall.db copy.session --to away/hall");
        assert_eq!((&next["version"], &next["candidate"]), (&Value::Null, &candidate), "{next:#}");
    }

    // What cannot be remembered of refused sessions costs neither the report nor a proposal.
    let remembered = scratch.path("hall.db.refused.json");
    let _ = std::fs::remove_file(&remembered);
    std::fs::create_dir(&remembered).unwrap();
    assert!(fails("copy.session --to third --report last.json").contains("hall.db.refused.json"));
    let written: Value = serde_json::from_slice(&std::fs::read(scratch.path("last.json")).unwrap()).unwrap();
    assert_eq!((&written["version"], &written["candidate"]), (&Value::Null, &serde_json::json!(1)));
}

/// How often the work on a session was begun and not ended, by what is remembered beside the map.
fn begun(scratch: &Scratch) -> u64 {
    let text = std::fs::read(scratch.path("hall.db.refused.json")).unwrap_or_default();
    let remembered: Value = serde_json::from_slice(&text).unwrap_or_default();
    remembered["begun"].as_object().map_or(0, |begun| begun.values().filter_map(Value::as_u64).sum())
}

#[test]
fn a_session_that_ends_the_program_twice_is_passed_over_and_what_is_taken_can_be_removed() {
    let scratch = in_town();
    scratch.run("run town/live --map hall.db --out run --robot ada --hand-in recorded");
    let file = file_of(&scratch, "ada");
    let before = json_of(&scratch, "map-info --map hall.db");
    for kill in 1..=2 {
        let mut running = scratch.start("maintain --map hall.db --inbox recorded");
        while begun(&scratch) < kill {
            assert!(running.try_wait().unwrap().is_none(), "it ended before it could be killed");
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        running.kill().unwrap();
        running.wait().unwrap();
    }
    assert_eq!(json_of(&scratch, "map-info --map hall.db"), before);
    let third = json_of(&scratch, "maintain --map hall.db --inbox recorded --remove-taken");
    assert_eq!((kinds(&third), &third["version"]), (vec!["interrupted"], &Value::Null), "{third:#}");
    assert!(scratch.path(&file).exists());

    // Removed from what is remembered, it is tried again; its file goes when the map has it, and no file beyond the inbox.
    std::fs::remove_file(scratch.path("hall.db.refused.json")).unwrap();
    std::fs::copy(scratch.path(&file), scratch.path("copy.session")).unwrap();
    let night = "maintain --map hall.db copy.session --inbox recorded --remove-taken";
    let taken = json_of(&scratch, night);
    assert_eq!((taken["taken"].as_array().unwrap().len(), &taken["version"]), (1, &serde_json::json!(2)));
    // The copy was taken, and that of the inbox was one more of the same.
    assert_eq!(kinds(&taken), ["twice"]);
    assert!(scratch.path(&file).exists() && scratch.path("copy.session").exists());
    let next = json_of(&scratch, night);
    assert_eq!(next["removed_files"], serde_json::json!([file]), "{next:#}");
    assert!(!scratch.path(&file).exists() && scratch.path("copy.session").exists());
    let dry = scratch.command("maintain --map hall.db --inbox recorded --remove-taken --dry-run").output();
    assert!(!dry.unwrap().status.success());
}

#[test]
fn settings_that_make_no_sense_are_refused() {
    let scratch = in_town();
    for (switch, said) in [
        ("--half-life 0", "positive"),
        ("--min-existence 0.6", "below 0.5"),
        ("--save-minutes=-1", "give minutes"),
    ] {
        let ended = scratch.command(&format!("maintain --map hall.db town {switch}")).output().unwrap();
        let error = String::from_utf8(ended.stderr).unwrap();
        assert!(!ended.status.success() && error.contains(said), "{error}");
    }
}
