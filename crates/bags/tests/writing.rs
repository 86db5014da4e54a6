//! What is written is read again.

use bags::{Bag, BagError, BagWriter, Encoding, Format, MessageType, Metadata, OfferedQos};
use std::path::Path;

const FORMATS: [Format; 2] = [Format::Mcap, Format::Rosbag2];
const START_NS: i64 = 1_403_636_579_763_555_584;

fn types() -> [MessageType; 2] {
    let of =
        |name, definition: &str| MessageType { name, hash: "RIHS01_0", definition: definition.to_owned() };
    [of("std_msgs/msg/String", "string data\n"), of("sensor_msgs/msg/Imu", "std_msgs/Header header\n")]
}

fn message(number: u8) -> (i64, Vec<u8>) {
    (START_NS + i64::from(number) * 5_000_000, [&[0, 1, 0, 0, number][..], &[7; 300]].concat())
}

/// Writes messages to two topics, every third to the second.
fn write(writer: &mut BagWriter, numbers: std::ops::Range<u8>) {
    let [text, imu] = types();
    let qos = OfferedQos::default();
    let topics = [writer.topic("/chatter", &text, qos).unwrap(), writer.topic("/imu", &imu, qos).unwrap()];
    for number in numbers {
        let (log_ns, bytes) = message(number);
        writer.write(topics[usize::from(number % 3 == 0)], log_ns, &bytes).unwrap();
    }
}

fn check(path: &Path, format: Format, numbers: std::ops::Range<u8>) {
    let bag = Bag::open(path).unwrap();
    let found: Vec<_> = bag.topics().iter().map(|topic| (&*topic.name, &*topic.type_name)).collect();
    assert_eq!(found, [("/chatter", "std_msgs/String"), ("/imu", "sensor_msgs/Imu")], "{format:?}");
    for (topic, of) in bag.topics().iter().zip(types()) {
        assert_eq!(topic.encoding, Encoding::Cdr);
        let schema = topic.schema.as_ref().unwrap();
        assert_eq!((&*schema.encoding, &*schema.text), ("ros2msg", of.definition.as_bytes()), "{format:?}");
        let is_imu = topic.name == "/imu";
        let expected: Vec<_> =
            numbers.clone().filter(|number| (number % 3 == 0) == is_imu).map(message).collect();
        let read = topic.messages.iter().map(|message| (message.log_ns, bag.read(message.place).unwrap()));
        assert_eq!(read.collect::<Vec<_>>(), expected, "{format:?}");
    }
}

#[test]
fn both_formats_are_read_back_with_all_they_hold() {
    let folder = tempfile::tempdir().unwrap();
    for format in FORMATS {
        let path = folder.path().join(format!("{format:?}"));
        let mut writer = BagWriter::create(&path, format).unwrap();
        write(&mut writer, 0..100);
        writer.finish().unwrap();
        assert!(Bag::open(&path).unwrap().damage().is_empty(), "{:?}", Bag::open(&path).unwrap().damage());
        check(&path, format, 0..100);
    }
}

#[test]
fn what_was_flushed_is_there_when_the_program_is_killed() {
    let folder = tempfile::tempdir().unwrap();
    for format in FORMATS {
        let path = folder.path().join(format!("{format:?}"));
        let mut writer = BagWriter::create(&path, format).unwrap();
        write(&mut writer, 0..60);
        writer.flush().unwrap();
        write(&mut writer, 60..70);
        // What a killed program leaves: the files as they are, and no word to the writer.
        let left = folder.path().join(format!("{format:?}_left"));
        let file = if path.is_dir() { path.join(format!("{format:?}_0.db3")) } else { path.clone() };
        std::fs::copy(&file, &left).unwrap();
        let log = file.with_extension("db3-wal");
        if log.exists() {
            std::fs::copy(log, folder.path().join(format!("{format:?}_left-wal"))).unwrap();
        }
        check(&left, format, 0..60);
    }
}

#[test]
fn what_is_there_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    for format in FORMATS {
        let path = folder.path().join(format!("{format:?}"));
        std::fs::write(&path, "mine").unwrap();
        let error = BagWriter::create(&path, format).unwrap_err();
        assert!(matches!(&error, BagError::Io { .. }) && error.to_string().contains("exists"), "{error}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "mine");
    }
}

#[test]
fn players_are_told_what_to_offer() {
    let folder = tempfile::tempdir().unwrap();
    let offered = [
        ("/tf_static", OfferedQos::Latched { depth: 1 }, ["depth: 1", "reliable", "transient_local"]),
        ("/imu", OfferedQos::BestEffort { depth: 5 }, ["depth: 5", "best_effort", "volatile"]),
        ("/odometry", OfferedQos::default(), ["depth: 10", "reliable", "volatile"]),
    ];
    let write = |path: &Path, format| {
        let mut writer = BagWriter::create(path, format).unwrap();
        for (name, qos, _) in offered {
            let topic = writer.topic(name, &types()[0], qos).unwrap();
            writer.write(topic, START_NS, &[0, 1, 0, 0]).unwrap();
        }
        writer.finish().unwrap();
    };
    let mcap = folder.path().join("drive.mcap");
    write(&mcap, Format::Mcap);
    let summary = mcap::Summary::read(&std::fs::read(&mcap).unwrap()).unwrap().unwrap();
    let rosbag2 = folder.path().join("drive");
    write(&rosbag2, Format::Rosbag2);
    let metadata = std::fs::read_to_string(rosbag2.join("metadata.yaml")).unwrap();
    for (name, _, [depth, reliability, durability]) in offered {
        let channel = summary.channels.values().find(|channel| channel.topic == name).unwrap();
        let expected = format!("{depth}\n  reliability: {reliability}\n  durability: {durability}\n");
        let profiles = &channel.metadata["offered_qos_profiles"];
        assert!(profiles.starts_with("- history: keep_last\n") && profiles.contains(&expected), "{profiles}");
        assert_eq!(channel.metadata["topic_type_hash"], "RIHS01_0");
        let topic = metadata.split("- topic_metadata:").find(|topic| topic.contains(name)).unwrap();
        assert!(topic.contains(&expected.replace("\n  ", "\n            ")), "{topic}");
    }
}

/// With what YAML and JSON have words for.
fn texts() -> Metadata {
    let entries =
        [("imu0/sensor.yaml", "rate_hz: 200\n\n# \"x\": {y}\t\\ \u{fc}\n"), ("maker", "~"), ("", "no")];
    let entries = entries.map(|(name, text)| (name.to_owned(), text.to_owned())).into();
    Metadata { name: "calibration".to_owned(), entries }
}

#[test]
fn names_with_signs_of_yaml_are_read_back() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["hall #2", "run: 2", "[a] 'b' \"c\"", "2026-11-30", "\u{fc}ber"] {
        let path = folder.path().join(name);
        let mut writer = BagWriter::create(&path, Format::Rosbag2).unwrap();
        let topic = writer.topic(&format!("/{name}"), &types()[0], OfferedQos::default()).unwrap();
        writer.write(topic, START_NS, &[0, 1, 0, 0]).unwrap();
        writer.finish().unwrap();
        let bag = Bag::open(&path).unwrap();
        let topics: Vec<_> = bag.topics().iter().map(|topic| (&*topic.name, topic.messages.len())).collect();
        assert_eq!(topics, [(&*format!("/{name}"), 1)]);
        assert!(bag.notes().is_empty(), "{:?}", bag.notes());
    }
}

#[test]
fn texts_about_a_recording_come_back() {
    let folder = tempfile::tempdir().unwrap();
    for format in FORMATS {
        let path = folder.path().join(format!("{format:?}"));
        let mut writer = BagWriter::create(&path, format).unwrap();
        writer.metadata(&texts()).unwrap();
        write(&mut writer, 0..60);
        writer.flush().unwrap();
        if format == Format::Rosbag2 {
            // Its recorder may be killed.
            let bag = Bag::open(&path).unwrap();
            assert_eq!((bag.metadata(), bag.notes().len()), (&[texts()][..], 2), "{:?}", bag.notes());
        }
        writer.finish().unwrap();
        assert_eq!(Bag::open(&path).unwrap().metadata(), [texts()], "{format:?}");
        check(&path, format, 0..60);
    }
    // One file of a rosbag2, alone.
    let file = folder.path().join("Rosbag2/Rosbag2_0.db3");
    assert_eq!(Bag::open(&file).unwrap().metadata(), [texts()]);
    // `metadata.yaml` of others: of the files in the folder nothing is known.
    rusqlite::Connection::open(&file).unwrap().execute("DELETE FROM metadata", ()).unwrap();
    assert_eq!(Bag::open(&folder.path().join("Rosbag2")).unwrap().metadata(), [texts()]);
}

#[test]
fn texts_about_a_recording_are_in_a_file_that_is_cut_off() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    let mut writer = BagWriter::create(&path, Format::Mcap).unwrap();
    writer.metadata(&texts()).unwrap();
    write(&mut writer, 0..60);
    writer.finish().unwrap();
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    assert_eq!(Bag::open(&path).unwrap().metadata(), [texts()]);
}
