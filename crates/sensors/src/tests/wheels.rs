//! Wheels in folders: counts of encoders, and bases with other columns.

use super::*;
use crate::{Encoder, WheelReading};
use std::fmt::Write as _;

const SENSOR: &str = "T_BS: {data: [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]}\n";

/// A recording whose wheels are these files.
fn with_wheels(sensor: &str, rows: impl Fn(i64) -> String) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    writer::write(&sequence(2), folder.path()).unwrap();
    let wheels = folder.path().join("mav0/wheels0");
    std::fs::create_dir_all(&wheels).unwrap();
    let mut table = "#timestamp [ns],columns\n".to_owned();
    (0..20).for_each(|k| writeln!(table, "{},{}", START_NS + k * 20_000_000, rows(k)).unwrap());
    std::fs::write(wheels.join("data.csv"), table).unwrap();
    std::fs::write(wheels.join("sensor.yaml"), format!("{SENSOR}{sensor}")).unwrap();
    folder
}

#[test]
fn counts_that_wrap_around_are_read_as_speeds() {
    // 30 and -10 counts in 20 ms, of a counter that wraps around at 256.
    let counts = |k: i64| format!("{},{}", (30 * k).rem_euclid(256), (-10 * k).rem_euclid(256));
    let sensor = "radius: 0.1\ntrack: 0.5\ncounts_per_revolution: 100\ncounter_bits: 8\n";
    let folder = with_wheels(sensor, counts);
    let readings = Sequence::open(folder.path()).unwrap().wheel_readings;
    assert_eq!(readings.len(), 19, "the first counts have no speed");
    let per_count = std::f64::consts::TAU / 100.0 / 0.02;
    for (k, WheelReading { stamp_ns, values }) in readings.into_iter().enumerate() {
        assert_eq!(stamp_ns, START_NS + 10_000_000 + k as i64 * 20_000_000);
        assert!((values[0] - 30.0 * per_count).abs() < 1e-9 && (values[1] + 10.0 * per_count).abs() < 1e-9);
    }
    // The same without a sensor.yaml that says so, by a switch.
    let folder = with_wheels("radius: 0.1\ntrack: 0.5\n", counts);
    let files = CalibrationFiles {
        wheel_encoder: Some(Encoder::new(100.0, 8).unwrap()),
        ..CalibrationFiles::default()
    };
    let readings = Sequence::open_with(folder.path(), &files).unwrap().wheel_readings;
    assert!((readings[0].values[0] - 30.0 * per_count).abs() < 1e-9);
}

#[test]
fn a_base_has_its_own_columns() {
    let mecanum = "base: mecanum\nradius: 0.1\nreach: 0.4\n";
    let folder = with_wheels(mecanum, |k| format!("1,2,3,{k}"));
    let sequence = Sequence::open(folder.path()).unwrap();
    assert_eq!(sequence.wheel_readings[7], WheelReading::new(START_NS + 140_000_000, [1.0, 2.0, 3.0, 7.0]));
    let again = tempfile::tempdir().unwrap();
    writer::write(&sequence, again.path()).unwrap();
    let read = Sequence::open(again.path()).unwrap();
    assert_eq!((read.wheels, read.wheel_readings), (sequence.wheels, sequence.wheel_readings));
    let folder = with_wheels(mecanum, |_| "1,2".to_owned());
    let error = Sequence::open(folder.path()).unwrap_err().to_string();
    assert!(error.contains("2 numbers, but a mecanum base has 4: write front_left, "), "{error}");
}
