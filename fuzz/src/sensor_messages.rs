//! Messages of live sensors: Driftless' own, and those of ROS 2.

use nalgebra::Vector3;
use protocol::sensors::{ImageHeader, TracksMessage, decode_imu};
use ros_messages::diagnostic_msgs::DiagnosticArray;
use ros_messages::geometry_msgs::PoseWithCovarianceStamped;
use ros_messages::nav_msgs::Odometry;
use ros_messages::rosgraph_msgs::Clock;
use ros_messages::sensor_msgs::{CameraInfo, CompressedImage, Image, Imu, JointState, NavSatFix};
use ros_messages::tf2_msgs::TFMessage;
use ros_messages::{RosMessage, decode, encode};
use sensors::live::{LiveImage, LiveSettings, LiveSource, RawPixels};
use sensors::ros::{JointReader, camera_of_info, imu_sample, satellite_position};
use sensors::{BaseKind, ImuSample, SensorCalibration, SensorEvent, SensorSource};
use std::path::Path;

/// Size of the images in the seeds, and what the camera is calibrated for.
const SIZE: (u32, u32) = (8, 6);

/// Readings, tracks, and images: a line with the header, then the bytes of the image.
///
/// # Panics
/// Readings leave the source out of order, or an image has another size than its camera.
pub fn sensor_messages(data: &[u8]) {
    if let Ok(readings) = decode_imu(data) {
        let to_sample = |reading: protocol::sensors::ImuMessage| ImuSample {
            stamp_ns: reading.stamp_ns,
            gyroscope: Vector3::from(reading.gyroscope),
            accelerometer: Vector3::from(reading.accelerometer),
        };
        played(readings.into_iter().map(to_sample));
    }
    if let Ok(message) = TracksMessage::decode(data) {
        assert!(message.tracks.iter().all(|(_, _, u, v)| u.is_finite() && v.is_finite()));
    }
    let end = data.iter().position(|byte| *byte == b'\n').unwrap_or(data.len());
    let (header, bytes) = data.split_at(end);
    let Ok(header) = ImageHeader::decode(Some(header)) else { return };
    let bytes = bytes.get(1..).unwrap_or_default().to_vec();
    let ImageHeader { encoding, width, height, step, .. } = header;
    gray(if ["jpeg", "png"].contains(&encoding.as_str()) {
        LiveImage::Encoded(bytes)
    } else {
        let step = step.unwrap_or(width);
        LiveImage::Raw(RawPixels { width, height, step, encoding, big_endian: false, bytes })
    });
}

/// Readings of any stamps come out in order.
fn played(readings: impl Iterator<Item = ImuSample>) {
    let calibration = SensorCalibration::default();
    let settings = LiveSettings::images(&calibration);
    let (inputs, mut source) = LiveSource::new("fuzz", calibration, &settings);
    readings.for_each(|reading| inputs.imu(reading));
    inputs.close();
    let mut last_ns = i64::MIN;
    while let Ok(Some(event)) = source.next() {
        if let SensorEvent::Imu(reading) = event {
            assert!(reading.stamp_ns > last_ns, "{} after {last_ns}", reading.stamp_ns);
            last_ns = reading.stamp_ns;
        }
    }
}

fn gray(image: LiveImage) {
    if let Ok(gray) = image.into_gray(SIZE) {
        assert_eq!((gray.width(), gray.height()), (SIZE.0 as usize, SIZE.1 as usize));
    }
}

/// CDR of every message that is received or read from bags.
///
/// # Panics
/// What decodes does not encode to what decodes to the same, or a camera that was read is not valid.
pub fn ros_messages(data: &[u8]) {
    if let Some(message) = round_trip::<Imu>(data) {
        let _ = imu_sample(&message);
    }
    if let Some(Image { width, height, step, encoding, is_bigendian, data: bytes, .. }) = round_trip(data) {
        let big_endian = is_bigendian != 0;
        gray(LiveImage::Raw(RawPixels { width, height, step, encoding, big_endian, bytes }));
    }
    if let Some(CompressedImage { data: bytes, .. }) = round_trip(data) {
        gray(LiveImage::Encoded(bytes));
    }
    if let Some(message) = round_trip::<CameraInfo>(data)
        && let Ok(Some(camera)) = camera_of_info(&message, "/cam0/image_raw", Path::new("/cam0/camera_info"))
    {
        camera.validate().expect("a camera that was read is valid");
    }
    if let Some(message) = round_trip::<NavSatFix>(data)
        && let Ok(position) = satellite_position(&message)
    {
        assert!(
            position.geodetic.iter().all(|value| value.is_finite()),
            "a position that was read is finite"
        );
    }
    if let Some(message) = round_trip::<JointState>(data) {
        let mut reader = JointReader::new(BaseKind::Differential, None, None);
        for stamp_ns in [0, 1] {
            let _ = reader.reading(stamp_ns, &message);
        }
    }
    round_trip::<Clock>(data);
    round_trip::<PoseWithCovarianceStamped>(data);
    round_trip::<TFMessage>(data);
    round_trip::<Odometry>(data);
    round_trip::<DiagnosticArray>(data);
}

/// The message, if it is one. Bytes are compared: messages may hold what is not a number.
fn round_trip<M: RosMessage>(data: &[u8]) -> Option<M> {
    let message = decode::<M>(data).ok()?;
    let bytes = encode(&message).expect("a decoded message can be written");
    let again = decode::<M>(&bytes).expect("what was encoded can be decoded");
    assert_eq!(encode(&again).expect("a decoded message can be written"), bytes, "stable");
    Some(message)
}
