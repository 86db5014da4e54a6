//! Topics become events of a live source.

use super::*;
use geometry::Geodetic;
use ros_messages::builtin_interfaces::Time;
use ros_messages::std_msgs::Header;
use sensors::live::{FaultKind, LiveSource};
use sensors::{BaseKind, SensorCalibration, SensorEvent, SensorSource, WheelReadings};
use simulation::{SimulationOptions, simulate};
use std::time::{Duration, Instant};

const TIMEOUT: Duration = Duration::from_secs(20);

fn header(milliseconds: i64) -> Header {
    let stamp = Time::from_nanoseconds(1_000_000_000_000 + milliseconds * 1_000_000).unwrap();
    Header { stamp, frame_id: "sensor".into() }
}

fn imu(milliseconds: i64) -> Imu {
    let linear_acceleration = [0.0, 0.0, 9.81].into();
    Imu { header: header(milliseconds), linear_acceleration, ..Imu::default() }
}

fn image(milliseconds: i64, (width, height): (u32, u32), encoding: &str) -> Image {
    let data = vec![milliseconds as u8; (width * height) as usize];
    let encoding = encoding.to_owned();
    Image { header: header(milliseconds), width, height, encoding, step: width, data, ..Image::default() }
}

/// The topics in a session of their own, and a node that publishes there.
async fn subscribed(topics: &RosTopics, inputs: &LiveInputs) -> (Node, RosSensors) {
    let mut config = zenoh::Config::default();
    config.insert_json5("scouting/multicast/enabled", "false").unwrap();
    config.insert_json5("listen/endpoints", "[]").unwrap();
    let session = zenoh::open(config).await.unwrap();
    let options = NodeOptions { name: "sensors".to_owned(), ..NodeOptions::default() };
    let sensors = RosSensors::start(session.clone(), options, topics, inputs).await.unwrap();
    (Node::new(session, NodeOptions::default()).await.unwrap(), sensors)
}

#[test]
fn gyroscope_and_accelerometer_of_two_topics_are_united() {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let options = SimulationOptions { duration_s: Some(1.0), ..SimulationOptions::default() };
    let calibration = simulate(&options).unwrap().live.calibration().clone();
    let (inputs, mut source) =
        LiveSource::new("test", calibration.clone(), &LiveSettings::images(&calibration));
    let topics = RosTopics {
        imu: "/gyro".into(),
        accelerometer: Some("/accel".into()),
        cameras: vec!["/cam0/image_raw".into()],
        wheels: None,
        gnss: None,
    };
    let (node, sensors) = runtime.block_on(async {
        let (node, sensors) = subscribed(&topics, &inputs).await;
        let gyroscope = node.publisher::<Imu>("/gyro", Qos::sensor_data()).await.unwrap();
        let accelerometer = node.publisher::<Imu>("/accel", Qos::sensor_data()).await.unwrap();
        for milliseconds in (0..200).step_by(5) {
            let angular_velocity = [milliseconds as f64, 0.0, 0.0].into();
            let header = header(milliseconds);
            gyroscope.publish(&Imu { header, angular_velocity, ..Imu::default() }).await.unwrap();
            if milliseconds % 10 == 0 {
                accelerometer.publish(&imu(milliseconds)).await.unwrap();
            }
        }
        (node, sensors)
    });
    let begin = Instant::now();
    let mut readings = Vec::new();
    // The last one is behind the last specific force.
    while readings.len() < 39 {
        assert!(begin.elapsed() < TIMEOUT, "{} readings, {:?}", readings.len(), source.live());
        if let SensorEvent::Imu(reading) = source.next().unwrap().expect("no end") {
            readings.push(reading);
        }
    }
    for (number, reading) in readings.iter().enumerate() {
        assert_eq!((reading.gyroscope.x, reading.accelerometer.z), (5.0 * number as f64, 9.81));
    }
    drop((sensors, node));
}

#[test]
fn topics_become_the_events_of_a_live_source_and_what_is_wrong_is_named() {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let options = SimulationOptions { duration_s: Some(1.0), ..SimulationOptions::default() };
    let mut calibration = simulate(&options).unwrap().live.calibration().clone();
    calibration.cameras.truncate(1);
    let size = (calibration.cameras[0].camera.width, calibration.cameras[0].camera.height);
    let (inputs, mut source) =
        LiveSource::new("test", calibration.clone(), &LiveSettings::images(&calibration));
    let topics = RosTopics {
        imu: "/imu".into(),
        accelerometer: None,
        cameras: vec!["/cam0/image_raw".into()],
        wheels: None,
        gnss: None,
    };
    let (node, sensors, images) = runtime.block_on(async {
        let (node, sensors) = subscribed(&topics, &inputs).await;
        let readings = node.publisher::<Imu>("/imu", Qos::reliable()).await.unwrap();
        let images = node.publisher::<Image>("/cam0/image_raw", Qos::sensor_data()).await.unwrap();
        images.publish(&image(1, size, "h264")).await.unwrap();
        for milliseconds in (0..200).step_by(5) {
            readings.publish(&imu(milliseconds)).await.unwrap();
        }
        images.publish(&image(50, size, "mono8")).await.unwrap();
        (node, sensors, images)
    });
    let begin = Instant::now();
    let (mut stamps, mut frame) = (Vec::new(), None);
    while stamps.len() < 40 || frame.is_none() {
        assert!(begin.elapsed() < TIMEOUT, "{} readings, {frame:?}, {:?}", stamps.len(), source.live());
        match source.next().unwrap().expect("no end") {
            SensorEvent::Imu(reading) => stamps.push(reading.stamp_ns),
            SensorEvent::Frame(new) => frame = Some(new),
            _ => {}
        }
    }
    assert!(stamps.is_sorted() && stamps[0] == header(0).stamp.to_nanoseconds());
    assert_eq!(frame.unwrap().stamp_ns, header(50).stamp.to_nanoseconds());
    // The token of a publisher may be seen later than its messages.
    while source.live().unwrap().best_effort.is_empty() && begin.elapsed() < TIMEOUT {
        runtime.block_on(images.publish(&image(100, size, "h264"))).unwrap();
        std::thread::sleep(Duration::from_millis(20));
    }
    let report = source.live().unwrap();
    assert_eq!(report.best_effort, [Stream::Camera(0)], "the readings are reliable");
    let faults = report.faults;
    let unreadable =
        faults.iter().find(|fault| fault.kind == FaultKind::Unreadable).expect("the encoding is named");
    assert!(unreadable.to_string().contains("h264"), "{unreadable}");
    drop((sensors, node));
}

#[test]
fn wheels_come_from_the_velocity_of_the_base_or_from_joints() {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let options = SimulationOptions { duration_s: Some(1.0), ..SimulationOptions::default() };
    let calibration = simulate(&options).unwrap().live.calibration().clone();
    let joints = RosWheels::Joints("/wheels".into(), RosJoints::default());
    for (wheels, kind) in [
        (RosWheels::Base("/wheels".into(), BaseKind::Differential), WheelReadings::BaseVelocities),
        (joints, WheelReadings::Speeds),
    ] {
        let topics = RosTopics {
            imu: "/imu".into(),
            accelerometer: None,
            cameras: vec!["/cam0/image_raw".into()],
            wheels: Some(wheels),
            gnss: None,
        };
        let mut settings = LiveSettings::images(&calibration);
        topics.adapt(&mut settings).unwrap();
        let (inputs, mut source) = LiveSource::new("test", calibration.clone(), &settings);
        assert_eq!(source.contents().wheels, Some(kind));
        let kept = runtime.block_on(async {
            let (node, sensors) = subscribed(&topics, &inputs).await;
            let bases = node.publisher::<Odometry>("/wheels", Qos::reliable()).await.unwrap();
            let states = node.publisher::<JointState>("/wheels", Qos::reliable()).await.unwrap();
            for milliseconds in (0..200).step_by(10) {
                let mut base = Odometry { header: header(milliseconds), ..Odometry::default() };
                (base.twist.twist.linear.x, base.twist.twist.angular.z) = (1.0, 0.5);
                bases.publish(&base).await.unwrap();
                let name = vec!["left_wheel".to_owned(), "right_wheel".to_owned()];
                let (header, velocity) = (header(milliseconds), vec![0.75, 1.25]);
                states.publish(&JointState { header, name, velocity, ..Default::default() }).await.unwrap();
                let other = JointState { name: vec!["arm".to_owned()], ..JointState::default() };
                states.publish(&other).await.unwrap();
            }
            (node, sensors, bases, states)
        });
        let begin = Instant::now();
        let mut readings = Vec::new();
        while readings.len() < 20 {
            assert!(begin.elapsed() < TIMEOUT, "{kind:?}: {} readings", readings.len());
            if let SensorEvent::Wheels(reading) = source.next().unwrap().expect("no end") {
                readings.push(reading);
            }
        }
        for (number, reading) in readings.iter().enumerate() {
            assert_eq!(reading.stamp_ns, header(10 * number as i64).stamp.to_nanoseconds());
            assert_eq!(reading.values[..2], [0.75, 1.25]);
        }
        drop(kept);
    }
}

#[test]
fn positions_of_gnss_are_turned_to_the_frame_of_the_origin() {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let calibration = SensorCalibration::default();
    let origin = Geodetic { latitude_deg: 48.0, longitude_deg: 11.0, altitude_m: 500.0 };
    let gnss = RosGnss {
        topic: "/fix".into(),
        sensor: GnssSensor { origin: Some(origin), ..GnssSensor::default() },
    };
    let topics = RosTopics {
        imu: "/imu".into(),
        accelerometer: None,
        cameras: Vec::new(),
        wheels: None,
        gnss: Some(gnss),
    };
    let mut settings = LiveSettings::images(&calibration);
    topics.adapt(&mut settings).unwrap();
    let (inputs, mut source) = LiveSource::new("test", calibration, &settings);
    assert!(source.contents().gnss);
    let kept = runtime.block_on(async {
        let (node, sensors) = subscribed(&topics, &inputs).await;
        let fixes = node.publisher::<NavSatFix>("/fix", Qos::reliable()).await.unwrap();
        for second in 0..3 {
            let mut fix = NavSatFix { header: header(1000 * second), ..NavSatFix::default() };
            (fix.latitude, fix.longitude, fix.altitude) = (48.0, 11.0, 500.0 + second as f64);
            fix.status.status = if second == 1 { -1 } else { 0 };
            (fix.position_covariance, fix.position_covariance_type) =
                ([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 4.0], 2);
            fixes.publish(&fix).await.unwrap();
        }
        (node, sensors, fixes)
    });
    let begin = Instant::now();
    let mut heights = Vec::new();
    while heights.len() < 2 {
        assert!(begin.elapsed() < TIMEOUT, "{heights:?}");
        if let SensorEvent::Gnss(reading) = source.next().unwrap().expect("no end") {
            assert!((reading.covariance[(2, 2)] - 4.0).abs() < 1e-12);
            heights.push(reading.position.z.round() as i64);
        }
    }
    assert_eq!(heights, [0, 2], "the second message has no position");
    let unreadable =
        source.live().unwrap().faults.into_iter().any(|fault| fault.kind == FaultKind::Unreadable);
    assert!(!unreadable, "a receiver without a position is no fault");
    drop(kept);
}
