//! Stamps that are wrong or out of order.

use super::making::{Body, MS, Made, Message, START_NS, frames, messages, readings};
use ros_messages::geometry_msgs::Vector3;
use sensors::{Sequence, writer};

const CAMERA: [&str; 1] = ["/cam0/image_raw"];
const DAY: i64 = 86_400_000 * MS;

#[test]
fn one_wrong_stamp_in_a_bag_costs_its_message_only() {
    let control = Made::new(&messages(1), &CAMERA).open().unwrap();
    for (topic, index) in
        [("/imu0", 100), ("/imu0", 0), ("/imu0", 399), (CAMERA[0], 7), (CAMERA[0], 0), (CAMERA[0], 39)]
    {
        for by_ns in [DAY, -DAY, 365 * DAY, -365 * DAY] {
            let mut all = messages(1);
            all.iter_mut().filter(|message| message.topic == topic).nth(index).unwrap().shift(by_ns);
            let found = Made::new(&all, &CAMERA).open().unwrap();
            let name = format!("{topic} {index} by {} days", by_ns / DAY);
            let (mut expected_readings, mut expected_frames) = (readings(&control), frames(&control));
            if topic == "/imu0" {
                expected_readings.remove(index);
            } else {
                expected_frames.remove(index);
            }
            assert_eq!(readings(&found), expected_readings, "{name}");
            assert_eq!(frames(&found), expected_frames, "{name}");
            assert_eq!(found.contents().frames, Some(expected_frames.len()), "{name}");
        }
    }
}

#[test]
fn one_wrong_stamp_in_a_folder_costs_its_row_only() {
    let control = Made::new(&messages(1), &CAMERA);
    let mut sequence = Sequence::open(&control.path).unwrap();
    sequence.frames.iter_mut().for_each(|frame| frame.images.clear());
    for (table, index) in [("imu0", 100), ("imu0", 399), ("imu0", 0), ("cam0", 7), ("cam0", 39)] {
        for by_ns in [DAY, -DAY] {
            let folder = tempfile::tempdir().unwrap();
            writer::write(&sequence, folder.path()).unwrap();
            let path = folder.path().join(format!("mav0/{table}/data.csv"));
            let text = std::fs::read_to_string(&path).unwrap();
            let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
            let (stamp, rest) = lines[index + 1].split_once(',').unwrap();
            lines[index + 1] = format!("{},{rest}", stamp.parse::<i64>().unwrap() + by_ns);
            std::fs::write(&path, lines.join("\n") + "\n").unwrap();
            let read = Sequence::open(folder.path()).unwrap();
            let mut expected = sequence.clone();
            if table == "imu0" {
                expected.imu_samples.remove(index);
            } else {
                expected.frames.remove(index);
            }
            let name = format!("{table} {index} by {} days", by_ns / DAY);
            assert_eq!(read.imu_samples, expected.imu_samples, "{name}");
            assert_eq!(read.frames, expected.frames, "{name}");
        }
    }
}

/// What is done to a message, by its number.
type Change = fn(usize, &mut Message);

#[test]
fn what_was_recorded_out_of_order_is_sorted_and_none_is_lost() {
    let control = Made::new(&messages(1), &CAMERA).open().unwrap();
    let cases: [(&str, Change); 3] = [
        ("groups of four, the last first", |index, message| {
            let begin_ns = START_NS + (index / 4 * 4) as i64 * 5 * MS;
            message.log_ns = begin_ns + 20 * MS + (3 - index % 4) as i64 * MS / 10;
        }),
        ("every tenth is late by up to 30 ms", |index, message| {
            message.log_ns += if index % 10 == 4 { (7 + index as i64 % 23) * MS } else { 0 };
        }),
        ("log times are all the same", |_, message| message.log_ns = 1000),
    ];
    for (name, change) in cases {
        let mut all = messages(1);
        let of_imu = all.iter_mut().filter(|message| message.topic == "/imu0");
        of_imu.enumerate().for_each(|(index, message)| change(index, message));
        let found = Made::new(&all, &CAMERA).open().unwrap();
        assert_eq!(readings(&found), readings(&control), "{name}");
        assert_eq!(frames(&found), frames(&control), "{name}");
    }
}

#[test]
fn a_clock_that_steps_back_loses_nothing() {
    let mut all = messages(1);
    let step_ns = 10_000 * MS;
    for message in &mut all {
        if message.log_ns > START_NS + 1000 * MS {
            message.shift(-step_ns);
        }
    }
    let found = Made::new(&all, &CAMERA).open().unwrap();
    let control = Made::new(&messages(1), &CAMERA).open().unwrap();
    assert_eq!(readings(&found).len(), readings(&control).len());
    let (found, control) = (frames(&found), frames(&control));
    assert_eq!(found.len(), control.len());
    let is_near = |a: i64, b: i64| (a - b).abs() < MS;
    assert!(found.iter().zip(&control).all(|((a, _), (b, _))| is_near(*a, *b)), "{found:?}");
}

#[test]
fn rates_come_from_the_stamps() {
    let mut all = messages(1);
    for message in &mut all {
        message.log_ns = 1000;
    }
    let made = Made::new(&all, &CAMERA);
    let noise = super::making::NOISE.replace("update_rate: 200.0\n", "");
    std::fs::write(
        made.folder.path().join("imu.yaml"),
        format!("imu0:\n  {}", noise.trim().replace('\n', "\n  ")),
    )
    .unwrap();
    let recording = made.open().unwrap();
    assert!((recording.calibration().imu.as_ref().unwrap().rate_hz - 200.0).abs() < 1e-6);
    assert!((recording.calibration().cameras[0].rate_hz - 20.0).abs() < 1e-6);
}

#[test]
fn stamps_that_tell_nothing_are_refused_by_what_is_wrong_with_them() {
    type Change = fn(usize, &mut Message);
    let cases: [(&str, &str, Change, &str); 5] = [
        (
            "readings are not stamped",
            "/imu0",
            |index, message| message.shift(-stamp(5, index)),
            "/imu0 have one time stamp",
        ),
        (
            "images are not stamped",
            CAMERA[0],
            |index, message| message.shift(-stamp(50, index)),
            "/cam0/image_raw have one time",
        ),
        (
            "images of another epoch",
            CAMERA[0],
            |_, message| message.shift(-START_NS + 5000 * MS),
            "different epochs",
        ),
        (
            "readings of another epoch",
            "/imu0",
            |_, message| message.shift(-START_NS + 5000 * MS),
            "different epochs",
        ),
        ("an accelerometer only", "/imu0", |_, message| without_gyroscope(message), "accelerations only"),
    ];
    for (name, topic, change, said) in cases {
        let mut all = messages(1);
        let of_topic = all.iter_mut().filter(|message| message.topic == topic);
        of_topic.enumerate().for_each(|(index, message)| change(index, message));
        let error = Made::new(&all, &CAMERA).open().unwrap_err().to_string();
        assert!(error.contains(said), "{name}: {error}");
        assert_eq!(error.lines().next().map(|line| line.contains(said)), Some(true), "{name}: {error}");
    }
}

/// The stamp of a message of a topic.
fn stamp(interval_ms: i64, index: usize) -> i64 {
    START_NS + index as i64 * interval_ms * MS
}

fn without_gyroscope(message: &mut Message) {
    if let Body::Imu(imu) = &mut message.body {
        imu.angular_velocity = Vector3::default();
        imu.angular_velocity_covariance[0] = -1.0;
    }
}
