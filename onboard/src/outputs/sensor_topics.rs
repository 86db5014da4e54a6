//! What belongs to the recorded sensors: the names of their frames, the projections of the cameras, where they are mounted.

use super::ros::{RosBody, SensorFrames, complete_transforms, static_transforms};
use bags::OfferedQos;
use ros_messages::builtin_interfaces::Time;
use ros_messages::tf2_msgs::TFMessage;
use sensors::CameraSensor;
use sensors::live::Stream;
use sensors::ros::RosSensors;
use std::ops::Deref;

/// ROS's profile of sensor data.
const SENSOR_DATA: OfferedQos = OfferedQos::BestEffort { depth: 5 };

/// The topics of the sensors of a recording.
#[derive(Debug)]
pub(super) struct SensorTopics {
    sensors: RosSensors,
    /// Streams whose publishers offer best effort.
    best_effort: Vec<Stream>,
}

impl SensorTopics {
    /// The topics of calibrated sensors; says what other programs cannot use of them.
    pub(super) fn new(frames: &SensorFrames, cameras: &[CameraSensor]) -> Self {
        let sensors = RosSensors::new(&frames.names, cameras);
        sensors.warn_of_unnamed_models();
        Self { sensors, best_effort: Vec::new() }
    }

    /// Sets which streams come with best effort.
    pub(super) fn set_best_effort(&mut self, streams: &[Stream]) {
        streams.clone_into(&mut self.best_effort);
    }

    /// What a stream is offered with.
    pub(super) fn qos(&self, stream: Stream) -> OfferedQos {
        if self.best_effort.contains(&stream) { SENSOR_DATA } else { OfferedQos::default() }
    }
}

impl Deref for SensorTopics {
    type Target = RosSensors;

    fn deref(&self) -> &RosSensors {
        &self.sensors
    }
}

/// Where the sensors are mounted; of recorded sensors that is complete.
pub(super) fn mounting(body: &RosBody, cameras: &[CameraSensor], sensors: bool, stamp: Time) -> TFMessage {
    let transforms = if sensors { complete_transforms } else { static_transforms };
    transforms(body, cameras, stamp)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Pose;
    use geometry::camera::{Camera, Distortion};

    fn camera() -> CameraSensor {
        let (focal, centre, distortion) = ([400.0; 2], [320.0, 240.0], Distortion::None);
        let camera = Camera { width: 640, height: 480, focal, centre, distortion };
        CameraSensor::new(camera, Pose::identity(), 20.0)
    }

    fn frames(names: &str) -> SensorFrames {
        names.parse().unwrap()
    }

    fn mounted(names: &str, sensors: bool) -> Vec<(String, String)> {
        let body = RosBody { sensor_frames: frames(names), ..RosBody::default() };
        let cameras = [camera(), camera()];
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
    fn sensors_are_offered_as_they_came() {
        let mut topics = SensorTopics::new(&frames("none"), &[]);
        assert_eq!(topics.qos(Stream::Imu), OfferedQos::Reliable { depth: 10 });
        topics.set_best_effort(&[Stream::Camera(1)]);
        assert_eq!(topics.qos(Stream::Camera(1)), OfferedQos::BestEffort { depth: 5 });
        assert_eq!(topics.qos(Stream::Camera(0)), OfferedQos::Reliable { depth: 10 });
    }
}
