//! The driver in Python that the documentation points to feeds a robot.
//!
//! Needs Python with eclipse-zenoh: `PYTHON=venv/bin/python cargo test -p driftless-tests python_driver -- --ignored`.

use geometry::camera::{Camera, Distortion};
use geometry::pose::Pose;
use onboard::native::{NativeSensors, NativeStreams};
use sensors::live::{LiveSettings, LiveSource, Stream};
use sensors::{CameraSensor, ImuNoise, ImuSensor, SensorCalibration, SensorEvent, SensorSource};
use std::process::Command;
use tests::server::Client;
use tools::in_process::free_endpoint;

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/python/feed_camera.py");
const SIZE: (u32, u32) = (64, 48);

fn calibration() -> SensorCalibration {
    let camera = Camera {
        width: SIZE.0,
        height: SIZE.1,
        focal: [50.0; 2],
        centre: [32.0, 24.0],
        distortion: Distortion::None,
    };
    let imu =
        ImuSensor { noise: ImuNoise::default(), rate_hz: 200.0, gravity_magnitude: None, intrinsics: None };
    SensorCalibration {
        imu: Some(imu),
        cameras: vec![CameraSensor::new(camera, Pose::identity(), 20.0)],
        wheels: None,
        gnss: None,
    }
}

#[test]
#[ignore = "needs Python with eclipse-zenoh"]
fn the_documented_driver_feeds_a_robot() {
    let python = std::env::var("PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has_zenoh = Command::new(&python).args(["-c", "import zenoh; zenoh.Config"]).output();
    if !has_zenoh.is_ok_and(|output| output.status.success()) {
        println!("SKIPPED: {python} has no eclipse-zenoh: pip install eclipse-zenoh, and set PYTHON");
        return;
    }
    let endpoint = free_endpoint().unwrap();
    let robot = Client::open(&[&endpoint], &[]);
    let settings = LiveSettings::images(&calibration());
    let (inputs, mut source) = LiveSource::new("python", calibration(), &settings);
    let streams = vec![Stream::Imu, Stream::Camera(0)];
    let subscribed = NativeSensors::subscribe(
        &robot.session,
        robot.runtime.handle(),
        "cart7",
        &NativeStreams::new(streams),
        &inputs,
    )
    .unwrap();
    let mut script = Command::new(&python)
        .args([SCRIPT, "--robot", "cart7", "--connect", &endpoint, "--seconds", "3", "--size", "64x48"])
        .spawn()
        .unwrap();
    let (mut readings, mut frames) = (0, 0);
    let ended = std::thread::scope(|scope| {
        let ended = scope.spawn(|| {
            let status = script.wait().unwrap();
            inputs.close();
            status
        });
        while let Some(event) = source.next().unwrap() {
            match event {
                SensorEvent::Imu(_) => readings += 1,
                SensorEvent::Frame(frame) => frames += usize::from(frame.images.contains_key(&0)),
                _ => {}
            }
        }
        ended.join().unwrap()
    });
    drop(subscribed);
    robot.close();
    assert!(ended.success());
    println!("{readings} readings, {frames} images");
    assert!(readings > 50 && frames > 5, "{readings} readings, {frames} images");
}
