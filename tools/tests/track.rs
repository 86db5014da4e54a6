//! `driftless track`, run as a program on the same images in a folder and in a bag.

use std::path::{Path, PathBuf};
use std::process::Command;

use testing::copy_folder;

use crate::program::{complaint_of, driftless, text};

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

#[test]
fn all_sensors_come_along_and_no_recording_is_written_over() {
    const UNIT: &str = "[1, 0, 0, 0,  0, 1, 0, 0,  0, 0, 1, 0,  0, 0, 0, 1]";
    let folder = tempfile::tempdir().unwrap();
    let [recording, out] = ["recording", "out"].map(|name| folder.path().join(name));
    copy_folder(&data("euroc"), &recording);
    let wheels = format!("T_BS: {{data: {UNIT}}}\nradius: 0.1\ntrack: 0.5\n");
    let others = [
        ("wheels0/data.csv", "#stamp,left,right\n1403636584668555392,1,1\n1403636584768555392,1,1\n"),
        ("wheels0/sensor.yaml", wheels.as_str()),
        ("gnss0/data.csv", "#stamp,x,y,z\n1403636584668555392,0,0,0,1,1,1\n"),
        ("gnss0/sensor.yaml", "antenna: [0, 0, 0.1]\n"),
        ("mocap0/data.csv", "#stamp,p,q\n1403636584668555392,0,0,0,1,0,0,0\n"),
    ];
    for (name, contents) in others {
        let path = recording.join("mav0").join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, contents).unwrap();
    }
    let line = ["track", text(&recording), "--cameras", "1", "--points", "40", "--out", text(&out)];
    let ended = driftless(&line);
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    for (name, contents) in others {
        assert_eq!(std::fs::read_to_string(out.join("mav0").join(name)).unwrap(), contents, "{name}");
    }

    let of_imu = || std::fs::read(recording.join("mav0/imu0/data.csv")).unwrap();
    let before = of_imu();
    let onto_itself = ["track", text(&recording), "--force", "--out", text(&recording)];
    let refused = complaint_of(&onto_itself);
    assert!(refused.contains("is the recording itself"), "{refused}");
    let onto_another = complaint_of(&["track", text(&out), "--out", text(&recording)]);
    assert!(onto_another.contains("has a recording") && onto_another.contains("--force"), "{onto_another}");
    assert_eq!(of_imu(), before);
}
