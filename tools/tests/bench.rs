//! `driftless bench`: one recording of a dataset is mapped, and the others are localized in it.

use crate::scratch::{Scratch, town};
use std::os::unix::fs::symlink;

/// A dataset of two drives through the town and a folder that is none.
fn dataset() -> Scratch {
    let scratch = Scratch::new();
    let set = scratch.path("set");
    std::fs::create_dir_all(set.join("c_broken/mav0")).unwrap();
    symlink(town().join("town/map"), set.join("a_first")).unwrap();
    symlink(town().join("town/live"), set.join("b_second")).unwrap();
    scratch
}

#[test]
fn the_others_are_localized_in_the_frame_of_the_truth_and_what_cannot_be_run_is_named() {
    let scratch = dataset();
    let ended = scratch.command("bench set --out out").stdout(std::process::Stdio::piped()).output().unwrap();
    let (table, error) = (String::from_utf8_lossy(&ended.stdout), String::from_utf8_lossy(&ended.stderr));
    assert_eq!(ended.status.code(), Some(1), "{error}");
    assert!(error.contains("could not be run: c_broken"), "{error}");
    assert!(table.contains("| b_second |") && table.contains("| c_broken |"), "{table}");
    let written = std::fs::read_to_string(scratch.path("out/bench.md")).unwrap();
    assert!(table.starts_with(&written), "{table}");
    let text = std::fs::read(scratch.path("out/bench.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&text).unwrap();
    assert_eq!(
        (&report["map"]["recording"], &report["map"]["is_in_frame_of_truth"]),
        (&"a_first".into(), &true.into())
    );
    let second = &report["recordings"][0]["measured"];
    let number = |value: &serde_json::Value| value.as_f64().unwrap_or_else(|| panic!("{report:#}"));
    assert!(number(&second["localized"]) > 0.8 && number(&second["first_localized_s"]) < 5.0, "{report:#}");
    // Not aligned with the truth of this drive.
    let pose = &second["pose"];
    assert!(number(&pose["rmse_m"]) < 0.3 && number(&pose["nees_position"]) < 4.0, "{report:#}");
    assert!(report["recordings"][1]["error"].as_str().unwrap().contains("c_broken"), "{report:#}");
    assert!(scratch.path("out/b_second/states.csv").exists() && scratch.path("out/map.db").exists());
}

#[test]
fn names_and_folders_that_are_no_dataset_are_refused_in_words() {
    let scratch = dataset();
    let refused = |line: &str| {
        let ended = scratch.command(line).output().unwrap();
        assert!(!ended.status.success(), "{line}");
        String::from_utf8_lossy(&ended.stderr).into_owned()
    };
    let unknown = refused("bench set --map-from d_fourth --out out");
    assert!(
        unknown.contains("d_fourth is no recording of set") && unknown.contains("a_first, b_second"),
        "{unknown}"
    );
    let one = refused("bench set/a_first --out out");
    assert!(one.contains("is one recording"), "{one}");
    let alone = refused("bench set --map-from a_first --only a_first --out out");
    assert!(alone.contains("a_first is mapped"), "{alone}");
    // Switches of wheels and GNSS hold for the recordings of a dataset, too.
    let joints = refused("bench set --out out --wheel-topic /wheels --wheel-joints a,b,c");
    assert!(joints.contains("--wheel-joints names 3 joints"), "{joints}");
    assert!(!scratch.path("out").exists());
    scratch.copy_map(&town().join("hall.db"), "out/map.db");
    let replaced = refused("bench set --out out");
    assert!(replaced.contains("was made by driftless build-map"), "{replaced}");
}
