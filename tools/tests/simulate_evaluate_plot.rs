//! The commands, run as programs.

use clap::CommandFactory as _;
use std::path::Path;
use std::process::{Command, Output};

fn driftless(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_driftless")).args(arguments).output().unwrap()
}

/// Standard output of a command that succeeds.
fn stdout_of(arguments: &[&str]) -> String {
    let output = driftless(arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Standard error of a command that fails.
fn stderr_of(arguments: &[&str]) -> String {
    let output = driftless(arguments);
    assert!(!output.status.success());
    String::from_utf8(output.stderr).unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn a_simulated_town_is_written_and_compares_to_itself_without_error() {
    let folder = tempfile::tempdir().unwrap();
    let written = stdout_of(&["simulate", "--out", text(folder.path()), "--speed", "12", "--json"]);
    let summaries: serde_json::Value = serde_json::from_str(&written).unwrap();
    assert!(summaries.as_array().unwrap().iter().all(|run| run["distance_m"].as_f64().unwrap() > 300.0));
    assert!(folder.path().join("map/reference_poses.csv").exists());

    let truth = folder.path().join("live/mav0/state_groundtruth_estimate0/data.csv");
    for align in ["none", "yaw", "se3"] {
        let figures = stdout_of(&[
            "evaluate",
            "--groundtruth",
            text(&truth),
            "--estimate",
            text(&truth),
            "--align",
            align,
            "--json",
        ]);
        let figures: serde_json::Value = serde_json::from_str(&figures).unwrap();
        for figure in ["ate_m", "ate_deg", "rpe_m", "rpe_deg"] {
            assert!(figures[figure]["rmse"].as_f64().unwrap() < 1e-5, "{align} {figure} {figures}");
        }
        assert!(figures["nees"].is_null());
    }
}

#[test]
fn a_given_trajectory_is_simulated() {
    let folder = tempfile::tempdir().unwrap();
    let trajectory = folder.path().join("given.tum");
    let lines = (0..60).map(|index| {
        let t = f64::from(index) * 0.1;
        format!("{:.9} {t} {} 1 0 0 0 1\n", 100.0 + t, (0.5 * t).sin())
    });
    std::fs::write(&trajectory, lines.collect::<String>()).unwrap();
    let out = folder.path().join("hall");
    let printed = stdout_of(&["simulate", "--out", text(&out), "--trajectory", text(&trajectory)]);
    assert!(printed.contains("hall/live: 6 m in 5 s"), "{printed}");
    let again = ["simulate", "--out", text(&out), "--trajectory", text(&trajectory)];
    let refused = stderr_of(&again);
    assert!(refused.contains("hall/map is a recording already") && refused.contains("--force"), "{refused}");
    assert_eq!(stdout_of(&[&again[..], &["--force"]].concat()), printed);
}

#[test]
fn errors_name_the_file_and_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let truth = folder.path().join("truth.tum");
    std::fs::write(&truth, "1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n").unwrap();
    let late = folder.path().join("late.tum");
    std::fs::write(&late, "101 0 0 0 0 0 0 1\n102 0 0 0 0 0 0 1\n").unwrap();
    let evaluate = |groundtruth: &Path, estimate: &Path, align: &str| {
        stderr_of(&[
            "evaluate",
            "--groundtruth",
            text(groundtruth),
            "--estimate",
            text(estimate),
            "--align",
            align,
        ])
    };
    assert!(evaluate(&truth, &folder.path().join("none.tum"), "none").contains("none.tum is missing"));
    assert!(evaluate(&truth, &late, "none").contains("no poses in common"));
    assert!(evaluate(&truth, &truth, "se3").contains("align with yaw or none"));
    assert!(stderr_of(&["plot", text(folder.path())]).contains("states.csv is missing"));
    let bad = stderr_of(&["simulate", "--out", text(folder.path()), "--outliers", "2"]);
    assert!(bad.contains("outlier_fraction is 2, but must be between 0 and 1"), "{bad}");
}

#[test]
fn every_help_shows_an_example() {
    for command in tools::cli::Cli::command().get_subcommands() {
        let name = command.get_name();
        assert!(stdout_of(&[name, "--help"]).contains(&format!("driftless {name} ")), "{name}");
    }
}
