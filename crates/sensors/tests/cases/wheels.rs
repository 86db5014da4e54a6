//! Wheels in bags.

use super::making::{Body, MS, Made, Message, START_NS, messages};
use geometry::{Pose, Rotation};
use nalgebra::Vector3;
use ros_messages::nav_msgs::Odometry;
use ros_messages::sensor_msgs::JointState;
use ros_messages::std_msgs::Header;
use ros_messages::tf2_msgs::TFMessage;
use sensors::ros::transform_message;
use sensors::{
    BaseKind, CalibrationFiles, Recording, SensorEvent, SensorSource, SequenceError, WheelReadings,
};

const CAMERA: [&str; 1] = ["/cam0/image_raw"];

/// Messages of `topic` at 50 Hz beside those of the other sensors.
fn with_wheels(topic: &str, body: impl Fn(Header, f64) -> Body) -> Vec<Message> {
    let mut all = messages(1);
    all.extend((0..100).map(|index| {
        let stamp_ns = START_NS + index * 20 * MS;
        let body = body(Header::new(stamp_ns, "odom").unwrap(), 0.1 * index as f64);
        Message { topic: topic.to_owned(), log_ns: stamp_ns + MS, body }
    }));
    all
}

fn joints(names: &'static [&'static str]) -> impl Fn(Header, f64) -> Body {
    move |header, speed| {
        let name = names.iter().map(|&name| name.to_owned()).collect();
        let velocity = (0..names.len()).map(|joint| speed + joint as f64).collect();
        Body::Joints(JointState { header, name, velocity, ..JointState::default() })
    }
}

/// Drives ahead, turns to the left, and moves sideways.
fn odometry(sideways: f64) -> impl Fn(Header, f64) -> Body {
    move |header, ahead| {
        let mut odometry = Odometry { header, child_frame_id: "base_link".into(), ..Odometry::default() };
        odometry.twist.twist.linear = [ahead, sideways, 0.0].into();
        odometry.twist.twist.angular.z = 0.4;
        Body::Odometry(Box::new(odometry))
    }
}

fn files(topic: &str, joints: Option<[&str; 2]>) -> CalibrationFiles {
    let mut files = CalibrationFiles::default();
    files.wheel_topic = Some(topic.to_owned());
    files.wheel_joints = joints.into_iter().flatten().map(str::to_owned).collect();
    files
}

fn speeds(recording: &Recording<'_>) -> Vec<[f64; 2]> {
    let mut source = recording.source().unwrap();
    let mut found = Vec::new();
    while let Some(event) = source.next().unwrap() {
        if let SensorEvent::Wheels(reading) = event {
            assert_eq!(reading.stamp_ns, START_NS + found.len() as i64 * 20 * MS);
            found.push([reading.values[0], reading.values[1]]);
        }
    }
    found
}

fn problem(opened: Result<Recording<'_>, SequenceError>) -> String {
    opened.map(drop).unwrap_err().to_string()
}

fn assert_near(found: &[[f64; 2]], expected: impl Fn(f64) -> [f64; 2]) {
    assert_eq!(found.len(), 100);
    for (index, found) in found.iter().enumerate() {
        let expected = expected(0.1 * index as f64);
        let off = (found[0] - expected[0]).abs().max((found[1] - expected[1]).abs());
        assert!(off < 1e-9, "{index}: {found:?}, {expected:?}");
    }
}

#[test]
fn wheels_of_joints_are_read_where_their_topic_is_named() {
    let made = Made::new(
        &with_wheels("/joint_states", joints(&["arm", "right_wheel_joint", "left_wheel_joint"])),
        &CAMERA,
    );
    let recording = made.open().unwrap();
    assert!(recording.contents().wheels.is_none() && speeds(&recording).is_empty());
    let recording = made.open_with(&files("/joint_states", None)).unwrap();
    assert_eq!(recording.contents().wheels, Some(WheelReadings::Speeds));
    assert_eq!(recording.calibration().wheels, None, "joints have no geometry");
    assert_near(&speeds(&recording), |speed| [speed + 2.0, speed + 1.0]);
    let named = made.open_with(&files("joint_states", Some(["arm", "right_wheel_joint"]))).unwrap();
    assert_near(&speeds(&named), |speed| [speed, speed + 1.0]);
    let error = problem(made.open_with(&files("/joint_states", Some(["arm", "right"]))));
    assert!(error.contains("--wheel-joints") && error.contains("right_wheel_joint"), "{error}");
    let error = problem(made.open_with(&files("/wheels", None)));
    assert!(
        error.contains("--wheel-topic /wheels is not recorded") && error.contains("/joint_states"),
        "{error}"
    );
    let error = problem(made.open_with(&files("/imu0", None)));
    assert!(error.contains("sensor_msgs/JointState or nav_msgs/Odometry is needed"), "{error}");
}

#[test]
fn wheels_of_one_side_count_by_their_mean() {
    let names = &["front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"];
    let made = Made::new(&with_wheels("/joint_states", joints(names)), &CAMERA);
    let recording = made.open_with(&files("/joint_states", None)).unwrap();
    assert_near(&speeds(&recording), |speed| [speed + 1.0, speed + 2.0]);
}

#[test]
fn joints_without_speeds_are_read_by_their_positions() {
    // One of them wraps around at a revolution.
    let positions = |header, index: f64| {
        let name = vec!["left_wheel".to_owned(), "right_wheel".to_owned()];
        let position = vec![2.0 * index, (3.0 * index).rem_euclid(std::f64::consts::TAU)];
        Body::Joints(JointState { header, name, position, ..JointState::default() })
    };
    let made = Made::new(&with_wheels("/joint_states", positions), &CAMERA);
    let recording = made.open_with(&files("/joint_states", None)).unwrap();
    assert_eq!(recording.contents().wheels, Some(WheelReadings::Speeds));
    let mut source = recording.source().unwrap();
    let mut found = 0;
    while let Some(event) = source.next().unwrap() {
        let SensorEvent::Wheels(reading) = event else { continue };
        // 0.1 a message, in the middle between two.
        assert_eq!(reading.stamp_ns, START_NS + (20 * found + 10) * MS);
        assert!((reading.values[0] - 10.0).abs() < 1e-6 && (reading.values[1] - 15.0).abs() < 1e-6);
        found += 1;
    }
    assert_eq!(found, 99);
}

#[test]
fn joints_without_numbers_are_no_wheels() {
    let nothing = |header, _| {
        let name = vec!["left_wheel".to_owned(), "right_wheel".to_owned()];
        Body::Joints(JointState { header, name, ..JointState::default() })
    };
    let made = Made::new(&with_wheels("/joint_states", nothing), &CAMERA);
    let recording = made.open_with(&files("/joint_states", None)).unwrap();
    assert!(recording.contents().wheels.is_none());
}

#[test]
fn a_base_that_can_move_sideways_is_read_so() {
    let mut files = files("/odom", None);
    files.wheel_base = Some(BaseKind::Mecanum);
    let made = Made::new(&with_wheels("/odom", odometry(0.3)), &CAMERA);
    let recording = made.open_with(&files).unwrap();
    let mut source = recording.source().unwrap();
    let reading = std::iter::from_fn(|| source.next().unwrap()).find_map(|event| match event {
        SensorEvent::Wheels(reading) if reading.stamp_ns == START_NS + 200 * MS => Some(reading),
        _ => None,
    });
    let expected = [0.3, 1.7, 0.9, 1.1];
    let off = reading.unwrap().values.into_iter().zip(expected).map(|(a, b): (f64, f64)| (a - b).abs());
    assert!(off.fold(0.0, f64::max) < 1e-12);
}

#[test]
fn velocities_of_a_base_are_wheels_of_a_metre() {
    let mut all = with_wheels("/odom", odometry(0.0));
    let imu_from_base = Pose::new(Rotation::identity(), Vector3::new(-0.1, 0.0, -0.2));
    let header = Header::new(START_NS, "imu").unwrap();
    let transform = transform_message(header.stamp, "base_link", "imu", &imu_from_base.inverse());
    let unplaced = Made::new(&all, &CAMERA);
    let recording = unplaced.open_with(&files("/odom", None)).unwrap();
    assert_eq!(recording.calibration().wheels, None, "nothing says where the base is");
    assert_eq!(recording.contents().wheels, Some(WheelReadings::BaseVelocities));
    let body = Body::Transforms(TFMessage { transforms: vec![transform] });
    all.push(Message { topic: "/tf_static".to_owned(), log_ns: START_NS, body });
    let made = Made::new(&all, &CAMERA);
    let recording = made.open_with(&files("/odom", None)).unwrap();
    let wheels = recording.calibration().wheels.unwrap();
    assert!(wheels.imu_from_base.local(&imu_from_base).norm() < 1e-12);
    let found = speeds(&recording);
    assert_near(&found, |ahead| [ahead - 0.2, ahead + 0.2]);
    // Speed and turn of wheels of this geometry.
    let [left, right] = found[10];
    let (left_m_s, right_m_s) = (left * wheels.base.radius_m(0), right * wheels.base.radius_m(1));
    assert!((0.5 * (left_m_s + right_m_s) - 1.0).abs() < 1e-12);
    assert!(((right_m_s - left_m_s) / wheels.base.size_m() - 0.4).abs() < 1e-12);
}

#[test]
fn a_base_that_moves_sideways_is_refused() {
    let made = Made::new(&with_wheels("/odom", odometry(0.3)), &CAMERA);
    let error = problem(made.open_with(&files("/odom", None)));
    assert!(error.contains("sideways (0.30 m/s)") && error.contains("mecanum"), "{error}");
}
