//! Every fault is an error that names the file and the line.

use super::*;

/// Writes a valid recording, damages one file, and returns the error of opening it.
fn error_of(file: &str, damage: impl Fn(String) -> String) -> String {
    let folder = tempfile::tempdir().unwrap();
    writer::write(&sequence(2), folder.path()).unwrap();
    let path = folder.path().join(file);
    let damaged = damage(std::fs::read_to_string(&path).unwrap());
    std::fs::write(&path, damaged).unwrap();
    let error = Sequence::open(folder.path()).unwrap_err().to_string();
    assert!(error.contains(file), "{error}");
    error
}

/// Replaces one cell of one line (both counted from 0).
fn cell(text: &str, line: usize, column: usize, value: &str) -> String {
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let mut cells: Vec<&str> = lines[line].split(',').collect();
    cells[column] = value;
    lines[line] = cells.join(",");
    lines.join("\n") + "\n"
}

const TABLES: [&str; 5] = [
    "mav0/imu0/data.csv",
    "mav0/cam0/tracks.csv",
    "mav0/cam1/tracks.csv",
    "mav0/cam0/features.csv",
    "reference_poses.csv",
];
const TRUTH: &str = "mav0/state_groundtruth_estimate0/data.csv";

#[test]
fn a_row_that_is_cut_off() {
    for file in TABLES.into_iter().chain([TRUTH]) {
        let error = error_of(file, |text| {
            let end = text.trim_end().rfind(',').unwrap();
            text[..end].to_owned()
        });
        assert!(error.contains("line ") && error.contains("cut off"), "{error}");
    }
}

/// Nobody writes into the pipe: whoever reads it does not come back.
#[cfg(unix)]
#[test]
fn a_pipe_in_the_place_of_a_table_is_named() {
    for file in ["mav0/imu0/data.csv", "mav0/cam0/sensor.yaml", "mav0/cam0/data.csv", "reference_poses.csv"] {
        let folder = tempfile::tempdir().unwrap();
        writer::write(&sequence(2), folder.path()).unwrap();
        let path = folder.path().join(file);
        std::fs::remove_file(&path).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        let opened = Sequence::open(folder.path());
        if let Err(error) = opened {
            assert!(error.to_string().contains(file), "{error}");
        } else {
            assert_eq!(file, "reference_poses.csv", "a pipe is no table that may be left out");
        }
    }
}

#[test]
fn a_descriptor_that_is_cut_off() {
    for digits in [1, 2] {
        let error =
            error_of("mav0/cam0/features.csv", |text| text.trim_end()[..text.len() - 1 - digits].to_owned());
        assert!(error.contains("line 13") && error.contains("cut off"), "{error}");
    }
}

#[test]
fn time_that_goes_back_in_what_was_seen_in_images() {
    for file in &TABLES[1..4] {
        let error = error_of(file, |text| {
            let stamp = text.lines().nth(1).unwrap().split(',').next().unwrap().to_owned();
            cell(&text, text.lines().count() - 1, 0, &stamp)
        });
        assert!(error.contains("line ") && error.contains("sort the file"), "{error}");
    }
}

#[test]
fn cells_that_are_not_finite_numbers() {
    for file in TABLES.into_iter().chain([TRUTH]) {
        for value in ["nan", "inf", "", "1.2.3", "0x10"] {
            let error = error_of(file, |text| cell(&text, 2, 2, value));
            assert!(error.contains("line 3"), "{error}");
        }
    }
}

#[test]
fn time_stamps_that_are_not_listed() {
    for file in &TABLES[1..4] {
        let error = error_of(file, |text| cell(&text, 1, 0, &(START_NS - 1).to_string()));
        assert!(error.contains("line 2") && error.contains("not in this camera's data.csv"), "{error}");
    }
}

#[test]
fn a_feature_twice_in_one_image() {
    let error = error_of("mav0/cam0/tracks.csv", |text| cell(&text, 2, 1, "0"));
    assert!(error.contains("line 3") && error.contains("twice"), "{error}");
}

#[test]
fn a_descriptor_that_is_not_hexadecimal() {
    let error = error_of("mav0/cam0/features.csv", |text| cell(&text, 1, 3, &"0g".repeat(32)));
    assert!(error.contains("line 2") && error.contains("\"0g\""), "{error}");
}

#[test]
fn a_quaternion_that_is_not_of_unit_length() {
    let error = error_of(TRUTH, |text| cell(&text, 1, 4, "3"));
    assert!(error.contains("line 2") && error.contains("quaternion"), "{error}");
}

#[test]
fn an_unknown_distortion_model() {
    let error = error_of("mav0/cam1/sensor.yaml", |text| {
        text.lines()
            .map(|line| if line.starts_with("distortion_model") { "distortion_model: mei" } else { line })
            .collect::<Vec<_>>()
            .join("\n")
    });
    assert!(error.contains("\"mei\"") && error.contains("equidistant"), "{error}");
}

#[test]
fn a_calibration_with_something_left_out() {
    for (file, key) in
        [("mav0/imu0/sensor.yaml", "gyroscope_noise_density"), ("mav0/cam0/sensor.yaml", "intrinsics")]
    {
        let error = error_of(file, |text| {
            text.lines().filter(|line| !line.starts_with(key)).collect::<Vec<_>>().join("\n")
        });
        assert!(error.contains(key), "{error}");
    }
}

#[test]
fn a_file_that_is_missing() {
    for file in ["mav0/imu0/sensor.yaml", "mav0/imu0/data.csv", "mav0/cam0/sensor.yaml", "mav0/cam0/data.csv"]
    {
        let folder = tempfile::tempdir().unwrap();
        writer::write(&sequence(2), folder.path()).unwrap();
        std::fs::remove_file(folder.path().join(file)).unwrap();
        let error = Sequence::open(folder.path()).unwrap_err();
        assert!(matches!(error, SequenceError::Missing { .. }), "{error}");
        assert!(error.to_string().contains(file), "{error}");
    }
    assert!(matches!(Sequence::open(Path::new("/nowhere")), Err(SequenceError::Missing { .. })));
}

#[test]
fn a_table_without_rows() {
    for file in ["mav0/imu0/data.csv", "mav0/cam0/data.csv", TRUTH, "reference_poses.csv"] {
        let error = error_of(file, |text| text.lines().next().unwrap().to_owned());
        assert!(error.contains("no rows"), "{error}");
    }
}
