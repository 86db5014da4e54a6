//! `driftless track`, run as a program on the same images in a folder and in a bag.

use std::path::{Path, PathBuf};
use std::process::Command;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/bags/tests/data").join(name)
}

/// Tracks the points of a recording.
///
/// # Returns
/// What the command complained of, if it failed.
fn track(recording: &Path, more: &[&Path]) -> Result<(), String> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_driftless"));
    command.arg("track").arg(recording).arg("--calibration").arg(data("euroc")).args(more);
    let output = command.output().unwrap();
    if output.status.success() { Ok(()) } else { Err(String::from_utf8(output.stderr).unwrap()) }
}

#[test]
fn a_bag_gives_the_tracks_of_its_images_in_a_folder_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let [of_folder, of_bag] = ["folder", "bag"].map(|name| folder.path().join(name));
    let out = Path::new("--out");
    track(&data("euroc"), &[out, &of_folder]).unwrap();
    track(&data("excerpt.bag"), &[out, &of_bag]).unwrap();
    for file in ["mav0/cam0/tracks.csv", "mav0/imu0/data.csv", "mav0/cam0/data.csv"] {
        let numbers = |root: &Path| -> Vec<Vec<String>> {
            let text = std::fs::read_to_string(root.join(file)).unwrap();
            let rows = text.lines().filter(|line| !line.starts_with('#'));
            rows.map(|row| row.split(',').take(4).map(str::to_owned).collect()).collect()
        };
        let (expected, found) = (numbers(&of_folder), numbers(&of_bag));
        assert_eq!(expected.len(), found.len(), "{file}");
        if file.ends_with("tracks.csv") {
            assert_eq!(expected, found);
        }
    }
    let refused = track(&data("excerpt.bag"), &[]).unwrap_err();
    assert!(refused.contains("--out DIR"), "{refused}");
}
