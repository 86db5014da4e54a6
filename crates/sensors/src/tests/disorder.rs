//! Rows of a folder that are out of order.

use super::*;

const IMU: &str = "mav0/imu0/data.csv";
const TRUTH: &str = "mav0/state_groundtruth_estimate0/data.csv";
const CAMERAS: [&str; 2] = ["mav0/cam0/data.csv", "mav0/cam1/data.csv"];
const TRACKS: [&str; 4] =
    ["mav0/cam0/tracks.csv", "mav0/cam1/tracks.csv", "mav0/cam0/features.csv", "mav0/cam1/features.csv"];

/// Reorders the rows below the header of some tables of a recording, and reads it.
fn read(tables: &[&str], reorder: impl Fn(&mut Vec<String>)) -> Result<Sequence, SequenceError> {
    let folder = tempfile::tempdir().unwrap();
    writer::write(&sequence(2), folder.path()).unwrap();
    for table in tables {
        let path = folder.path().join(table);
        let text = std::fs::read_to_string(&path).unwrap();
        let (header, rows) = text.split_once('\n').unwrap();
        let mut rows: Vec<String> = rows.lines().map(str::to_owned).collect();
        reorder(&mut rows);
        std::fs::write(&path, format!("{header}\n{}\n", rows.join("\n"))).unwrap();
    }
    Sequence::open(folder.path())
}

/// Reverses groups of rows.
fn reverse(rows: &mut [String], count: usize) {
    rows.chunks_mut(count).for_each(<[String]>::reverse);
}

/// A recording as it comes back from disk.
fn expected() -> Sequence {
    let mut expected = read(&[], |_| {}).unwrap();
    expected.root = PathBuf::new();
    expected
}

type Reorder = fn(&mut Vec<String>);

#[test]
fn they_are_sorted_and_doubled_ones_read_once() {
    let with_tracks: Vec<&str> = CAMERAS.iter().chain(&TRACKS).copied().collect();
    let cases: [(&str, &[&str], Reorder); 9] = [
        ("two readings", &[IMU], |rows| rows.swap(10, 11)),
        ("the first two readings", &[IMU], |rows| rows.swap(0, 1)),
        ("groups of readings", &[IMU], |rows| reverse(rows, 7)),
        ("readings twice", &[IMU], |rows| rows.extend_from_within(40..)),
        ("readings twice in a row", &[IMU], |rows| rows.insert(7, rows[6].clone())),
        ("images of one camera", &CAMERAS[1..], |rows| rows.swap(3, 4)),
        ("images of both cameras, their tracks are in order", &CAMERAS, |rows| reverse(rows, 3)),
        ("an image twice", &CAMERAS[..1], |rows| rows.insert(3, rows[2].clone())),
        ("ground truth", &[TRUTH], |rows| reverse(rows, 2)),
    ];
    for (name, tables, reorder) in cases {
        let mut found = read(tables, reorder).unwrap_or_else(|error| panic!("{name}: {error}"));
        found.root = PathBuf::new();
        assert_eq!(found, expected(), "{name}");
    }
    // Tracks in the order of images that are out of order; those of one image stay in their order.
    let mut found = read(&with_tracks, |rows| {
        let stamp = |row: &String| row.split(',').next().unwrap().parse::<i64>().unwrap();
        let key = |row: &String| {
            let index = (stamp(row) - START_NS) / 100_000_000;
            (index / 3, -(index % 3))
        };
        rows.sort_by_key(key);
    })
    .unwrap();
    found.root = PathBuf::new();
    assert_eq!(found, expected());
}

#[test]
fn what_sorting_cannot_mend_is_refused_with_the_line() {
    let cases: [(&str, &str, Reorder, &str); 3] = [
        ("the halves have changed places", TRUTH, |rows| rows.rotate_left(5), "sort the file"),
        (
            "no row has a stamp",
            IMU,
            |rows| rows.iter_mut().for_each(|row| *row = stampless(row)),
            "stamps are zero",
        ),
        ("a row behind swapped ones is damaged", IMU, |rows| damaged(rows), "line 21"),
    ];
    for (name, table, reorder, said) in cases {
        let error = read(&[table], reorder).unwrap_err().to_string();
        assert!(error.contains(said) && error.contains("line "), "{name}: {error}");
    }
}

fn stampless(row: &str) -> String {
    format!("0,{}", row.split_once(',').unwrap().1)
}

fn damaged(rows: &mut [String]) {
    rows.swap(4, 5);
    rows[19] = "soon,1,2,3,4,5,6".to_owned();
}
