//! The same recording in every format, written by Python's rosbags and mcap (`data/make.py`).

use bags::{Bag, BagError, Encoding, Topic};
use std::path::{Path, PathBuf};

const ROS2: [&str; 4] = ["excerpt_mcap", "excerpt_zstd.mcap", "excerpt_db3", "excerpt_packed"];
const ROS1: [&str; 3] = ["excerpt.bag", "excerpt_bz2.bag", "excerpt_ros1.mcap"];

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// Log time and bytes of the messages of a topic.
fn messages(bag: &Bag, topic: &Topic) -> Vec<(i64, Vec<u8>)> {
    topic.messages.iter().map(|message| (message.log_ns, bag.read(message.place).unwrap())).collect()
}

fn rows_of(table: &str) -> usize {
    let text = std::fs::read_to_string(data("euroc/mav0").join(table)).unwrap();
    text.lines().filter(|line| !line.starts_with('#')).count()
}

#[test]
fn every_format_holds_the_same_messages() {
    let (readings, images) = (rows_of("imu0/data.csv"), rows_of("cam0/data.csv"));
    for (names, encoding) in [(&ROS2[..], Encoding::Cdr), (&ROS1[..], Encoding::Ros1)] {
        let first = Bag::open(&data(names[0])).unwrap();
        let counts: Vec<_> = first
            .topics()
            .iter()
            .map(|topic| (topic.name.as_str(), topic.type_name.as_str(), topic.messages.len()))
            .collect();
        let expected = [
            ("/cam0/camera_info", "sensor_msgs/CameraInfo", images),
            ("/cam0/image_raw", "sensor_msgs/Image", images),
            ("/cam1/camera_info", "sensor_msgs/CameraInfo", images),
            ("/cam1/image_raw/compressed", "sensor_msgs/CompressedImage", images),
            ("/chatter", "std_msgs/String", 1),
            ("/imu0", "sensor_msgs/Imu", readings),
        ];
        assert_eq!(counts, expected, "{}", names[0]);
        for name in names {
            let bag = Bag::open(&data(name)).unwrap();
            assert!(bag.damage().is_empty(), "{name}: {:?}", bag.damage());
            for (topic, same) in bag.topics().iter().zip(first.topics()) {
                assert_eq!(topic.encoding, encoding, "{name}");
                assert!(topic.schema.is_some(), "{name}: {}", topic.name);
                assert!(topic.messages.is_sorted_by_key(|message| message.log_ns), "{name}: {}", topic.name);
                assert_eq!(messages(&bag, topic), messages(&first, same), "{name}: {}", topic.name);
            }
        }
    }
}

#[test]
fn a_file_of_a_folder_can_be_opened_alone() {
    for name in ["excerpt_mcap/excerpt_mcap.mcap", "excerpt_db3/excerpt_db3.db3"] {
        let (alone, folder) = (data(name), data(name).parent().unwrap().to_path_buf());
        assert!(Bag::is_bag(&alone) && Bag::is_bag(&folder));
        let (alone, folder) = (Bag::open(&alone).unwrap(), Bag::open(&folder).unwrap());
        assert_eq!(alone.topics(), folder.topics());
    }
}

#[test]
fn the_start_of_a_message_is_read_without_the_rest() {
    for name in ROS2.iter().chain(&ROS1) {
        let bag = Bag::open(&data(name)).unwrap();
        let place = bag.topics()[1].messages[2].place;
        assert_eq!(bag.read_start(place, 30).unwrap(), bag.read(place).unwrap()[..30], "{name}");
    }
}

#[test]
fn what_is_no_recording_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let text = folder.path().join("notes.mcap");
    std::fs::write(&text, "no MCAP").unwrap();
    for path in [folder.path(), &text, &data("euroc")] {
        assert!(!Bag::is_bag(path));
        assert!(matches!(Bag::open(path), Err(BagError::UnknownFormat { .. })), "{}", path.display());
    }
    assert!(matches!(Bag::open(&folder.path().join("missing.bag")), Err(BagError::Io { .. })));
}
