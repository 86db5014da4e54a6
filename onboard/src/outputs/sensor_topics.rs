//! What belongs to the recorded sensors: the names of their frames, the projections of the cameras, where they are mounted.

use super::ros::{RosBody, SensorFrames, static_transforms};
use bags::OfferedQos;
use geometry::camera::Distortion;
use ros_messages::builtin_interfaces::Time;
use ros_messages::sensor_msgs::CameraInfo;
use ros_messages::std_msgs::Header;
use ros_messages::tf2_msgs::TFMessage;
use sensors::CameraSensor;
use sensors::live::Stream;
use sensors::ros::{camera_info_message, camera_info_topic};

/// ROS's profile of sensor data.
const SENSOR_DATA: OfferedQos = OfferedQos::BestEffort { depth: 5 };

/// The topics of the sensors of a recording.
#[derive(Debug)]
pub(super) struct SensorTopics {
    imu_frame: String,
    cameras: Vec<CameraTopics>,
    /// Streams whose publishers offer best effort.
    best_effort: Vec<Stream>,
}

#[derive(Debug)]
struct CameraTopics {
    frame: String,
    info: CameraInfo,
}

impl SensorTopics {
    /// The topics of calibrated sensors; says what other programs cannot use of them.
    pub(super) fn new(frames: &SensorFrames, cameras: &[CameraSensor]) -> Self {
        let mut names = complete(frames).names.into_iter();
        let imu_frame = names.next().unwrap_or_default();
        let topics = |(index, (frame, sensor)): (usize, (String, &CameraSensor))| {
            if matches!(sensor.camera.distortion, Distortion::Fov(_)) {
                tracing::warn!(
                    "cam{index}: ROS has no name for its distortion (fov): its CameraInfo is recorded, but of use to Driftless only"
                );
            }
            CameraTopics { frame, info: camera_info_message(&sensor.camera, Header::default()) }
        };
        let cameras = names.zip(cameras).enumerate().map(topics).collect();
        Self { imu_frame, cameras, best_effort: Vec::new() }
    }

    /// Sets which streams come with best effort.
    pub(super) fn set_best_effort(&mut self, streams: &[Stream]) {
        streams.clone_into(&mut self.best_effort);
    }

    /// What a stream is offered with.
    pub(super) fn qos(&self, stream: Stream) -> OfferedQos {
        if self.best_effort.contains(&stream) { SENSOR_DATA } else { OfferedQos::default() }
    }

    /// Name of the frame of the IMU.
    pub(super) fn imu_frame(&self) -> &str {
        &self.imu_frame
    }

    /// Name of the frame of a camera; `None` for one without calibration.
    pub(super) fn camera_frame(&self, camera: usize) -> Option<&str> {
        self.cameras.get(camera).map(|camera| camera.frame.as_str())
    }

    /// The topic and the message of a camera's projection at the time of an image.
    pub(super) fn info(&self, camera: usize, stamp_ns: i64) -> Option<(String, CameraInfo)> {
        let CameraTopics { frame, info } = self.cameras.get(camera)?;
        let header = Header::new(stamp_ns, frame)?;
        let topic = camera_info_topic(&format!("/cam{camera}/image_raw"));
        Some((topic, CameraInfo { header, ..info.clone() }))
    }
}

/// Where the sensors are mounted. Of recorded sensors that is complete: cameras on the IMU are named also where the robot's
/// description names them otherwise; where the IMU is on the robot is left to it then.
pub(super) fn mounting(body: &RosBody, cameras: &[CameraSensor], sensors: bool, stamp: Time) -> TFMessage {
    if !sensors {
        return static_transforms(body, cameras, stamp);
    }
    let is_described = body.sensor_frames.names.is_empty();
    let named = RosBody { sensor_frames: complete(&body.sensor_frames), ..body.clone() };
    let mut message = static_transforms(&named, cameras, stamp);
    if is_described {
        message.transforms.retain(|transform| transform.header.frame_id != body.frames.base_link);
    }
    message
}

/// The names of all frames: the usual ones for those that are not named.
fn complete(frames: &SensorFrames) -> SensorFrames {
    let usual = SensorFrames::default().names;
    let others = usual.into_iter().skip(frames.names.len());
    SensorFrames { names: frames.names.iter().cloned().chain(others).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Pose;
    use geometry::camera::Camera;

    fn camera(distortion: Distortion) -> CameraSensor {
        let (focal, centre) = ([400.0; 2], [320.0, 240.0]);
        let camera = Camera { width: 640, height: 480, focal, centre, distortion };
        CameraSensor { camera, imu_from_camera: Pose::identity(), rate_hz: 20.0 }
    }

    fn frames(names: &str) -> SensorFrames {
        names.parse().unwrap()
    }

    fn mounted(names: &str, sensors: bool) -> Vec<(String, String)> {
        let body = RosBody { sensor_frames: frames(names), ..RosBody::default() };
        let cameras = [camera(Distortion::None), camera(Distortion::None)];
        let message = mounting(&body, &cameras, sensors, Time::default());
        let names = |transform: &ros_messages::geometry_msgs::TransformStamped| {
            (transform.header.frame_id.clone(), transform.child_frame_id.clone())
        };
        message.transforms.iter().map(names).collect()
    }

    #[test]
    fn recorded_sensors_always_say_where_they_are() {
        let pairs = |pairs: &[(&str, &str)]| {
            pairs.iter().map(|(a, b)| ((*a).to_owned(), (*b).to_owned())).collect::<Vec<_>>()
        };
        let all = pairs(&[("base_link", "imu"), ("imu", "cam0"), ("imu", "cam1")]);
        assert_eq!(mounted("imu,cam0,cam1", true), all);
        assert_eq!(mounted("none", true), all[1..]);
        assert_eq!(mounted("none", false), []);
        let named = pairs(&[("base_link", "imu_link"), ("imu_link", "left"), ("imu_link", "cam1")]);
        assert_eq!(mounted("imu_link,left", true), named);
    }

    #[test]
    fn a_projection_has_the_frame_of_its_images() {
        let topics = SensorTopics::new(&frames("imu_link,left"), &vec![camera(Distortion::Fov(0.9)); 2]);
        assert_eq!((topics.imu_frame(), topics.camera_frame(0)), ("imu_link", Some("left")));
        let (topic, info) = topics.info(1, 5_000_000_007).unwrap();
        assert_eq!((topic.as_str(), info.header.frame_id.as_str()), ("/cam1/camera_info", "cam1"));
        assert_eq!(info.header.stamp.to_nanoseconds(), 5_000_000_007);
        // The model without a name in ROS is not left out.
        assert_eq!((info.distortion_model.as_str(), info.d), ("fov", vec![0.9]));
        assert!(topics.info(2, 0).is_none());
    }

    #[test]
    fn sensors_are_offered_as_they_came() {
        let mut topics = SensorTopics::new(&frames("none"), &[]);
        assert_eq!(topics.qos(Stream::Imu), OfferedQos::Reliable { depth: 10 });
        topics.set_best_effort(&[Stream::Camera(1)]);
        assert_eq!(topics.qos(Stream::Camera(1)), OfferedQos::BestEffort { depth: 5 });
        assert_eq!(topics.qos(Stream::Camera(0)), OfferedQos::Reliable { depth: 10 });
    }
}
