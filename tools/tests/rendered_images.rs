//! `driftless simulate --images`, run as a program, and what the front end makes of its images.

use std::path::Path;
use std::process::Command;

/// Mean length of the tracks (frames) that the front end finds in a real recording of 16 s, of a camera that is shaken by hand:
/// `driftless track mh_01_handheld_16s --cameras 1` of docs/src/benchmarks.md, 64,000 observations in 4,032 tracks.
const TRACK_LENGTH: f64 = 15.9;

/// Standard output of a command that succeeds, as JSON.
fn json_of(arguments: &[&str]) -> serde_json::Value {
    let output = Command::new(env!("CARGO_BIN_EXE_driftless")).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn rendered_flights_are_written_and_tracked_like_real_images() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("room");
    let written = json_of(&["simulate", "--images", "--duration", "0.5", "--out", text(&out), "--json"]);
    for (run, frames) in [(&written[0], 105..=115), (&written[1], 5..=15)] {
        let count = run["frames"].as_u64().unwrap();
        assert!(frames.contains(&count), "{count} frames");
        assert_eq!(run["images"].as_u64().unwrap(), 2 * count);
        assert_eq!(run["images_with_features"].as_u64().unwrap(), 0);
    }
    let images = |name: &str| std::fs::read_dir(out.join(name)).unwrap().count();
    assert_eq!(images("map/mav0/cam0/data"), images("map/mav0/cam1/data"));
    assert!(out.join("map/reference_poses.csv").exists() && !out.join("live/reference_poses.csv").exists());

    let map = out.join("map");
    let tracks = |cameras: &str| {
        let tracked = folder.path().join(format!("tracks_{cameras}"));
        json_of(&["track", text(&map), "--out", text(&tracked), "--cameras", cameras, "--json"])
    };
    let (one, two) = (tracks("1"), tracks("2"));
    let number = |summary: &serde_json::Value, key: &str| summary[key].as_f64().unwrap();
    println!("{one:#} {two:#}");
    assert!(number(&one, "left_out") == 0.0 && number(&one, "points_in_sight") > 190.0, "{one}");
    assert!(number(&two, "stereo_share") > 0.6, "{two}");
    let length = number(&one, "observations") / number(&one, "tracks");
    assert!((TRACK_LENGTH / 2.0..TRACK_LENGTH * 2.0).contains(&length), "{length} frames");
}

#[test]
fn switches_that_images_do_not_have_are_refused() {
    let output = Command::new(env!("CARGO_BIN_EXE_driftless"))
        .args(["simulate", "--out", "nowhere", "--images", "--speed", "3"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && said.contains("--images") && said.contains("--speed"), "{said}");
}
