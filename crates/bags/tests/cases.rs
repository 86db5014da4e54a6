//! Recordings as robots leave them: compressed, without `metadata.yaml`, of a recorder that was killed.

use bags::{Bag, BagError, BagWriter, Format, MessageType, OfferedQos};
use std::path::{Path, PathBuf};

const START_NS: i64 = 1_403_636_579_763_555_584;

fn message(number: u8) -> (i64, Vec<u8>) {
    (START_NS + i64::from(number) * 5_000_000, [&[0, 1, 0, 0, number][..], &[7; 300]].concat())
}

fn pack(bytes: &[u8]) -> Vec<u8> {
    zstd::encode_all(bytes, 3).unwrap()
}

/// Writes messages to a topic; `change` is applied to their bytes.
fn write(
    path: &Path,
    format: Format,
    numbers: std::ops::Range<u8>,
    change: fn(&[u8]) -> Vec<u8>,
) -> BagWriter {
    let mut writer = BagWriter::create(path, format).unwrap();
    let definition = "string data\n".to_owned();
    let of = MessageType { name: "std_msgs/msg/String", hash: "RIHS01_0", definition };
    let topic = writer.topic("/chatter", &of, OfferedQos::default()).unwrap();
    for number in numbers {
        let (log_ns, bytes) = message(number);
        writer.write(topic, log_ns, &change(&bytes)).unwrap();
    }
    writer
}

fn as_it_is(bytes: &[u8]) -> Vec<u8> {
    bytes.to_vec()
}

/// The folder of a rosbag2 with 60 messages in one file of SQLite.
fn rosbag2(folder: &Path, change: fn(&[u8]) -> Vec<u8>) -> PathBuf {
    let path = folder.join("drive");
    write(&path, Format::Rosbag2, 0..60, change).finish().unwrap();
    path
}

/// Compresses a file as a whole; the file itself is removed.
fn pack_file(path: &Path, ending: &str) -> PathBuf {
    let packed = PathBuf::from(format!("{}.{ending}", path.display()));
    std::fs::write(&packed, pack(&std::fs::read(path).unwrap())).unwrap();
    std::fs::remove_file(path).unwrap();
    packed
}

fn replace(path: &Path, from: &str, to: &str) {
    let text = std::fs::read_to_string(path).unwrap();
    assert!(text.contains(from), "{text}");
    std::fs::write(path, text.replace(from, to)).unwrap();
}

/// Each kind: makes a recording of the messages 0 to 59 in a folder, and a part of each note that is expected.
type Case = (&'static str, fn(&Path) -> PathBuf, &'static [&'static str]);

const CASES: [Case; 11] = [
    ("as rosbag2 writes it", |folder| rosbag2(folder, as_it_is), &[]),
    (
        "without metadata.yaml",
        |folder| {
            let path = rosbag2(folder, as_it_is);
            std::fs::remove_file(path.join("metadata.yaml")).unwrap();
            path
        },
        &["metadata.yaml is missing"],
    ),
    (
        "two files of MCAP without metadata.yaml",
        |folder| {
            let path = folder.join("drive");
            std::fs::create_dir(&path).unwrap();
            // In the order of numbers, not of names.
            write(&path.join("drive_10.mcap"), Format::Mcap, 40..60, as_it_is).finish().unwrap();
            write(&path.join("drive_9.mcap"), Format::Mcap, 0..40, as_it_is).finish().unwrap();
            path
        },
        &["metadata.yaml is missing"],
    ),
    (
        "compressed by file, named so in metadata.yaml",
        |folder| {
            let path = rosbag2(folder, as_it_is);
            pack_file(&path.join("drive_0.db3"), "zstd");
            let metadata = path.join("metadata.yaml");
            replace(&metadata, "drive_0.db3", "drive_0.db3.zstd");
            replace(&metadata, "compression_format: \"\"", "compression_format: zstd");
            replace(&metadata, "compression_mode: \"\"", "compression_mode: FILE");
            path
        },
        &["compressed as a whole"],
    ),
    (
        "compressed by file, not named so",
        |folder| {
            let path = rosbag2(folder, as_it_is);
            pack_file(&path.join("drive_0.db3"), "zstd");
            path
        },
        &["compressed as a whole"],
    ),
    (
        "compressed by file, without metadata.yaml",
        |folder| {
            let path = rosbag2(folder, as_it_is);
            std::fs::remove_file(path.join("metadata.yaml")).unwrap();
            pack_file(&path.join("drive_0.db3"), "zst");
            path
        },
        &["metadata.yaml is missing", "compressed as a whole"],
    ),
    (
        "one compressed file",
        |folder| {
            let path = folder.join("drive.mcap");
            write(&path, Format::Mcap, 0..60, as_it_is).finish().unwrap();
            pack_file(&path, "zst")
        },
        &["compressed as a whole"],
    ),
    (
        "compressed by message",
        |folder| {
            let path = rosbag2(folder, pack);
            let metadata = path.join("metadata.yaml");
            replace(&metadata, "compression_format: \"\"", "compression_format: zstd");
            replace(&metadata, "compression_mode: \"\"", "compression_mode: message");
            path
        },
        &[],
    ),
    ("compressed by message, the .db3 alone", |folder| rosbag2(folder, pack).join("drive_0.db3"), &[]),
    (
        "compressed by message in MCAP",
        |folder| {
            let path = folder.join("drive.mcap");
            write(&path, Format::Mcap, 0..60, pack).finish().unwrap();
            path
        },
        &[],
    ),
    (
        "the log of a recorder that was killed, where none can be opened",
        |folder| {
            let written = folder.join("written");
            let mut writer = write(&written, Format::Rosbag2, 0..60, as_it_is);
            writer.flush().unwrap();
            let left = folder.join("drive");
            std::fs::create_dir(&left).unwrap();
            for ending in ["", "-wal"] {
                let (from, to) = (format!("written_0.db3{ending}"), format!("drive_0.db3{ending}"));
                std::fs::copy(written.join(from), left.join(to)).unwrap();
            }
            // As on a read-only disk, SQLite's own file cannot be made.
            std::os::unix::fs::symlink(folder.join("nowhere/shm"), left.join("drive_0.db3-shm")).unwrap();
            left
        },
        &["metadata.yaml is missing", "write-ahead log", "copies were made"],
    ),
];

#[test]
fn every_kind_is_read_as_the_others_and_what_was_done_is_said() {
    for (name, make, notes) in CASES {
        let folder = tempfile::tempdir().unwrap();
        let path = make(folder.path());
        assert!(Bag::is_bag(&path), "{name}");
        let bag = Bag::open(&path).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(bag.damage(), [] as [String; 0], "{name}");
        let [topic] = bag.topics() else { panic!("{name}: {:?}", bag.topics()) };
        let found = topic.messages.iter().map(|message| (message.log_ns, bag.read(message.place).unwrap()));
        assert_eq!(found.collect::<Vec<_>>(), (0..60).map(message).collect::<Vec<_>>(), "{name}");
        let first = topic.messages[0].place;
        assert_eq!(bag.read_start(first, 5).unwrap(), message(0).1[..5], "{name}");
        assert_eq!(bag.read_start(first, 2).unwrap(), message(0).1[..2], "{name}");
        assert_eq!(bag.notes().len(), notes.len(), "{name}: {:?}", bag.notes());
        for (said, expected) in bag.notes().iter().zip(notes) {
            assert!(said.contains(expected), "{name}: {said}");
        }
    }
}

#[test]
fn what_is_unpacked_is_removed_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    write(&path, Format::Mcap, 0..60, as_it_is).finish().unwrap();
    let bag = Bag::open(&pack_file(&path, "zstd")).unwrap();
    let note = &bag.notes()[0];
    let unpacked = note.split("unpacked to ").nth(1).unwrap().split(" for now").next().unwrap();
    assert!(Path::new(unpacked).is_file(), "{note}");
    let unpacked = unpacked.to_owned();
    drop(bag);
    assert!(!Path::new(&unpacked).parent().unwrap().exists());
}

/// Bytes that cannot be compressed, so that there are blocks to lose.
fn noise(bytes: &[u8]) -> Vec<u8> {
    let mut state = u64::from(bytes[4]) + 1;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 56) as u8
    };
    [&bytes[..5], &(0..20_000).map(|_| next()).collect::<Vec<_>>()].concat()
}

#[test]
fn a_compressed_file_that_is_cut_off_is_read_up_to_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    write(&path, Format::Mcap, 0..60, noise).finish().unwrap();
    let packed = pack_file(&path, "zstd");
    let whole = std::fs::read(&packed).unwrap();
    std::fs::write(&packed, &whole[..whole.len() / 2]).unwrap();
    let bag = Bag::open(&packed).unwrap();
    assert!(
        bag.notes().iter().any(|note| note.contains("cannot be unpacked to its end")),
        "{:?}",
        bag.notes()
    );
    assert!(!bag.damage().is_empty());
}

#[test]
fn folders_that_are_no_single_recording_are_refused_or_left_to_others() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write(&at("monday.mcap"), Format::Mcap, 0..60, as_it_is).finish().unwrap();
    write(&at("tuesday.mcap"), Format::Mcap, 0..60, as_it_is).finish().unwrap();
    let error = Bag::open(folder.path()).unwrap_err();
    assert!(matches!(error, BagError::Invalid { .. }), "{error}");
    let text = error.to_string();
    assert!(
        text.contains("monday.mcap") && text.contains("tuesday.mcap") && text.contains("name the one"),
        "{text}"
    );
    // A folder in the EuRoC layout, with something beside it.
    std::fs::create_dir(at("mav0")).unwrap();
    assert!(!Bag::is_bag(folder.path()));
}
