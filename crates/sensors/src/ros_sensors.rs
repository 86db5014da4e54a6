//! The sensors of a robot as others know them: the names of their frames, the projections of the cameras, where they are mounted.

use super::camera_info::{camera_info_message, camera_info_topic, has_ros_name};
use crate::CameraSensor;
use geometry::pose::Pose;
use ros_messages::builtin_interfaces::Time;
use ros_messages::geometry_msgs::{Quaternion, Transform, TransformStamped};
use ros_messages::sensor_msgs::CameraInfo;
use ros_messages::std_msgs::Header;

/// Frame of an IMU that is not named otherwise.
const IMU_FRAME: &str = "imu";

/// Calibrated sensors in messages of ROS: a recording of readings, images, and these messages needs no other calibration but
/// the noise of the IMU.
#[derive(Clone, Debug)]
pub struct RosSensors {
    imu_frame: String,
    cameras: Vec<RosCamera>,
}

#[derive(Clone, Debug)]
struct RosCamera {
    frame: String,
    info: CameraInfo,
    imu_from_camera: Pose,
    timing: CameraTiming,
    has_ros_name: bool,
}

/// When the pixels of a camera are taken, which no message states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CameraTiming {
    /// Images a second.
    pub(crate) rate_hz: f64,
    /// As [`CameraSensor::readout_s`].
    pub(crate) readout_s: f64,
    /// As [`CameraSensor::delay_s`]: larger shifts are in the stamps of the images.
    pub(crate) delay_s: f64,
}

impl RosSensors {
    /// # Arguments
    /// * `frames`: names of the frames of the IMU and of the cameras; `imu`, `cam0`, `cam1`, ... for those that are not named.
    pub fn new(frames: &[String], cameras: &[CameraSensor]) -> Self {
        let all = std::iter::once(IMU_FRAME.to_owned()).chain((0..).map(|camera| format!("cam{camera}")));
        let usual = all.skip(frames.len());
        let mut names = frames.iter().cloned().chain(usual);
        let imu_frame = names.next().unwrap_or_default();
        let camera = |(frame, sensor): (String, &CameraSensor)| RosCamera {
            frame,
            info: camera_info_message(&sensor.camera, Header::default()),
            imu_from_camera: sensor.imu_from_camera,
            timing: CameraTiming {
                rate_hz: sensor.rate_hz,
                readout_s: sensor.readout_s,
                delay_s: sensor.delay_s(),
            },
            has_ros_name: has_ros_name(&sensor.camera.distortion),
        };
        Self { imu_frame, cameras: names.zip(cameras).map(camera).collect() }
    }

    /// Logs which projections programs other than Driftless cannot use.
    pub fn warn_of_unnamed_models(&self) {
        for (index, camera) in self.cameras.iter().enumerate().filter(|(_, camera)| !camera.has_ros_name) {
            tracing::warn!(
                "cam{index}: ROS has no name for its distortion ({}): its CameraInfo is recorded, but of use to Driftless only",
                camera.info.distortion_model
            );
        }
    }

    /// Name of the frame of the IMU.
    pub fn imu_frame(&self) -> &str {
        &self.imu_frame
    }

    /// Name of the frame of a camera; `None` for one without calibration.
    pub fn camera_frame(&self, camera: usize) -> Option<&str> {
        self.cameras.get(camera).map(|camera| camera.frame.as_str())
    }

    /// The topic and the message of a camera's projection at the time of an image; `None` for a camera without calibration, and
    /// for a time that ROS cannot write.
    pub fn info(&self, camera: usize, stamp_ns: i64) -> Option<(String, CameraInfo)> {
        let RosCamera { frame, info, .. } = self.cameras.get(camera)?;
        let header = Header::new(stamp_ns, frame)?;
        Some((info_topic(camera), CameraInfo { header, ..info.clone() }))
    }

    /// The topics of the projections, and when the pixels of the cameras are taken.
    pub(crate) fn timing(&self) -> impl Iterator<Item = (String, CameraTiming)> + '_ {
        self.cameras.iter().enumerate().map(|(index, camera)| (info_topic(index), camera.timing))
    }

    /// The cameras in the frame of the IMU (optical frames: z along the view, x right).
    pub fn mounting(&self, stamp: Time) -> Vec<TransformStamped> {
        let transform = |camera: &RosCamera| {
            transform_message(stamp, &self.imu_frame, &camera.frame, &camera.imu_from_camera)
        };
        self.cameras.iter().map(transform).collect()
    }
}

fn info_topic(camera: usize) -> String {
    camera_info_topic(&format!("/cam{camera}/image_raw"))
}

/// The camera whose images Driftless records under a name.
pub(crate) fn camera_of_images(topic: &str) -> Option<usize> {
    let (camera, of) = topic.strip_prefix("/cam")?.split_once('/')?;
    of.starts_with("image_raw").then(|| camera.parse().ok())?
}

/// A frame in another one: `parent_from_child`.
pub fn transform_message(
    stamp: Time,
    parent: &str,
    child: &str,
    parent_from_child: &Pose,
) -> TransformStamped {
    let [x, y, z, w] = parent_from_child.rotation.coords.into();
    let translation = <[f64; 3]>::from(parent_from_child.translation).into();
    TransformStamped {
        header: Header { stamp, frame_id: parent.to_owned() },
        child_frame_id: child.to_owned(),
        transform: Transform { translation, rotation: Quaternion { x, y, z, w } },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Distortion;
    use geometry::camera::Camera;

    #[test]
    fn a_projection_has_the_frame_of_its_images() {
        let (focal, centre, distortion) = ([400.0; 2], [320.0, 240.0], Distortion::Fov(0.9));
        let camera = Camera { width: 640, height: 480, focal, centre, distortion };
        let sensor = CameraSensor::new(camera, Pose::identity(), 20.0);
        let sensors = RosSensors::new(&["imu_link".to_owned(), "left".to_owned()], &[sensor.clone(), sensor]);
        assert_eq!((sensors.imu_frame(), sensors.camera_frame(0)), ("imu_link", Some("left")));
        let (topic, info) = sensors.info(1, 5_000_000_007).unwrap();
        assert_eq!((topic.as_str(), info.header.frame_id.as_str()), ("/cam1/camera_info", "cam1"));
        assert_eq!(info.header.stamp.to_nanoseconds(), 5_000_000_007);
        // The model without a name in ROS is not left out.
        assert_eq!((info.distortion_model.as_str(), info.d), ("fov", vec![0.9]));
        assert!(sensors.info(2, 0).is_none() && sensors.camera_frame(2).is_none());
        let names = |transform: &TransformStamped| {
            (transform.header.frame_id.clone(), transform.child_frame_id.clone())
        };
        let mounted: Vec<_> = sensors.mounting(Time::default()).iter().map(names).collect();
        let expected = [("imu_link", "left"), ("imu_link", "cam1")];
        assert_eq!(mounted, expected.map(|(parent, child)| (parent.to_owned(), child.to_owned())));
    }
}
