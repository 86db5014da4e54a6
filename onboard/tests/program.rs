//! The robot program from outside: what it leaves when it is stopped, killed, or its output is closed.

use evaluation::trajectory::{states, tum};
use sensors::writer;
use simulation::{SimulationOptions, simulate};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

/// Readings that are missing in the middle of the recording, at 200 a second.
const LOST: std::ops::Range<usize> = 1000..1020;

/// Writes a recording of 200 frames in twenty seconds.
fn record(folder: &Path) {
    let options = SimulationOptions { duration_s: Some(21.0), ..SimulationOptions::default() };
    let mut sequence = simulate(&options).unwrap().live;
    sequence.frames.truncate(200);
    sequence.imu_samples.drain(LOST);
    writer::write(&sequence, folder).unwrap();
}

fn start(recording: &Path, out: &Path, switches: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_onboard"))
        .args(["--mode", "odometry", "--init", "truth", "--sequence"])
        .arg(recording)
        .arg("--out")
        .arg(out)
        .args(switches)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Waits until a run has written states, then sends a signal, and waits for its end.
fn signal(mut child: Child, out: &Path, name: &str) -> ExitStatus {
    let written =
        || std::fs::read_to_string(out.join("states.csv")).is_ok_and(|text| text.lines().count() > 10);
    while !written() {
        assert!(child.try_wait().unwrap().is_none(), "the run ended before it wrote anything");
        std::thread::sleep(Duration::from_millis(20));
    }
    let sent = Command::new("kill").args([name, &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    child.wait().unwrap()
}

fn summary(out: &Path) -> serde_json::Value {
    serde_json::from_str(&std::fs::read_to_string(out.join("summary.json")).unwrap()).unwrap()
}

#[test]
fn an_old_name_of_a_switch_ends_with_the_present_one() {
    let folder = tempfile::tempdir().unwrap();
    let settings = folder.path().join("robot.yaml");
    std::fs::write(&settings, "sequence: drive\nstate-landmarks: 20\n").unwrap();
    let settings = settings.to_string_lossy().into_owned();
    for (line, said) in [
        (&["--sequence", "drive", "--settings", "filter.yaml"][..], "the switch is --estimator-config"),
        (&["--sequence", "drive", "--track-sigma=1.5", "--out", "out"], "the switch is --sigma-track"),
        (&["--source", "native", "--config", "zenoh.json5"], "the switch is --zenoh-config"),
        (&[settings.as_str()], "slam-features"),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_onboard")).args(line).output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && error.contains(said), "{line:?}: {error}");
        assert_eq!(error.lines().count(), 1, "{line:?}: {error}");
    }
}

#[test]
fn a_run_that_is_interrupted_leaves_complete_files() {
    for name in ["-INT", "-TERM"] {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        record(folder.path());
        let status = signal(start(folder.path(), &out, &["--realtime"]), &out, name);
        assert_eq!(status.code(), Some(1), "a run that ended early has failed");
        let summary = summary(&out);
        assert_eq!(summary["interrupted"], true);
        assert!(summary["ended_early"].as_str().unwrap().contains("interrupted"), "{summary}");
        assert!(!summary["final_status"].is_null());
        let rows = states::read(&out.join("states.csv")).unwrap();
        assert!(rows.len() >= 10 && rows.len() < 200, "{}", rows.len());
        assert_eq!(summary["frames"], rows.len());
        assert_eq!(summary["score"]["local"]["samples"], rows.len());
        assert_eq!(tum::read(&out.join("odometry.tum")).unwrap().len(), rows.len());
    }
}

#[test]
fn a_run_that_is_killed_leaves_what_it_had() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    record(folder.path());
    // The summary of an earlier run must not be taken for this one's.
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("summary.json"), "{}").unwrap();
    assert!(!signal(start(folder.path(), &out, &["--realtime"]), &out, "-KILL").success());
    assert!(!out.join("summary.json").exists());
    let text = std::fs::read_to_string(out.join("states.csv")).unwrap();
    // A full buffer is written up to the middle of a line.
    let whole = &text[..=text.rfind('\n').unwrap()];
    std::fs::write(out.join("states.csv"), whole).unwrap();
    assert!(states::read(&out.join("states.csv")).unwrap().len() >= 9);
}

#[test]
fn a_complete_run_reports_its_gaps() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    record(folder.path());
    let output = start(folder.path(), &out, &[]).wait_with_output().unwrap();
    assert!(output.status.success());
    let summary = summary(&out);
    assert_eq!((&summary["interrupted"], &summary["frames"]), (&false.into(), &200.into()));
    assert_eq!(summary["imu_gaps"]["count"], 1);
    assert!((summary["imu_gaps"]["longest_s"].as_f64().unwrap() - 0.105).abs() < 1e-9);
    let log = String::from_utf8(output.stderr).unwrap();
    assert_eq!(log.matches("a gap in the IMU's readings").count(), 1, "{log}");
}

#[test]
fn a_closed_pipe_is_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    record(folder.path());
    let mut child = start(folder.path(), &out, &["--json", "--duration", "2"]);
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(141));
    assert!(!String::from_utf8(output.stderr).unwrap().contains("panicked"));
    assert!(out.join("summary.json").exists());
}
