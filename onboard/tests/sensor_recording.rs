//! Recorded sensors: what came is what is in the file, and the file needs nothing else to be played again.

use bags::{Bag, Format, Topic};
use geometry::{Pose, Rotation};
use nalgebra::{Matrix3, Vector3};
use onboard::arguments::Mode;
use onboard::{Outcome, RobotArguments, StopSignal, run_robot, run_source_until};
use ros_messages::sensor_msgs::{CameraInfo, CompressedImage, Image, Imu};
use ros_messages::std_msgs::Header;
use ros_messages::tf2_msgs::TFMessage;
use ros_messages::{RosMessage, decode, encode};
use sensors::live::{LiveImage, LiveInputs, LiveSettings, LiveSource, RawPixels, Stream};
use sensors::ros::{imu_message, pixels_message};
use sensors::ros_bag::{RosBagWriter, message_type};
use sensors::{
    BaseKind, CalibrationFiles, GnssReading, GnssSensor, ImageData, ImuSample, Recording, SensorCalibration,
    WheelBase, WheelReading, WheelSensor, writer,
};
use simulation::images::{ImageOptions, render_all, simulate_images};
use simulation::{SimulationOptions, simulate};
use std::path::{Path, PathBuf};
use std::time::Duration;
use vision::GrayImage;

const MS: i64 = 1_000_000;
const START_NS: i64 = 1_700_000_000_000_000_000;

fn excerpt() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/bags/tests/data/euroc")
}

fn arguments(folder: &Path) -> RobotArguments {
    let mut arguments = RobotArguments::with_defaults(&folder.join("out")).unwrap();
    arguments.mode = Some(Mode::Odometry);
    arguments.record = Some(folder.join("run.mcap"));
    arguments.record_sensors = true;
    arguments
}

fn run<'a>(recording: impl Into<Recording<'a>>, folder: &Path) -> Outcome {
    run_robot(recording, &arguments(folder), None, |_| {}).unwrap()
}

fn recorded(folder: &Path) -> Bag {
    let bag = Bag::open(&folder.join("run.mcap")).unwrap();
    assert!(bag.damage().is_empty(), "{:?}", bag.damage());
    bag
}

fn topic<'a>(bag: &'a Bag, name: &str) -> &'a Topic {
    bag.topics().iter().find(|topic| topic.name == name).unwrap_or_else(|| panic!("{name} is not recorded"))
}

fn messages<M: RosMessage>(bag: &Bag, name: &str) -> Vec<M> {
    let stored = topic(bag, name).messages.iter();
    stored.map(|message| decode(&bag.read(message.place).unwrap()).unwrap()).collect()
}

/// The rig of the simulation: two cameras of 752 x 480 pixels.
fn calibration() -> SensorCalibration {
    let options = SimulationOptions { duration_s: Some(1.0), ..SimulationOptions::default() };
    simulate(&options).unwrap().live.calibration()
}

/// Noise, which no compression makes smaller.
fn noise(seed: u64, bytes: usize) -> Vec<u8> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state as u8
    };
    std::iter::repeat_with(next).take(bytes).collect()
}

fn gray(seed: u64) -> GrayImage {
    GrayImage::new(752, 480, noise(seed, 752 * 480)).unwrap()
}

fn jpeg(seed: u64) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("image.jpg");
    gray(seed).write(&path).unwrap();
    std::fs::read(path).unwrap()
}

/// Colours with some bytes between the rows.
fn colour(seed: u64) -> RawPixels {
    let (width, height, step) = (752, 480, 752 * 3 + 8);
    let bytes = noise(seed, (height * step) as usize);
    RawPixels { width, height, step, encoding: "bgr8".to_owned(), big_endian: false, bytes }
}

fn reading(index: i64) -> ImuSample {
    let phase = index as f64 * 0.01;
    ImuSample {
        stamp_ns: START_NS + index * 5 * MS,
        gyroscope: [0.1 * phase.sin(), 0.2, 0.1 * phase.cos()].into(),
        accelerometer: [0.5 * phase.sin(), 0.5 * phase.cos(), 9.7].into(),
    }
}

/// Readings before the first image.
const READINGS_BEFORE: i64 = 2000;

/// Eight frames of a JPEG and of colours, as drivers hand them in, after half a second without any, and ten seconds of
/// readings.
fn drive(inputs: &LiveInputs) {
    std::thread::sleep(Duration::from_millis(500));
    (-READINGS_BEFORE..0).for_each(|index| inputs.imu(reading(index)));
    for index in 0..80 {
        inputs.imu(reading(index));
        if index % 10 == 0 {
            let (stamp_ns, seed) = (START_NS + index * 5 * MS, index as u64);
            inputs.image(0, stamp_ns, LiveImage::Encoded(jpeg(seed)));
            inputs.image(1, stamp_ns, LiveImage::Raw(colour(seed)));
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    inputs.close();
}

fn run_live(folder: &Path) -> Bag {
    let calibration = calibration();
    let mut settings = LiveSettings::images(&calibration);
    settings.max_waiting_frames = 100;
    let (inputs, mut source) = LiveSource::new("test", calibration, &settings);
    inputs.best_effort(Stream::Camera(0));
    std::thread::scope(|scope| {
        scope.spawn(|| drive(&inputs));
        run_source_until(&StopSignal::default(), &mut source, &arguments(folder), None, |_| {}).unwrap();
    });
    recorded(folder)
}

#[test]
fn live_images_are_recorded_as_they_came_and_everything_at_the_time_of_the_sensors() {
    let folder = tempfile::tempdir().unwrap();
    let bag = run_live(folder.path());
    let jpegs = messages::<CompressedImage>(&bag, "/cam0/image_raw/compressed");
    let colours = messages::<Image>(&bag, "/cam1/image_raw");
    assert!(jpegs.len() >= 7, "{}", jpegs.len());
    assert_eq!(jpegs.len(), colours.len());
    for (compressed, raw) in jpegs.iter().zip(&colours) {
        let seed = (compressed.header.stamp.to_nanoseconds() - START_NS) / (5 * MS);
        assert_eq!((compressed.format.as_str(), &compressed.data), ("jpeg", &jpeg(seed as u64)));
        let RawPixels { width, height, step, encoding, bytes, .. } = colour(seed as u64);
        assert_eq!((raw.width, raw.height, raw.step), (width, height, step));
        assert_eq!((&raw.encoding, &raw.data, raw.is_bigendian), (&encoding, &bytes, 0));
    }
    let stamp_ns = |imu: &Imu| imu.header.stamp.to_nanoseconds();
    let readings: Vec<_> = messages::<Imu>(&bag, "/imu").iter().map(stamp_ns).collect();
    assert!(readings.len() as i64 > READINGS_BEFORE, "{} readings", readings.len());
    assert!(readings.windows(2).all(|pair| pair[1] - pair[0] == 5 * MS), "readings are missing");
    let names: Vec<_> = bag.topics().iter().map(|topic| topic.name.as_str()).collect();
    assert!(names.contains(&"/diagnostics"), "{names:?}");
    for topic in bag.topics() {
        for message in &topic.messages {
            let after_ns = message.log_ns - START_NS;
            assert!((-60_000 * MS..60_000 * MS).contains(&after_ns), "{}: {}", topic.name, message.log_ns);
        }
    }
    let first_ns = topic(&bag, "/diagnostics").messages[0].log_ns;
    assert!(first_ns < START_NS, "the status was recorded while no image came");
}

#[test]
fn players_are_told_to_latch_the_mounting_and_to_offer_sensors_as_they_came() {
    let folder = tempfile::tempdir().unwrap();
    run_live(folder.path());
    let bytes = std::fs::read(folder.path().join("run.mcap")).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    for (name, expected) in [
        ("/tf_static", "depth: 1\n  reliability: reliable\n  durability: transient_local\n"),
        ("/imu", "depth: 10\n  reliability: reliable\n  durability: volatile\n"),
        ("/cam0/image_raw/compressed", "depth: 5\n  reliability: best_effort\n  durability: volatile\n"),
        ("/cam0/camera_info", "depth: 5\n  reliability: best_effort\n  durability: volatile\n"),
        ("/cam1/image_raw", "depth: 10\n  reliability: reliable\n  durability: volatile\n"),
        ("/diagnostics", "depth: 10\n  reliability: reliable\n  durability: volatile\n"),
    ] {
        let channel = summary.channels.values().find(|channel| channel.topic == name).expect(name);
        let profiles = &channel.metadata["offered_qos_profiles"];
        assert!(profiles.contains(expected), "{name}: {profiles}");
    }
}

#[test]
fn the_calibration_is_in_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let given = Recording::open(&excerpt()).unwrap();
    let mut arguments = arguments(folder.path());
    arguments.body.sensor_frames = "imu_link,left".parse().unwrap();
    run_robot(Recording::open(&excerpt()).unwrap(), &arguments, None, |_| {}).unwrap();
    let bag = recorded(folder.path());
    // Nothing is beside it.
    let again = Recording::open(&folder.path().join("run.mcap")).unwrap();
    let (found, expected) = (again.calibration(), given.calibration());
    assert_eq!(found.imu, expected.imu);
    assert_eq!(found.cameras.len(), 2);
    for (found, expected) in found.cameras.iter().zip(&expected.cameras) {
        assert_eq!((&found.camera, found.imu_from_camera), (&expected.camera, expected.imu_from_camera));
    }
    // Everybody else finds the same frames in every message.
    let transforms = messages::<TFMessage>(&bag, "/tf_static").remove(0).transforms;
    let pairs: Vec<_> = transforms.iter().map(|of| (&*of.header.frame_id, &*of.child_frame_id)).collect();
    assert_eq!(pairs, [("base_link", "imu_link"), ("imu_link", "left"), ("imu_link", "cam1")]);
    assert!(messages::<Imu>(&bag, "/imu").iter().all(|imu| imu.header.frame_id == "imu_link"));
    for (camera, frame) in [(0, "left"), (1, "cam1")] {
        let images = messages::<CompressedImage>(&bag, &format!("/cam{camera}/image_raw/compressed"));
        let infos = messages::<CameraInfo>(&bag, &format!("/cam{camera}/camera_info"));
        let headers = |headers: &mut dyn Iterator<Item = Header>| headers.collect::<Vec<_>>();
        let of_images = headers(&mut images.iter().map(|image| image.header.clone()));
        assert_eq!(of_images, headers(&mut infos.iter().map(|info| info.header.clone())));
        assert!(!of_images.is_empty() && of_images.iter().all(|header| header.frame_id == frame));
    }
}

#[test]
fn a_run_of_the_recording_is_the_run_that_was_recorded() {
    let options =
        SimulationOptions { duration_s: Some(4.0), frame_rate_hz: 10.0, ..ImageOptions::simulation() };
    let mut flight = simulate_images(&options, &ImageOptions::default()).unwrap().live;
    render_all(&mut flight, |_, _| {}).unwrap();
    let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let expected = run(&flight, first.path()).states().unwrap();
    let recording = Recording::open(&first.path().join("run.mcap")).unwrap();
    let found = run(recording, second.path()).states().unwrap();
    assert!(expected.len() > 10, "{} states", expected.len());
    assert_eq!(found, expected);
}

/// Writes a recording of eight frames, and its calibration beside it.
fn write_bag<M: RosMessage>(folder: &Path, images: &str, image: impl Fn(Header, u64) -> M) -> PathBuf {
    let path = folder.join("drive.mcap");
    let mut bag = RosBagWriter::create(&path, Format::Mcap).unwrap();
    for index in 0..80 {
        let reading = reading(index);
        let message = encode(&imu_message(&reading, "imu").unwrap()).unwrap();
        bag.write("/imu", message_type::<Imu>, reading.stamp_ns, &message).unwrap();
        if index % 10 == 0 {
            let header = Header::new(reading.stamp_ns, "camera").unwrap();
            let message = encode(&image(header, index as u64)).unwrap();
            bag.write(images, message_type::<M>, reading.stamp_ns, &message).unwrap();
        }
    }
    bag.finish().unwrap();
    let mut calibration = calibration();
    calibration.cameras.truncate(1);
    writer::write_calibration(&calibration, folder).unwrap();
    path
}

/// Records the sensors of a bag; the sizes of both, and the recording.
fn record(bag: &Path, folder: &Path) -> (f64, Bag) {
    run(Recording::open_with(bag, &CalibrationFiles::default()).unwrap(), folder);
    let size = |path: &Path| std::fs::metadata(path).unwrap().len() as f64;
    (size(&folder.join("run.mcap")) / size(bag), recorded(folder))
}

#[test]
fn images_of_a_bag_stay_what_they_are_and_the_recording_is_no_larger() {
    let folder = tempfile::tempdir().unwrap();
    let (jpegs, pixels) = (folder.path().join("jpegs"), folder.path().join("pixels"));
    for folder in [&jpegs, &pixels] {
        std::fs::create_dir_all(folder.join("run")).unwrap();
    }
    let bag = write_bag(&jpegs, "/left/image_raw/compressed", |header, seed| {
        let format = "mono8; jpeg compressed ".to_owned();
        CompressedImage { header, format, data: jpeg(seed) }
    });
    let (ratio, recording) = record(&bag, &jpegs.join("run"));
    let found = messages::<CompressedImage>(&recording, "/cam0/image_raw/compressed");
    let expected = messages::<CompressedImage>(&Bag::open(&bag).unwrap(), "/left/image_raw/compressed");
    assert_eq!(found.len(), 8);
    assert!(found.iter().zip(&expected).all(|(found, expected)| found.data == expected.data));
    assert!(ratio < 1.1, "{ratio} times the size of its input");

    let bag = write_bag(&pixels, "/left/image_raw", |header, seed| pixels_message(&gray(seed), header));
    let (ratio, recording) = record(&bag, &pixels.join("run"));
    let found = messages::<Image>(&recording, "/cam0/image_raw");
    assert_eq!(found.len(), 8);
    assert!(found.iter().enumerate().all(|(at, image)| image.data == gray(10 * at as u64).pixels()));
    assert!(ratio < 1.1, "{ratio} times the size of its input");
}

#[test]
fn wheels_and_gnss_are_recorded_with_what_is_needed_to_use_them() {
    let options = SimulationOptions { duration_s: Some(2.0), ..SimulationOptions::default() };
    let mut sequence = simulate(&options).unwrap().live;
    let start_ns = sequence.imu_samples[0].stamp_ns;
    let mecanum = WheelBase::new(BaseKind::Mecanum, 0.1, 0.4);
    let mounted = Pose::new(Rotation::identity(), Vector3::new(-0.1, 0.0, -0.2));
    sequence.wheels = Some(WheelSensor::new(mecanum, mounted));
    sequence.wheel_readings = (0..100)
        .map(|k| WheelReading::new(start_ns + k * 20 * MS, [1.0, 1.5, 2.0, 0.1 * k as f64]))
        .collect();
    let antenna_in_imu = Vector3::new(0.1, 0.2, 0.3);
    sequence.gnss = Some(GnssSensor { antenna_in_imu, ..GnssSensor::default() });
    sequence.gnss_readings = (0..20)
        .map(|k| GnssReading {
            stamp_ns: start_ns + k * 100 * MS,
            position: Vector3::new(k as f64, 0.0, 1.0),
            covariance: Matrix3::new(1.0, 0.1, 0.0, 0.1, 2.0, 0.0, 0.0, 0.0, 4.0),
        })
        .collect();
    let image = GrayImage::from_fn(752, 480, |x, _| x as u8);
    for frame in &mut sequence.frames {
        frame.images = [0, 1].map(|camera| (camera, ImageData::from(image.clone()))).into();
    }
    let folder = tempfile::tempdir().unwrap();
    run(&sequence, folder.path());
    let again = Recording::open(&folder.path().join("run.mcap")).unwrap();
    let wheels = again.calibration().wheels.unwrap();
    assert_eq!((wheels.base, wheels.imu_from_base.translation), (mecanum, mounted.translation));
    assert_eq!(again.calibration().gnss.unwrap().antenna_in_imu, antenna_in_imu);
    // Those after the last image are not used any more.
    let readings: Vec<WheelReading> = again.wheel_readings().unwrap().map(Result::unwrap).collect();
    let positions: Vec<GnssReading> = again.gnss_readings().unwrap().map(Result::unwrap).collect();
    assert!(readings.len() > 80 && positions.len() > 16, "{} {}", readings.len(), positions.len());
    assert_eq!(readings, sequence.wheel_readings[..readings.len()]);
    assert_eq!(positions, sequence.gnss_readings[..positions.len()]);
}
