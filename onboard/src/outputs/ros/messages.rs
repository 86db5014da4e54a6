//! Estimates as ROS messages.

use super::odom_frame::OdomFrame;
use super::settings::RosBody;
use estimator::Motion;
use geometry::{Pose, PoseWithCovariance, tilt_beyond_limit_deg};
use nalgebra::{Matrix3, Matrix6, Vector3};
use robot::Estimate;
use ros_messages::builtin_interfaces::Time;
use ros_messages::geometry_msgs::{self, PoseWithCovarianceStamped, Twist, TwistWithCovariance};
use ros_messages::nav_msgs::Odometry;
use ros_messages::std_msgs::Header;
use ros_messages::tf2_msgs::TFMessage;
use sensors::ros::transform_message;

/// The messages of one estimate.
#[derive(Debug, PartialEq)]
pub struct Messages {
    /// odom from base_link.
    pub odometry: Odometry,
    /// map from base_link, once localized.
    pub pose: Option<PoseWithCovarianceStamped>,
    /// odom from base_link, and map from odom once localized.
    pub transforms: TFMessage,
}

/// Makes the messages of an estimate; `None` for a time that ROS cannot write (before 1901, after 2038).
pub fn messages(body: &RosBody, odom: &mut OdomFrame, estimate: &Estimate) -> Option<Messages> {
    let imu_from_base = body.mount.imu_from_base();
    let local_from_base = estimate.motion.state.local_from_imu * imu_from_base;
    let odom_from_local = odom.update(&local_from_base);
    let odometry = odometry(body, &odom_from_local, &estimate.motion)?;
    let stamp = odometry.header.stamp;
    let frames = &body.frames;
    let mut transforms = vec![transform_message(
        stamp,
        &frames.odom,
        &frames.base_link,
        &(odom_from_local.pose * local_from_base),
    )];
    if let Some(global) = estimate.trusted() {
        let map_from_odom = global.global_from_local.pose * odom_from_local.pose.inverse();
        transforms.push(transform_message(stamp, &frames.map, &frames.odom, &map_from_odom));
    }
    Some(Messages {
        odometry,
        pose: estimate.trusted().map(|global| PoseWithCovarianceStamped {
            header: Header { stamp, frame_id: frames.map.clone() },
            pose: pose(&global.global_from_imu.change_of_child(&imu_from_base)),
        }),
        transforms: TFMessage { transforms },
    })
}

/// Angle between the z axis of the map and the vertical, degrees, where x, y and yaw in the map are not those on the floor; `None` while
/// not localized.
pub fn map_tilt_deg(estimate: &Estimate) -> Option<f64> {
    // z of L is up.
    tilt_beyond_limit_deg(&(estimate.trusted()?.global_from_local.pose.rotation * Vector3::z()))
}

/// Pose and velocities of the robot in `odom`; `None` for a time that ROS cannot write.
pub fn odometry(body: &RosBody, odom_from_local: &PoseWithCovariance, motion: &Motion) -> Option<Odometry> {
    let stamp = Time::from_nanoseconds(motion.stamp_ns)?;
    let imu_from_base = body.mount.imu_from_base();
    let local_from_base = motion.local_from_imu().change_of_child(&imu_from_base);
    Some(Odometry {
        header: Header { stamp, frame_id: body.frames.odom.clone() },
        child_frame_id: body.frames.base_link.clone(),
        pose: pose(&odom_from_local.compose(&local_from_base)),
        twist: twist(&imu_from_base, motion),
    })
}

/// Velocities of the robot's frame in itself.
fn twist(imu_from_base: &Pose, motion: &Motion) -> TwistWithCovariance {
    let angular_in_imu = motion.angular_velocity;
    let imu_from_local = motion.state.local_from_imu.rotation.inverse();
    let point = &imu_from_base.translation;
    let linear_in_imu = imu_from_local * motion.state.velocity + angular_in_imu.cross(point);
    let base_from_imu = imu_from_base.rotation.inverse();
    let axes: Matrix3<f64> = base_from_imu.to_rotation_matrix().into_inner();
    let mut turn = Matrix6::zeros();
    turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&axes);
    turn.fixed_view_mut::<3, 3>(3, 3).copy_from(&axes);
    let covariance = turn * motion.twist_covariance(point) * turn.transpose();
    TwistWithCovariance {
        twist: Twist {
            linear: vector(&(base_from_imu * linear_in_imu)),
            angular: vector(&(base_from_imu * angular_in_imu)),
        },
        covariance: std::array::from_fn(|at| covariance[(at / 6, at % 6)]),
    }
}

fn vector(vector: &Vector3<f64>) -> geometry_msgs::Vector3 {
    geometry_msgs::Vector3 { x: vector.x, y: vector.y, z: vector.z }
}

fn quaternion(pose: &Pose) -> geometry_msgs::Quaternion {
    let [x, y, z, w] = pose.rotation.coords.into();
    geometry_msgs::Quaternion { x, y, z, w }
}

/// Both conventions take the error in the parent frame about fixed axes; ROS writes the position first.
fn pose(pose: &PoseWithCovariance) -> geometry_msgs::PoseWithCovariance {
    let rotation_first: &Matrix6<f64> = &pose.covariance;
    let covariance = std::array::from_fn(|at| rotation_first[((at / 6 + 3) % 6, (at % 6 + 3) % 6)]);
    let (position, orientation) = (vector(&pose.pose.translation), quaternion(&pose.pose));
    geometry_msgs::PoseWithCovariance { pose: geometry_msgs::Pose { position, orientation }, covariance }
}
