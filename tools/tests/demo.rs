//! `driftless demo`, run as a program: from pixels to poses.

use std::path::PathBuf;
use std::process::Command;

/// Leaves everything in the folder `DEMO_OUT`, where that is set.
#[test]
#[ignore = "takes a minute or two; `just demo` runs it"]
fn the_demo_localizes_rendered_images_in_a_map_of_rendered_images() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = std::env::var_os("DEMO_OUT").map_or_else(|| scratch.path().to_owned(), PathBuf::from);
    let output = Command::new(env!("CARGO_BIN_EXE_driftless"))
        .args(["demo", "--json", "--out"])
        .arg(&folder)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    println!("{}", String::from_utf8_lossy(&output.stdout));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!said.contains("ALARM"), "{said}");
    let demo: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let in_map = &demo["rows"][1];
    let rmse_m = in_map["pose"]["rmse_m"].as_f64().unwrap();
    let nees = in_map["pose"]["nees_pose"].as_f64().unwrap();
    assert!(rmse_m < 0.05, "{in_map:#}");
    assert!(nees < 4.0, "{in_map:#}");
    assert!(in_map["used"].as_u64().unwrap() >= 10, "{in_map:#}");
    for file in ["map.db", "mm_r/states.csv", "comparison.svg", "image.png", "demo.json"] {
        assert!(folder.join(file).exists(), "{file}");
    }
}

#[test]
fn seeds_are_of_the_demo_from_tracks() {
    let output =
        Command::new(env!("CARGO_BIN_EXE_driftless")).args(["demo", "--seeds", "2"]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && said.contains("--tracks"), "{said}");
}
