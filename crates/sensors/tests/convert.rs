//! A recording is the same in every format that it is converted to.

use geometry::Pose;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use sensors::convert::{ConvertError, Target, convert};
use sensors::{
    BaseKind, CalibrationFiles, CameraSensor, Frame, GnssReading, GnssSensor, ImageData, Recording,
    SensorEvent, SensorSource, Sequence, WheelBase, WheelReading, WheelSensor, writer,
};
use std::path::{Path, PathBuf};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../bags/tests/data").join(name)
}

fn calibrated(folder: &Path) -> CalibrationFiles {
    let mut files = CalibrationFiles::default();
    files.cameras = Some(folder.to_path_buf());
    files
}

fn assert_same(found: &Recording<'_>, expected: &Recording<'_>, name: &str) {
    assert_eq!(found.calibration().imu, expected.calibration().imu, "{name}");
    assert_eq!(found.calibration().cameras.len(), expected.calibration().cameras.len(), "{name}");
    for (found, expected) in found.calibration().cameras.iter().zip(&expected.calibration().cameras) {
        let timing = |sensor: &CameraSensor| [sensor.rate_hz, sensor.readout_s, sensor.time_shift_s];
        assert_eq!((&found.camera, timing(found)), (&expected.camera, timing(expected)), "{name}");
        assert!(found.imu_from_camera.local(&expected.imu_from_camera).norm() < 1e-12, "{name}");
    }
    let events = |recording: &Recording<'_>| {
        let mut source = recording.source().unwrap();
        std::iter::from_fn(|| source.next().unwrap()).collect::<Vec<_>>()
    };
    let (found, expected) = (events(found), events(expected));
    assert_eq!(found.len(), expected.len(), "{name}");
    let pixels = |frame: &Frame| -> Vec<_> {
        let read = |(camera, image): (&usize, &ImageData)| (*camera, image.read().unwrap().into_owned());
        frame.images.iter().map(read).collect()
    };
    for pair in found.iter().zip(&expected) {
        match pair {
            (SensorEvent::Frame(found), SensorEvent::Frame(expected)) => {
                assert_eq!(found.stamp_ns, expected.stamp_ns, "{name}");
                assert_eq!(pixels(found), pixels(expected), "{name}");
            }
            (found, expected) => assert_eq!(found, expected, "{name}"),
        }
    }
}

#[test]
fn readings_images_and_calibration_survive_every_way() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let none = CalibrationFiles::default();
    let expected = Recording::open(&data("euroc")).unwrap();
    let mut frames = 0;
    // From the folder to both kinds of bags,
    convert(&data("euroc"), &none, &at("a.mcap"), Target::Mcap, |done| frames = done).unwrap();
    assert_eq!(Some(frames), expected.contents().frames);
    assert_same(&Recording::open(&at("a.mcap")).unwrap(), &expected, "mcap");
    // The file is all that was written.
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    convert(&data("euroc"), &none, &at("a_rosbag2"), Target::Rosbag2, |_| {}).unwrap();
    assert_same(&Recording::open(&at("a_rosbag2")).unwrap(), &expected, "rosbag2");
    // from a bag of ROS 1 to one of ROS 2,
    let files = calibrated(&data("euroc"));
    convert(&data("excerpt.bag"), &files, &at("b_rosbag2"), Target::Rosbag2, |_| {}).unwrap();
    assert_same(&Recording::open(&at("b_rosbag2")).unwrap(), &expected, "rosbag1");
    // and back to a folder.
    for bag in ["a.mcap", "b_rosbag2"] {
        let out = at(&format!("{bag}_folder"));
        convert(&at(bag), &none, &out, Target::Euroc, |_| {}).unwrap();
        assert_same(&Recording::open(&out).unwrap(), &expected, bag);
    }
}

/// Of four cameras with rolling shutters, the second of which is a little late.
#[test]
fn cameras_of_a_rig_survive_with_their_times() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let rig = at("rig");
    testing::copy_folder(&data("euroc"), &rig);
    for (index, from, shift_s) in [(2, 0, 0.0), (3, 1, 0.001)] {
        let camera = |index: usize| rig.join(format!("mav0/cam{index}"));
        testing::copy_folder(&camera(from), &camera(index));
        let yaml = camera(index).join("sensor.yaml");
        let text = std::fs::read_to_string(&yaml).unwrap();
        std::fs::write(&yaml, format!("{text}\nline_delay: 2.5e-05\ntimeshift_cam_imu: {shift_s}\n"))
            .unwrap();
    }
    let expected = Recording::open(&rig).unwrap();
    let cameras = &expected.calibration().cameras;
    assert!(cameras.len() == 4 && cameras[3].readout_s > 0.0 && cameras[3].delay_s() > 0.0, "{cameras:?}");
    let none = CalibrationFiles::default();
    for (name, target) in [("a.mcap", Target::Mcap), ("a_rosbag2", Target::Rosbag2)] {
        convert(&rig, &none, &at(name), target, |_| {}).unwrap();
        assert_same(&Recording::open(&at(name)).unwrap(), &expected, name);
        let back = at(&format!("{name}_folder"));
        convert(&at(name), &none, &back, Target::Euroc, |_| {}).unwrap();
        assert_same(&Recording::open(&back).unwrap(), &expected, name);
    }
}

#[test]
fn wheels_and_gnss_survive_in_bags_of_both_kinds() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let none = CalibrationFiles::default();
    let (plain, whole) = (at("plain"), at("whole"));
    convert(&data("euroc"), &none, &plain, Target::Euroc, |_| {}).unwrap();
    let mut sequence = Sequence::open(&plain).unwrap();
    let stamps: Vec<i64> = sequence.imu_samples.iter().step_by(4).map(|sample| sample.stamp_ns).collect();
    let base = WheelBase::new(BaseKind::Differential, 0.1, 0.5);
    sequence.wheels = Some(WheelSensor {
        sigma_speed_rad_s: Some(0.03),
        ..WheelSensor::new(base, Pose::new(UnitQuaternion::identity(), Vector3::new(-0.1, 0.0, -0.2)))
    });
    sequence.gnss = Some(GnssSensor { antenna_in_imu: Vector3::new(0.1, 0.2, 0.5), ..GnssSensor::default() });
    for (index, &stamp_ns) in stamps.iter().enumerate() {
        let speed = 0.1 * index as f64;
        sequence.wheel_readings.push(WheelReading::new(stamp_ns, [speed, speed + 0.5]));
        let (position, covariance) = (Vector3::new(speed, 0.0, 1.0), Matrix3::identity() * 0.25);
        sequence.gnss_readings.push(GnssReading { stamp_ns, position, covariance });
    }
    writer::write(&sequence, &whole).unwrap();
    for camera in 0..2 {
        let images = |root: &Path| root.join(format!("mav0/cam{camera}/data"));
        std::fs::rename(images(&plain), images(&whole)).unwrap();
    }
    let expected = Recording::open(&whole).unwrap();
    assert_eq!(expected.calibration().wheels.map(|wheels| wheels.base), Some(base));
    for (name, target) in [("a.mcap", Target::Mcap), ("a_rosbag2", Target::Rosbag2)] {
        let converted = convert(&whole, &none, &at(name), target, |_| {}).unwrap();
        assert_eq!(converted.left_out, Vec::<&str>::new(), "{name}");
        let found = Recording::open(&at(name)).unwrap();
        assert_same(&found, &expected, name);
        let (found, expected) = (found.calibration(), expected.calibration());
        assert_eq!(found.gnss, expected.gnss, "{name}");
        assert_eq!(
            found.wheels.map(|wheels| wheels.base),
            expected.wheels.map(|wheels| wheels.base),
            "{name}"
        );
    }
    // Of wheels whose geometry nobody states nothing can be read from a bag: that is said.
    std::fs::remove_file(whole.join("mav0/wheels0/sensor.yaml")).unwrap();
    for (name, target) in [("b.mcap", Target::Mcap), ("b_rosbag2", Target::Rosbag2)] {
        assert_eq!(
            convert(&whole, &none, &at(name), target, |_| {}).unwrap().left_out,
            ["the wheels"],
            "{name}"
        );
    }
}

#[test]
fn bags_of_both_kinds_state_projections_and_mounting_for_other_programs() {
    let folder = tempfile::tempdir().unwrap();
    for (name, target) in [("a.mcap", Target::Mcap), ("a_rosbag2", Target::Rosbag2)] {
        let path = folder.path().join(name);
        convert(&data("euroc"), &CalibrationFiles::default(), &path, target, |_| {}).unwrap();
        let bag = bags::Bag::open(&path).unwrap();
        let topics: Vec<(&str, usize)> =
            bag.topics().iter().map(|topic| (topic.name.as_str(), topic.messages.len())).collect();
        let count = |of: &str| topics.iter().find(|(name, _)| *name == of).map(|(_, count)| *count);
        assert_eq!(count("/tf_static"), Some(1), "{name}: {topics:?}");
        for camera in 0..2 {
            let images = format!("/cam{camera}/image_raw/compressed");
            assert_eq!(count(&format!("/cam{camera}/camera_info")), count(&images), "{name}: {topics:?}");
        }
    }
}

#[test]
fn a_recording_without_an_imu_carries_its_cameras_too() {
    let folder = tempfile::tempdir().unwrap();
    let (without, bag) = (folder.path().join("without"), folder.path().join("without.mcap"));
    let none = CalibrationFiles::default();
    convert(&data("euroc"), &none, &without, Target::Euroc, |_| {}).unwrap();
    std::fs::remove_dir_all(without.join("mav0/imu0")).unwrap();
    convert(&without, &none, &bag, Target::Mcap, |_| {}).unwrap();
    assert_same(&Recording::open(&bag).unwrap(), &Recording::open(&without).unwrap(), "without an IMU");
}

#[test]
fn nothing_is_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("mine.mcap");
    std::fs::write(&out, "mine").unwrap();
    for target in [Target::Euroc, Target::Mcap, Target::Rosbag2] {
        let error = convert(&data("euroc"), &CalibrationFiles::default(), &out, target, |_| {}).unwrap_err();
        assert!(matches!(error, ConvertError::Exists { .. }), "{error}");
    }
    assert_eq!(std::fs::read_to_string(&out).unwrap(), "mine");
}
