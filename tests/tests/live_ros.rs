//! A recording that is played as topics of ROS 2 is what a robot with live sensors gets.

use onboard::StopSignal;
use onboard::ros_camera_info::wait_for_cameras;
use onboard::ros_sensors::{RosSensors, RosTopics};
use ros_messages::rosgraph_msgs::Clock;
use ros2::{Node, NodeOptions, Qos};
use sensors::live::{LiveSettings, LiveSource};
use sensors::{
    CameraSensor, Frame, Recording, SensorEvent, SensorSource, read_rig_calibration, states_intrinsics,
};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tests::server::Client;
use tools::in_process::free_endpoint;
use tools::playback::{self, SensorTopics as _, play, wait_for_robot};
use vision::GrayImage;

/// Nothing takes longer, whatever is wrong.
const GIVE_UP: Duration = Duration::from_mins(1);

/// Stamp and pixels of a frame.
fn pixels(frame: &Frame) -> (i64, Vec<GrayImage>) {
    let images = frame.images.values();
    (frame.stamp_ns, images.map(|image| image.read().unwrap().into_owned()).collect())
}

/// Readings and frames of a recording.
fn contents(recording: &Recording<'_>) -> (Vec<i64>, Vec<(i64, Vec<GrayImage>)>) {
    let readings = recording.imu_samples().unwrap().map(|reading| reading.unwrap().stamp_ns).collect();
    (readings, recording.frames().unwrap().map(|frame| pixels(&frame.unwrap())).collect())
}

fn data() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../crates/bags/tests/data/euroc")
}

fn cameras_of<'a>(recording: &'a Recording<'_>) -> &'a [CameraSensor] {
    &recording.calibration().cameras
}

/// Plays the recording to a robot that listens to images on topics that end so.
fn played(recording: &Recording<'_>, suffix: &str) -> (Vec<i64>, Vec<(i64, Vec<GrayImage>)>) {
    let endpoint = free_endpoint().unwrap();
    let (driver, robot) = (Client::open(&[&endpoint], &[]), Client::open(&[], &[&endpoint]));
    let calibration = recording.calibration().clone();
    let mut settings = LiveSettings::images(&calibration);
    // However busy the machine is.
    settings.max_waiting_frames = 1000;
    let (inputs, mut source) = LiveSource::new("test", calibration, &settings);
    let cameras = (0..2).map(|camera| format!("/cam{camera}/image_raw{suffix}")).collect();
    let topics =
        RosTopics { imu: "/imu0".to_owned(), accelerometer: None, cameras, wheels: None, gnss: None };
    let node = |name: &str| NodeOptions { name: name.to_owned(), ..NodeOptions::default() };
    let session = robot.session.clone();
    let sensors =
        robot.runtime.block_on(RosSensors::start(session, node("sensors"), &topics, &inputs)).unwrap();
    let clock = robot.runtime.block_on(async {
        let node = Node::new(robot.session.clone(), node("clock")).await.unwrap();
        (node.subscriber::<Clock>("/clock", Qos::sensor_data(), 10_000).await.unwrap(), node)
    });
    let stop = StopSignal::default();
    let (session, runtime) = (driver.session.clone(), driver.runtime.handle());
    let topics = playback::RosTopics::new(session, runtime, node("player"), cameras_of(recording)).unwrap();
    wait_for_robot(&topics, &stop).unwrap();
    let published = play(&topics, &mut recording.source().unwrap(), 1.0, 0, &stop).unwrap();
    let (mut readings, mut frames, begin) = (Vec::new(), Vec::new(), Instant::now());
    // A frame waits for a reading after it, and the last one's is not in the recording.
    while frames.len() + 1 < published.frames {
        assert!(begin.elapsed() < GIVE_UP, "{} frames of {published:?}", frames.len());
        match source.next().unwrap().expect("no end") {
            SensorEvent::Imu(reading) => readings.push(reading.stamp_ns),
            SensorEvent::Frame(frame) => frames.push(pixels(&frame)),
            _ => {}
        }
    }
    let told: Vec<i64> = robot.runtime.block_on(async {
        let mut told = Vec::new();
        while let Ok(received) = tokio::time::timeout(Duration::from_millis(500), clock.0.receive()).await {
            told.push(received.unwrap().message.unwrap().clock.to_nanoseconds());
        }
        told
    });
    let stamps: Vec<i64> =
        recording.imu_samples().unwrap().map(|reading| reading.unwrap().stamp_ns).collect();
    assert!(told.len() > 5 && told.is_sorted(), "{told:?}");
    assert!(told.iter().all(|stamp_ns| stamps.contains(stamp_ns)), "the time is that of the readings");
    drop((sensors, topics, clock));
    driver.close();
    robot.close();
    (readings, frames)
}

#[test]
fn readings_and_images_are_those_of_the_recording_raw_and_compressed() {
    let recording = Recording::open(&data()).unwrap();
    let (readings, frames) = contents(&recording);
    assert!(frames.len() > 5 && frames[0].1.len() == 2);
    for suffix in ["", "/compressed"] {
        let (found_readings, found) = played(&recording, suffix);
        assert!(frames.starts_with(&found), "{suffix}: other frames");
        assert!(readings.starts_with(&found_readings), "{suffix}: other readings");
    }
}

/// Extrinsics and noise; the projections come from the topics.
const MOUNTING: &str = "cam0:\n  T_cam_imu:\n  - [0.0, 1.0, 0.0, 0.1]\n  - [-1.0, 0.0, 0.0, 0.2]\n  - [0.0, 0.0, 1.0, 0.3]\n  \
    - [0.0, 0.0, 0.0, 1.0]\ncam1:\n  T_cn_cnm1:\n  - [1.0, 0.0, 0.0, -0.1]\n  - [0.0, 1.0, 0.0, 0.0]\n  \
    - [0.0, 0.0, 1.0, 0.0]\n  - [0.0, 0.0, 0.0, 1.0]\nimu0:\n  update_rate: 200.0\n  gyroscope_noise_density: 1.0e-4\n  \
    gyroscope_random_walk: 1.0e-5\n  accelerometer_noise_density: 1.0e-3\n  accelerometer_random_walk: 1.0e-4\n";

#[test]
fn projections_are_those_of_camera_info_where_the_calibration_has_none() {
    let recording = Recording::open(&data()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mounting.yaml");
    std::fs::write(&path, MOUNTING).unwrap();
    assert!(!states_intrinsics(&path).unwrap() && states_intrinsics(&data()).unwrap());
    let error = read_rig_calibration(&path, None, &[], &[]).unwrap_err().to_string();
    assert!(error.contains("CameraInfo"), "{error}");

    let endpoint = free_endpoint().unwrap();
    let (driver, robot) = (Client::open(&[&endpoint], &[]), Client::open(&[], &[&endpoint]));
    let topics = playback::RosTopics::new(
        driver.session.clone(),
        driver.runtime.handle(),
        NodeOptions { name: "player".to_owned(), ..NodeOptions::default() },
        cameras_of(&recording),
    )
    .unwrap();
    let (stop, images) = (StopSignal::default(), ["/cam0/image_raw", "/cam1/image_raw/compressed"]);
    let images = images.map(str::to_owned);
    let cameras = std::thread::scope(|scope| {
        let waiting = scope.spawn(|| {
            let session = robot.session.clone();
            robot.runtime.block_on(wait_for_cameras(session, NodeOptions::default(), &images, &stop))
        });
        let begin = Instant::now();
        while !waiting.is_finished() && begin.elapsed() < GIVE_UP {
            topics.prepare().unwrap();
            std::thread::sleep(Duration::from_millis(20));
        }
        stop.stop();
        waiting.join().unwrap().unwrap()
    });
    let found = read_rig_calibration(&path, None, &cameras, &[]).unwrap().sensors;
    for (found, expected) in found.cameras.iter().zip(cameras_of(&recording)) {
        assert_eq!(found.camera, expected.camera);
    }
    assert_eq!((found.cameras.len(), found.imu.unwrap().rate_hz), (2, 200.0));
    drop(topics);
    driver.close();
    robot.close();
}
