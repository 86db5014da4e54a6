//! Small recordings, made message by message.

use nalgebra::Vector3;
use ros_messages::nav_msgs::Odometry;
use ros_messages::sensor_msgs::{Image, Imu, JointState, NavSatFix};
use ros_messages::std_msgs::Header;
use ros_messages::tf2_msgs::TFMessage;
use ros_messages::{RosMessage, encode};
use sensors::ros::imu_message;
use sensors::ros_bag::{RosBagWriter, message_type};
use sensors::{CalibrationFiles, ImuSample, Recording, SensorEvent, SensorSource, SequenceError};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

pub const MS: i64 = 1_000_000;
pub const START_NS: i64 = 1_403_636_625_000_000_000;
/// Two seconds at 200 and at 20 Hz.
pub const READINGS: i64 = 400;
pub const IMAGES: i64 = 40;

/// A message of a recording.
#[derive(Clone, Debug)]
pub struct Message {
    pub topic: String,
    pub log_ns: i64,
    pub body: Body,
}

#[derive(Clone, Debug)]
pub enum Body {
    Imu(Box<Imu>),
    Image(Image),
    Joints(JointState),
    Fix(Box<NavSatFix>),
    Odometry(Box<Odometry>),
    Transforms(TFMessage),
}

impl Message {
    /// Moves the stamp in the header.
    pub fn shift(&mut self, by_ns: i64) {
        let header = match &mut self.body {
            Body::Imu(imu) => &mut imu.header,
            Body::Image(image) => &mut image.header,
            Body::Joints(joints) => &mut joints.header,
            Body::Fix(fix) => &mut fix.header,
            Body::Odometry(odometry) => &mut odometry.header,
            Body::Transforms(_) => return,
        };
        *header = Header::new(header.stamp.to_nanoseconds() + by_ns, &header.frame_id).unwrap();
    }
}

/// A reading of an IMU that turns slowly: the sample and its message.
pub fn reading(index: i64) -> ImuSample {
    let phase = index as f64 * 0.01;
    ImuSample {
        stamp_ns: START_NS + index * 5 * MS,
        gyroscope: Vector3::new(0.1 * phase.sin(), 0.2, 0.1 * phase.cos()),
        accelerometer: Vector3::new(0.5 * phase.sin(), 0.5 * phase.cos(), 9.7),
    }
}

pub fn imu(topic: &str, index: i64) -> Message {
    let sample = reading(index);
    let body = Body::Imu(Box::new(imu_message(&sample, "imu").unwrap()));
    Message { topic: topic.to_owned(), log_ns: sample.stamp_ns + MS, body }
}

/// An image of 8 x 6 pixels whose first pixel says its number.
pub fn image(topic: &str, index: i64, encoding: &str) -> Message {
    let stamp_ns = START_NS + index * 50 * MS;
    let bytes = match encoding {
        "16UC1" | "mono16" => 2,
        "32FC1" => 4,
        "rgb8" => 3,
        _ => 1,
    };
    let mut data = vec![90; 8 * 6 * bytes];
    data[0] = index as u8;
    let (header, encoding, step) =
        (Header::new(stamp_ns, "camera").unwrap(), encoding.to_owned(), 8 * bytes as u32);
    let body = Body::Image(Image { header, height: 6, width: 8, encoding, is_bigendian: 0, step, data });
    Message { topic: topic.to_owned(), log_ns: stamp_ns + 25 * MS, body }
}

/// The readings of `/imu0`, and the images of `/cam0/image_raw`, `/cam1/image_raw` and so on.
pub fn messages(cameras: usize) -> Vec<Message> {
    let readings = (0..READINGS).map(|index| imu("/imu0", index));
    let images = (0..cameras).flat_map(|camera| {
        (0..IMAGES).map(move |index| image(&format!("/cam{camera}/image_raw"), index, "mono8"))
    });
    readings.chain(images).collect()
}

/// Kalibr's camera chain of cameras at 0, 0.1, ... m along the x axis.
pub fn chain(topics: &[&str]) -> String {
    let camera = |(index, topic): (usize, &&str)| {
        format!(
            "cam{index}:\n  T_cam_imu: [[1, 0, 0, -{x}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n  camera_model: pinhole\n  \
             intrinsics: [{focal}, 9.0, 4.0, 3.0]\n  distortion_model: radtan\n  distortion_coeffs: [0, 0, 0, 0]\n  \
             resolution: [8, 6]\n  rostopic: {topic}\n",
            x = index as f64 * 0.1,
            focal = 8 + index
        )
    };
    topics.iter().enumerate().map(camera).collect()
}

pub const NOISE: &str = "gyroscope_noise_density: 1.0e-4\ngyroscope_random_walk: 1.0e-5\naccelerometer_noise_density: 1.0e-3\n\
    accelerometer_random_walk: 1.0e-4\nupdate_rate: 200.0\n";

/// A recording in a folder of its own, with a calibration beside it.
pub struct Made {
    pub folder: TempDir,
    pub path: PathBuf,
}

impl Made {
    /// Writes messages in order of their log times, as a recorder does.
    pub fn new(messages: &[Message], calibrated: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("drive.mcap");
        let mut messages = messages.to_vec();
        messages.sort_by_key(|message| message.log_ns);
        write(&path, &messages);
        std::fs::write(folder.path().join("camchain-imucam.yaml"), chain(calibrated)).unwrap();
        std::fs::write(folder.path().join("imu.yaml"), NOISE).unwrap();
        Self { folder, path }
    }

    pub fn open(&self) -> Result<Recording<'static>, SequenceError> {
        Recording::open(&self.path)
    }

    pub fn open_with(&self, files: &CalibrationFiles) -> Result<Recording<'static>, SequenceError> {
        Recording::open_with(&self.path, files)
    }
}

fn write(path: &Path, messages: &[Message]) {
    let mut bag = RosBagWriter::create(path, bags::Format::Mcap).unwrap();
    for Message { topic, log_ns, body } in messages {
        match body {
            Body::Imu(message) => put(&mut bag, topic, *log_ns, &**message),
            Body::Image(message) => put(&mut bag, topic, *log_ns, message),
            Body::Joints(message) => put(&mut bag, topic, *log_ns, message),
            Body::Fix(message) => put(&mut bag, topic, *log_ns, &**message),
            Body::Odometry(message) => put(&mut bag, topic, *log_ns, &**message),
            Body::Transforms(message) => put(&mut bag, topic, *log_ns, message),
        }
    }
    bag.finish().unwrap();
}

fn put<M: RosMessage>(bag: &mut RosBagWriter, topic: &str, log_ns: i64, message: &M) {
    bag.write(topic, message_type::<M>, log_ns, &encode(message).unwrap()).unwrap();
}

/// The readings of a recording.
pub fn readings(recording: &Recording<'_>) -> Vec<ImuSample> {
    recording.imu_samples().unwrap().map(Result::unwrap).collect()
}

/// Stamp of each frame, and the numbers of its images.
pub fn frames(recording: &Recording<'_>) -> Vec<(i64, [Option<u8>; 2])> {
    let mut source = recording.source().unwrap();
    let mut frames = Vec::new();
    while let Some(event) = source.next().unwrap() {
        if let SensorEvent::Frame(frame) = event {
            let number = |camera| frame.images.get(&camera).map(|image| image.read().unwrap().pixels()[0]);
            frames.push((frame.stamp_ns, [0, 1].map(number)));
        }
    }
    frames
}
