//! GNSS of bags: `sensor_msgs/NavSatFix`.

use super::making::{Body, MS, Made, Message, START_NS, messages};
use geometry::{Geodetic, Pose, Rotation};
use nalgebra::Vector3;
use ros_messages::sensor_msgs::NavSatFix;
use ros_messages::std_msgs::Header;
use ros_messages::tf2_msgs::TFMessage;
use sensors::ros::transform_message;
use sensors::{CalibrationFiles, GnssReading, SensorEvent, SensorSource};

const CAMERA: [&str; 1] = ["/cam0/image_raw"];
const ORIGIN: Geodetic = Geodetic { latitude_deg: 48.0, longitude_deg: 11.0, altitude_m: 500.0 };

/// Five positions a second to the north; one in three is none.
fn with_gnss() -> Vec<Message> {
    let mut all = messages(1);
    all.extend((0..9).map(|index| {
        let stamp_ns = START_NS + index * 200 * MS;
        let mut fix = NavSatFix {
            header: Header::new(stamp_ns, "antenna").unwrap(),
            latitude: ORIGIN.latitude_deg + 1e-5 * index as f64,
            longitude: ORIGIN.longitude_deg,
            altitude: ORIGIN.altitude_m + 2.0,
            position_covariance: [4.0, 0.1, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0, 9.0],
            position_covariance_type: 3,
            ..NavSatFix::default()
        };
        match index % 3 {
            1 => fix.status.status = -1,
            2 if index == 5 => fix.altitude = f64::NAN,
            _ => {}
        }
        Message { topic: "/fix".to_owned(), log_ns: stamp_ns + MS, body: Body::Fix(Box::new(fix)) }
    }));
    all
}

fn files(origin: Option<Geodetic>) -> CalibrationFiles {
    let mut files = CalibrationFiles::default();
    files.gnss_topic = Some("/fix".to_owned());
    files.gnss_origin = origin;
    files
}

#[test]
fn positions_are_read_where_their_topic_is_named_and_the_antenna_where_tf_static_says() {
    let mut all = with_gnss();
    let unplaced = Made::new(&all, &CAMERA);
    assert!(!unplaced.open().unwrap().contents().gnss);
    let recording = unplaced.open_with(&files(Some(ORIGIN))).unwrap();
    assert!(recording.contents().gnss && recording.calibration().gnss.is_none());

    let imu_from_antenna = Pose::new(Rotation::identity(), Vector3::new(-0.1, 0.2, 0.9));
    let header = Header::new(START_NS, "imu").unwrap();
    let transform = transform_message(header.stamp, "imu", "antenna", &imu_from_antenna);
    let body = Body::Transforms(TFMessage { transforms: vec![transform] });
    all.push(Message { topic: "/tf_static".to_owned(), log_ns: START_NS, body });
    let placed = Made::new(&all, &CAMERA);
    let recording = placed.open_with(&files(Some(ORIGIN))).unwrap();
    assert_eq!(recording.calibration().gnss.unwrap().antenna_in_imu, imu_from_antenna.translation);
    let mut source = recording.source().unwrap();
    let mut found: Vec<GnssReading> = Vec::new();
    while let Some(event) = source.next().unwrap() {
        if let SensorEvent::Gnss(reading) = event {
            found.push(reading);
        }
    }
    assert_eq!(found.len(), 5);
    for (reading, index) in found.iter().zip([0, 2, 3, 6, 8]) {
        assert_eq!(reading.stamp_ns, START_NS + index * 200 * MS);
        let north = Vector3::new(0.0, 1.112 * index as f64, 2.0);
        assert!((reading.position - north).norm() < 0.01, "{index}: {}", reading.position);
        assert_eq!(reading.covariance.diagonal(), Vector3::new(4.0, 1.0, 9.0));
    }
}

#[test]
fn a_sensor_yaml_states_origin_and_antenna_and_a_given_origin_comes_first() {
    let made = Made::new(&with_gnss(), &CAMERA);
    let file = made.path.with_file_name("mav0").join("gnss0/sensor.yaml");
    std::fs::create_dir_all(file.parent().unwrap()).unwrap();
    std::fs::write(&file, "antenna: [0.1, 0.0, 0.8]\norigin: [48.0, 11.0, 500.0]\n").unwrap();
    let lower = Geodetic { altitude_m: 490.0, ..ORIGIN };
    for (given, used, height_m) in [(None, ORIGIN, 2.0), (Some(lower), lower, 12.0)] {
        let recording = made.open_with(&files(given)).unwrap();
        let sensor = recording.calibration().gnss.unwrap();
        assert_eq!((sensor.antenna_in_imu, sensor.origin), (Vector3::new(0.1, 0.0, 0.8), Some(used)));
        let first = recording.gnss_readings().unwrap().next().unwrap().unwrap();
        assert!((first.position - Vector3::new(0.0, 0.0, height_m)).norm() < 0.01, "{}", first.position);
    }
    assert!(!made.open().unwrap().contents().gnss, "the topic has to be named");
}

#[test]
fn what_a_topic_of_positions_lacks_is_named() {
    let made = Made::new(&with_gnss(), &CAMERA);
    let error = |files: &CalibrationFiles| made.open_with(files).map(drop).unwrap_err().to_string();
    let nowhere = error(&files(None));
    assert!(nowhere.contains("--gnss-origin") && nowhere.contains("gnss0/sensor.yaml"), "{nowhere}");
    let elsewhere = Geodetic { latitude_deg: 11.0, longitude_deg: 48.0, ..ORIGIN };
    let far = error(&files(Some(elsewhere)));
    assert!(far.contains("km from the origin"), "{far}");
    let mut wrong = files(Some(ORIGIN));
    wrong.gnss_topic = Some("/imu0".to_owned());
    assert!(error(&wrong).contains("sensor_msgs/NavSatFix is needed"));
    let mut silent = with_gnss();
    for message in &mut silent {
        if let Body::Fix(fix) = &mut message.body {
            fix.status.status = -1;
        }
    }
    let made = Made::new(&silent, &CAMERA);
    let none = made.open_with(&files(Some(ORIGIN))).map(drop).unwrap_err().to_string();
    assert!(none.contains("no message with a position"), "{none}");
}
