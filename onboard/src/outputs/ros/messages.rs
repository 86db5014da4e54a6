//! Estimates as ROS messages.

use super::odom_frame::OdomFrame;
use super::settings::RosSettings;
use estimator::Estimator;
use geometry::{Pose, PoseWithCovariance};
use nalgebra::{Matrix6, Vector3};
use ros_messages::builtin_interfaces::Time;
use ros_messages::geometry_msgs::{
    self, PoseWithCovarianceStamped, Transform, TransformStamped, Twist, TwistWithCovariance,
};
use ros_messages::nav_msgs::Odometry;
use ros_messages::std_msgs::Header;
use ros_messages::tf2_msgs::TFMessage;

/// Motion of the IMU at one time.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// Pose in L.
    pub local_from_imu: PoseWithCovariance,
    /// Velocity in L, m/s.
    pub velocity_in_local: Vector3<f64>,
    /// Angular velocity in the IMU's frame, rad/s.
    pub angular_velocity_in_imu: Vector3<f64>,
    /// Pose in G and that of L, once localized.
    pub global: Option<GlobalEstimate>,
}

/// An [`Estimate`] in the map.
#[derive(Clone, Debug)]
pub struct GlobalEstimate {
    /// Pose in G.
    pub global_from_imu: PoseWithCovariance,
    /// Pose of L in G.
    pub global_from_local: Pose,
}

impl Estimate {
    /// The estimate of now.
    pub fn of(estimator: &Estimator, angular_velocity_in_imu: Vector3<f64>) -> Self {
        let poses = estimator.global_from_imu().zip(estimator.global_from_local());
        Self {
            stamp_ns: estimator.stamp_ns(),
            local_from_imu: estimator.local_from_imu(),
            velocity_in_local: estimator.velocity(),
            angular_velocity_in_imu,
            global: poses.map(|(global_from_imu, global_from_local)| GlobalEstimate {
                global_from_imu,
                global_from_local: global_from_local.pose,
            }),
        }
    }
}

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
pub fn messages(settings: &RosSettings, odom: &mut OdomFrame, estimate: &Estimate) -> Option<Messages> {
    let stamp = Time::from_nanoseconds(estimate.stamp_ns)?;
    let header = |frame: &String| Header { stamp, frame_id: frame.clone() };
    let frames = &settings.frames;
    let local_from_base = estimate.local_from_imu.change_of_child(&settings.imu_from_base);
    let odom_from_local = odom.update(&local_from_base.pose);
    let odom_from_base = local_from_base.change_of_parent(&odom_from_local);
    let transform = |parent: &String, child: &String, pose: &Pose| TransformStamped {
        header: header(parent),
        child_frame_id: child.clone(),
        transform: Transform { translation: vector(&pose.translation), rotation: quaternion(pose) },
    };
    let mut transforms = vec![transform(&frames.odom, &frames.base_link, &odom_from_base.pose)];
    if let Some(global) = &estimate.global {
        let map_from_odom = global.global_from_local * odom_from_local.inverse();
        transforms.push(transform(&frames.map, &frames.odom, &map_from_odom));
    }
    Some(Messages {
        odometry: Odometry {
            header: header(&frames.odom),
            child_frame_id: frames.base_link.clone(),
            pose: pose(&odom_from_base),
            twist: TwistWithCovariance {
                twist: twist(&settings.imu_from_base, estimate),
                ..Default::default()
            },
        },
        pose: estimate.global.as_ref().map(|global| PoseWithCovarianceStamped {
            header: header(&frames.map),
            pose: pose(&global.global_from_imu.change_of_child(&settings.imu_from_base)),
        }),
        transforms: TFMessage { transforms },
    })
}

/// Velocities of the robot's frame in itself.
fn twist(imu_from_base: &Pose, estimate: &Estimate) -> Twist {
    let angular_in_imu = estimate.angular_velocity_in_imu;
    let imu_from_local = estimate.local_from_imu.pose.rotation.inverse();
    let linear_in_imu =
        imu_from_local * estimate.velocity_in_local + angular_in_imu.cross(&imu_from_base.translation);
    let base_from_imu = imu_from_base.rotation.inverse();
    Twist {
        linear: vector(&(base_from_imu * linear_in_imu)),
        angular: vector(&(base_from_imu * angular_in_imu)),
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
