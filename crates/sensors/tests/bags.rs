//! The same recording as a folder in the EuRoC layout and as a bag of every format gives the same events.
//!
//! The files were written by Python's rosbags and mcap: `crates/bags/tests/data/make.py`.

use bags::{BagWriter, Format, MessageType, OfferedQos};
use nalgebra::Vector3;
use ros_messages::sensor_msgs::{CompressedImage, Imu};
use ros_messages::{RosMessage, definition, encode};
use sensors::ros::{ImageMessage, image_message, imu_message};
use sensors::{CalibrationFiles, ImageData, Recording, SensorEvent, SensorSource, Sequence, SequenceError};
use std::path::{Path, PathBuf};

const BAGS: [&str; 9] = [
    "excerpt_mcap",
    "excerpt_mcap/excerpt_mcap.mcap",
    "excerpt_zstd.mcap",
    "excerpt_ros1.mcap",
    "excerpt.bag",
    "excerpt_bz2.bag",
    "excerpt_db3",
    "excerpt_db3/excerpt_db3.db3",
    "excerpt_packed",
];

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../bags/tests/data").join(name)
}

/// The calibration of the folder.
fn files() -> CalibrationFiles {
    let mut files = CalibrationFiles::default();
    files.cameras = Some(data("euroc"));
    files
}

fn pixels(image: Option<&ImageData>) -> Vec<u8> {
    image.unwrap().read().unwrap().pixels().to_vec()
}

fn events(recording: &Recording<'_>) -> Vec<SensorEvent> {
    let mut source = recording.source().unwrap();
    std::iter::from_fn(|| source.next().unwrap()).collect()
}

#[test]
fn every_format_gives_the_events_of_the_folder() {
    let folder = Recording::open(&data("euroc")).unwrap();
    let expected = events(&folder);
    for name in BAGS {
        let bag = Recording::open_with(&data(name), &files()).unwrap();
        assert_eq!(bag.calibration(), folder.calibration(), "{name}");
        assert_eq!(bag.contents(), folder.contents(), "{name}");
        let events = events(&bag);
        assert_eq!(events.len(), expected.len(), "{name}");
        for (found, expected) in events.iter().zip(&expected) {
            match (found, expected) {
                (SensorEvent::Frame(found), SensorEvent::Frame(expected)) => {
                    assert_eq!(found.stamp_ns, expected.stamp_ns, "{name}");
                    assert!(found.images.keys().eq(expected.images.keys()), "{name}");
                    for (found, expected) in found.images.values().zip(expected.images.values()) {
                        assert_eq!(pixels(Some(found)), pixels(Some(expected)), "{name}");
                    }
                }
                _ => assert_eq!(found, expected, "{name}"),
            }
        }
    }
}

#[test]
fn a_sequence_in_memory_has_the_same_frames() {
    let bag = Sequence::open_with(&data("excerpt.bag"), &files()).unwrap();
    let folder = Sequence::open(&data("euroc")).unwrap();
    assert_eq!(bag.imu_samples, folder.imu_samples);
    let stamps = |sequence: &Sequence| sequence.frames.iter().map(|frame| frame.stamp_ns).collect::<Vec<_>>();
    assert_eq!(stamps(&bag), stamps(&folder));
}

/// Extrinsics and noise; the projection comes from the recorded `CameraInfo`.
const MOUNTING: &str = "cam0:\n  T_cam_imu:\n  - [0.0, 1.0, 0.0, 0.1]\n  - [-1.0, 0.0, 0.0, 0.2]\n  - [0.0, 0.0, 1.0, 0.3]\n  \
    - [0.0, 0.0, 0.0, 1.0]\n  timeshift_cam_imu: 0.01\ncam1:\n  T_cn_cnm1:\n  - [1.0, 0.0, 0.0, -0.1]\n  \
    - [0.0, 1.0, 0.0, 0.0]\n  - [0.0, 0.0, 1.0, 0.0]\n  - [0.0, 0.0, 0.0, 1.0]\nimu0:\n  gyroscope_noise_density: 1.0e-4\n  \
    gyroscope_random_walk: 1.0e-5\n  accelerometer_noise_density: 1.0e-3\n  accelerometer_random_walk: 1.0e-4\n";

#[test]
fn camera_info_needs_only_extrinsics_and_noise() {
    for name in ["excerpt.bag", "excerpt_zstd.mcap"] {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join(name);
        std::fs::copy(data(name), &bag).unwrap();
        let error = Recording::open(&bag).unwrap_err().to_string();
        assert!(error.contains("--calibration"), "{error}");
        std::fs::write(bag.with_extension("yaml"), MOUNTING).unwrap();
        let recording = Recording::open(&bag).unwrap();
        let (found, expected) = (recording.calibration(), Recording::open(&data("euroc")).unwrap());
        for (found, expected) in found.cameras.iter().zip(&expected.calibration().cameras) {
            assert_eq!(found.camera, expected.camera, "{name}");
        }
        let imu = found.imu.as_ref().unwrap();
        assert!((imu.rate_hz - 200.0).abs() < 1.0 && (imu.noise.gyroscope - 1e-4).abs() < 1e-12);
        let point = found.cameras[1].imu_from_camera.transform(&Vector3::new(0.0, 0.0, 1.0));
        assert!((point - Vector3::new(0.2, 0.0, 0.7)).norm() < 1e-12, "{point}");
        let first = recording.frames().unwrap().next().unwrap().unwrap().stamp_ns;
        let plain = expected.frames().unwrap().next().unwrap().unwrap().stamp_ns;
        assert_eq!(first - plain, 10_000_000);
    }
}

#[test]
fn topics_can_be_named_and_wrong_names_are_refused_with_a_list() {
    let mut named = files();
    named.camera_topics = vec!["/cam1/image_raw/compressed".to_owned()];
    named.imu_topic = Some("imu0".to_owned());
    let recording = Recording::open_with(&data("excerpt_db3"), &named).unwrap();
    assert_eq!(recording.calibration().cameras.len(), 1);
    let mirrored = recording.frames().unwrap().next().unwrap().unwrap();
    let folder = Recording::open(&data("euroc")).unwrap();
    let frame = folder.frames().unwrap().next().unwrap().unwrap();
    assert_eq!(pixels(mirrored.images.get(&0)), pixels(frame.images.get(&1)));
    for (wrong, expected) in
        [("/chatter", "std_msgs/String"), ("/imu0", "sensor_msgs/Imu"), ("/cam7", "/cam0/image_raw")]
    {
        named.camera_topics = vec![wrong.to_owned()];
        let error = Recording::open_with(&data("excerpt_db3"), &named).unwrap_err();
        assert!(matches!(error, SequenceError::Topics { .. }), "{error}");
        assert!(error.to_string().contains(expected), "{error}");
    }
}

#[test]
fn a_bag_that_is_cut_off_is_played_up_to_there() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["excerpt.bag", "excerpt_ros1.mcap", "excerpt_mcap/excerpt_mcap.mcap"] {
        let whole = std::fs::read(data(name)).unwrap();
        let path = folder.path().join("cut");
        std::fs::write(&path, &whole[..whole.len() * 2 / 3]).unwrap();
        let cut = Recording::open_with(&path, &files()).unwrap();
        let all = Recording::open_with(&data(name), &files()).unwrap();
        let (cut, all) = (events(&cut), events(&all));
        assert!(cut.len() > all.len() / 3 && cut.len() < all.len(), "{name}: {} of {}", cut.len(), all.len());
    }
}

#[test]
fn a_folder_with_a_calibration_serves_folders_as_it_serves_bags() {
    let plain = Recording::open(&data("euroc")).unwrap();
    let given = Recording::open_with(&data("euroc"), &files()).unwrap();
    assert_eq!(given.calibration(), plain.calibration());
    let empty = tempfile::tempdir().unwrap();
    let mut files = CalibrationFiles::default();
    files.cameras = Some(empty.path().to_path_buf());
    let error = Recording::open_with(&data("euroc"), &files).unwrap_err().to_string();
    assert!(error.contains(&empty.path().display().to_string()) && error.contains("missing"), "{error}");
}

#[test]
fn readings_that_are_not_finite_are_left_out_and_unknown_types_do_not_matter() {
    let folder = tempfile::tempdir().unwrap();
    let plain = Recording::open(&data("euroc")).unwrap();
    let readings: Vec<_> = plain.imu_samples().unwrap().map(Result::unwrap).collect();
    let path = folder.path().join("nan.mcap");
    let mut writer = BagWriter::create(&path, Format::Mcap).unwrap();
    let of = |name, hash, definition| MessageType { name, hash, definition };
    let imu = of(Imu::TYPE_NAME, Imu::TYPE_HASH, definition::<Imu>());
    let image = of(CompressedImage::TYPE_NAME, CompressedImage::TYPE_HASH, definition::<CompressedImage>());
    let strange = of("acme_msgs/msg/Secret", "", "acme_msgs/Riddle riddle\n".to_owned());
    let [imu, image, strange] = [("/imu0", imu), ("/cam0/image_raw/compressed", image), ("/secret", strange)]
        .map(|(name, of)| writer.topic(name, &of, OfferedQos::default()).unwrap());
    for (index, reading) in readings.iter().enumerate() {
        let mut reading = *reading;
        match index {
            7 => reading.gyroscope.y = f64::NAN,
            9 => reading.accelerometer.z = f64::INFINITY,
            _ => {}
        }
        let message = encode(&imu_message(&reading, "imu").unwrap()).unwrap();
        writer.write(imu, reading.stamp_ns, &message).unwrap();
        writer.write(strange, reading.stamp_ns, b"not even CDR").unwrap();
    }
    for frame in plain.frames().unwrap().map(Result::unwrap) {
        let message = image_message(&frame.images[&0], frame.stamp_ns, "cam0").unwrap().unwrap();
        let ImageMessage::Compressed(message) = message else { panic!("the images are files") };
        writer.write(image, frame.stamp_ns, &encode(&message).unwrap()).unwrap();
    }
    writer.finish().unwrap();
    let bag = Recording::open_with(&path, &files()).unwrap();
    let mut expected = readings;
    expected.remove(9);
    expected.remove(7);
    let found: Vec<_> = bag.imu_samples().unwrap().map(Result::unwrap).collect();
    assert_eq!(found, expected);
    assert_eq!(bag.contents().frames, plain.contents().frames);
}
