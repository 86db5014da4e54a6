//! Which topics are the sensors: depths, cameras by the calibration, gyroscope and accelerometer apart.

use super::making::{Body, MS, Made, Message, READINGS, frames, image, imu, messages, reading, readings};
use ros_messages::geometry_msgs::Vector3;
use sensors::{CalibrationFiles, ImuSample, Recording, SequenceError};

const LEFT: &str = "/stereo/left/image_raw";
const RIGHT: &str = "/stereo/right/image_raw";
const GYROSCOPE: &str = "/camera/gyro/sample";
const ACCELEROMETER: &str = "/camera/accel/sample";

fn topics(recording: Result<Recording<'static>, SequenceError>) -> String {
    recording.err().map(|error| error.to_string()).unwrap_or_default()
}

/// A recording with the images of some topics, numbered from ten times the place of the topic.
fn with_images(of: &[(&str, &str)]) -> Vec<Message> {
    let mut all: Vec<Message> = messages(0);
    for (place, (topic, encoding)) in of.iter().enumerate() {
        all.extend((0..20).map(|index| {
            let mut message = image(topic, index, encoding);
            if let Body::Image(image) = &mut message.body {
                image.data.iter_mut().for_each(|byte| *byte = 10 * (place as u8 + 1));
            }
            message
        }));
    }
    all
}

/// The cameras of a recording: the first pixel of their first images, and the focal lengths of their calibrations.
fn cameras(recording: &Recording<'_>) -> Vec<(u8, f64)> {
    let images = frames(recording)[0].1;
    let focal = recording.calibration().cameras.iter().map(|sensor| sensor.camera.focal[0]);
    images.into_iter().flatten().zip(focal).collect()
}

#[test]
fn the_calibration_says_which_camera_is_which() {
    let all = with_images(&[(LEFT, "mono8"), (RIGHT, "mono8")]);
    // By the order in the chain, cam0 has a focal length of 8 and cam1 of 9.
    for (name, chain, named, expected) in [
        ("as they are named", &[LEFT, RIGHT][..], &[][..], vec![(10, 8.0), (20, 9.0)]),
        ("in another order", &[RIGHT, LEFT], &[], vec![(20, 8.0), (10, 9.0)]),
        ("named in another order", &[LEFT, RIGHT], &[RIGHT, LEFT], vec![(20, 9.0), (10, 8.0)]),
        ("the right one only", &[RIGHT], &[], vec![(20, 8.0)]),
        ("of another robot", &["/cam0/image_raw", "/cam1/image_raw"], &[], vec![(10, 8.0), (20, 9.0)]),
        ("the second is named", &[LEFT, RIGHT], &[RIGHT], vec![(20, 9.0)]),
    ] {
        let made = Made::new(&all, chain);
        let mut files = CalibrationFiles::default();
        files.camera_topics = named.iter().map(|topic: &&str| (*topic).to_owned()).collect();
        let recording = made.open_with(&files).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(cameras(&recording), expected, "{name}");
    }
    let mut files = CalibrationFiles::default();
    files.camera_topics = vec![LEFT.to_owned()];
    let error = topics(Made::new(&all, &[RIGHT]).open_with(&files));
    assert!(error.contains("rostopic") && error.contains(LEFT) && error.contains(RIGHT), "{error}");
}

#[test]
fn depths_are_no_camera() {
    let colour = "/camera/color/image_raw";
    for (name, depth, encoding) in [
        ("by encoding", "/camera/aligned", "16UC1"),
        ("by encoding, metres", "/before", "32FC1"),
        ("by name", "/camera/aligned_depth_to_color/image_raw", "mono16"),
    ] {
        let all = with_images(&[(depth, encoding), (colour, "rgb8")]);
        let made = Made::new(&all, &[colour]);
        assert_eq!(cameras(&made.open().unwrap()), [(20, 8.0)], "{name}");
        // Alone it is not used either, and the error says why.
        let made = Made::new(&with_images(&[(depth, encoding)]), &[depth]);
        let error = topics(made.open());
        assert!(error.contains("depths") && error.contains(depth), "{name}: {error}");
    }
    let mut files = CalibrationFiles::default();
    files.camera_topics = vec!["/d".to_owned()];
    let made = Made::new(&with_images(&[("/d", "32FC1"), (colour, "rgb8")]), &["/d"]);
    let error = topics(made.open_with(&files));
    assert!(error.contains("/d holds depths") && error.contains(colour), "{error}");
}

/// A gyroscope at 200 Hz and an accelerometer at 100 Hz, 1.3 ms later, as RealSense's driver gives them.
fn apart() -> Vec<Message> {
    let mut all = messages(1);
    all.retain(|message| message.topic != "/imu0");
    for index in 0..READINGS {
        let mut gyroscope = imu(GYROSCOPE, index);
        let mut accelerometer = imu(ACCELEROMETER, index);
        if let (Body::Imu(rates), Body::Imu(forces)) = (&mut gyroscope.body, &mut accelerometer.body) {
            rates.linear_acceleration = Vector3::default();
            rates.linear_acceleration_covariance[0] = -1.0;
            forces.angular_velocity = Vector3::default();
            // Linear in time, so that interpolation is exact.
            forces.linear_acceleration.x = index as f64 * 0.01 + 0.0026;
        }
        accelerometer.shift(13 * MS / 10);
        all.push(gyroscope);
        if index % 2 == 0 {
            all.push(accelerometer);
        }
    }
    all
}

fn check_apart(recording: &Recording<'_>, name: &str) {
    let found: Vec<ImuSample> = readings(recording);
    // The first one comes before all specific forces, the last one after them.
    assert_eq!(found.len(), READINGS as usize - 2, "{name}");
    for (found, index) in found.iter().zip(1..) {
        let expected = reading(index);
        assert_eq!((found.stamp_ns, found.gyroscope), (expected.stamp_ns, expected.gyroscope), "{name}");
        let off = (found.accelerometer - expected.accelerometer).yz().norm();
        assert!(
            off < 5e-3 && (found.accelerometer.x - index as f64 * 0.01).abs() < 1e-9,
            "{name}: {found:?}"
        );
    }
}

#[test]
fn gyroscope_and_accelerometer_in_two_topics_are_one_imu() {
    let camera = ["/cam0/image_raw"];
    let made = Made::new(&apart(), &camera);
    check_apart(&made.open().unwrap(), "found");
    let named = |imu: Option<&str>, accelerometer: Option<&str>| {
        let mut files = CalibrationFiles::default();
        files.imu_topic = imu.map(str::to_owned);
        files.accelerometer_topic = accelerometer.map(str::to_owned);
        files
    };
    for (imu, accelerometer) in
        [(Some(GYROSCOPE), None), (None, Some(ACCELEROMETER)), (Some(GYROSCOPE), Some(ACCELEROMETER))]
    {
        let recording = made.open_with(&named(imu, accelerometer)).unwrap();
        check_apart(&recording, &format!("{imu:?} {accelerometer:?}"));
    }
    // One that has both comes first.
    let mut all = apart();
    all.extend((0..READINGS).map(|index| imu("/imu0", index)));
    assert_eq!(readings(&Made::new(&all, &camera).open().unwrap()).len(), READINGS as usize);
    // Without an accelerometer there is no IMU.
    let mut all = apart();
    all.retain(|message| message.topic != ACCELEROMETER);
    let error = topics(Made::new(&all, &camera).open());
    assert!(error.contains(GYROSCOPE) && error.contains("--accelerometer-topic"), "{error}");
    // Where it pauses, the specific force is not known.
    let mut all = apart();
    all.retain(|message| {
        message.topic != ACCELEROMETER || !(100..160).contains(&(message.log_ns / MS % 1000))
    });
    let found = readings(&Made::new(&all, &camera).open().unwrap());
    assert_eq!(found.len(), READINGS as usize - 2, "a pause of 60 ms is bridged");
    let mut all = apart();
    all.retain(|message| {
        message.topic != ACCELEROMETER || !(100..400).contains(&(message.log_ns / MS % 1000))
    });
    let found = readings(&Made::new(&all, &camera).open().unwrap());
    assert!((READINGS as usize - 135..READINGS as usize - 110).contains(&found.len()), "{}", found.len());
}

#[test]
fn a_covariance_of_minus_one_is_unknown_where_there_are_values() {
    let mut all = messages(1);
    for message in &mut all {
        if let Body::Imu(imu) = &mut message.body {
            imu.angular_velocity_covariance[0] = -1.0;
            imu.linear_acceleration_covariance[0] = f64::NAN;
        }
    }
    let camera = ["/cam0/image_raw"];
    let found = readings(&Made::new(&all, &camera).open().unwrap());
    assert_eq!(found, readings(&Made::new(&messages(1), &camera).open().unwrap()));
}
