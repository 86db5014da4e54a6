//! `driftless simulate --images`, run as a program, and what the front end makes of its images.
#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::process::Command;

/// Median length of the tracks (frames) that the front end finds in a real recording of 16 s, hand-held; see the test below.
const TRACK_LENGTH: f64 = 12.0;

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
    let written = json_of(&["simulate", "--images", "--duration", "1.5", "--out", text(&out), "--json"]);
    for (run, frames) in [(&written[0], 125..=135), (&written[1], 25..=35)] {
        let count = run["frames"].as_u64().unwrap();
        assert!(frames.contains(&count), "{count} frames");
        assert_eq!(run["images"].as_u64().unwrap(), 2 * count);
        assert_eq!(run["images_with_features"].as_u64().unwrap(), 0);
    }
    let images = |name: &str| std::fs::read_dir(out.join(name)).unwrap().count();
    assert_eq!(images("map/mav0/cam0/data"), images("map/mav0/cam1/data"));
    assert!(out.join("map/reference_poses.csv").exists() && !out.join("live/reference_poses.csv").exists());

    let tracks = json_of(&["track", text(&out.join("map")), "--json"]);
    let number = |key: &str| tracks[key].as_f64().unwrap();
    println!("{tracks:#}");
    assert_eq!(number("left_out"), 0.0);
    assert!(number("points_in_sight") > 150.0 && number("stereo_share") > 0.6, "{tracks}");
    let length = number("track_length");
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
