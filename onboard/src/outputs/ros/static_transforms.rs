//! Where the sensors are mounted, as transforms that do not change.

use super::settings::RosBody;
use ros_messages::builtin_interfaces::Time;
use ros_messages::tf2_msgs::TFMessage;
use sensors::CameraSensor;
use sensors::ros::{RosSensors, transform_message};

/// `base_link` → IMU where that is known, and IMU → cameras (optical frames: z along the view, x right), as far as the sensors' frames
/// are named.
///
/// # Arguments
/// * `cameras`: their calibration; what a run estimates of it is not published.
pub fn static_transforms(body: &RosBody, cameras: &[CameraSensor], stamp: Time) -> TFMessage {
    complete_transforms(body, &cameras[..body.sensor_frames.published(cameras.len())], stamp)
}

/// As [`static_transforms`], with all cameras on the IMU: those that are not named under the usual names. Where the IMU is on the robot
/// is left to the robot's description if that names the IMU.
pub fn complete_transforms(body: &RosBody, cameras: &[CameraSensor], stamp: Time) -> TFMessage {
    let names = &body.sensor_frames.names;
    let base_from_imu = body.mount.imu_from_base().inverse();
    let imu = names.first().filter(|_| !body.mount.is_assumed());
    let on_robot = imu.map(|imu| transform_message(stamp, &body.frames.base_link, imu, &base_from_imu));
    let of_cameras = RosSensors::new(names, cameras).mounting(stamp);
    TFMessage { transforms: on_robot.into_iter().chain(of_cameras).collect() }
}

#[cfg(test)]
mod tests {
    use super::super::base_mount::BaseMount;
    use super::*;
    use geometry::camera::{Camera, Distortion};
    use geometry::{Pose, rotation};
    use nalgebra::{UnitQuaternion, Vector3};
    use ros_messages::geometry_msgs::{Quaternion, TransformStamped};

    fn pose_of(transform: &TransformStamped) -> Pose {
        let Quaternion { x, y, z, w } = transform.transform.rotation;
        let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
        Pose::new(rotation, <[f64; 3]>::from(transform.transform.translation).into())
    }

    fn camera(imu_from_camera: Pose) -> CameraSensor {
        let camera = Camera {
            width: 640,
            height: 480,
            focal: [400.0; 2],
            centre: [320.0, 240.0],
            distortion: Distortion::None,
        };
        CameraSensor::new(camera, imu_from_camera, 20.0)
    }

    #[test]
    fn the_sensors_hang_on_the_robot_as_they_are_calibrated() {
        let mounted =
            |turn: f64, x: f64| Pose::new(rotation::exp(&(Vector3::y() * turn)), Vector3::new(x, 0.1, 0.2));
        let mount = BaseMount::known(mounted(0.3, -0.4));
        let body = RosBody { mount, ..RosBody::default() };
        let cameras = [camera(mounted(1.0, 0.05)), camera(mounted(1.1, 0.15))];
        let message = static_transforms(&body, &cameras, Time { sec: 5, nanosec: 6 });
        let names: Vec<_> = message
            .transforms
            .iter()
            .map(|transform| (transform.header.frame_id.as_str(), transform.child_frame_id.as_str()))
            .collect();
        assert_eq!(names, [("base_link", "imu"), ("imu", "cam0"), ("imu", "cam1")]);
        let base_from_imu = pose_of(&message.transforms[0]);
        assert!((base_from_imu * body.mount.imu_from_base()).local(&Pose::identity()).norm() < 1e-12);
        for (transform, sensor) in message.transforms[1..].iter().zip(&cameras) {
            assert!(pose_of(transform).local(&sensor.imu_from_camera).norm() < 1e-12);
        }
        assert_eq!(static_transforms(&body, &cameras[..1], Time::default()).transforms.len(), 2);
    }

    #[test]
    fn frames_that_are_not_named_are_not_published() {
        let body = |names: &str| RosBody { sensor_frames: names.parse().unwrap(), ..RosBody::default() };
        let cameras = [camera(Pose::identity())];
        assert_eq!(static_transforms(&body("none"), &cameras, Time::default()), TFMessage::default());
        let imu = static_transforms(&body("imu_link"), &cameras, Time::default());
        assert_eq!(imu.transforms.len(), 1);
        assert_eq!(imu.transforms[0].child_frame_id, "imu_link");
    }
}
