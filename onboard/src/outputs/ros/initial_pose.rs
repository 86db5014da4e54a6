//! The topic on which an operator sets the robot's pose in the map.

use super::settings::{RosBody, RosSettings};
use geometry::{Pose, PoseWithCovariance};
use nalgebra::{Matrix6, Vector3};
use robot::initial_pose::{InitialPoseError, InitialPoses, rotation_of};
use ros_messages::geometry_msgs::PoseWithCovarianceStamped;
use ros2::{Node, Qos, RosError, Subscriber};

/// Poses that wait; only the newest counts.
const QUEUE: usize = 1;

/// The subscription.
pub(super) struct InitialPoseSubscription {
    received: Subscriber<PoseWithCovarianceStamped>,
    poses: InitialPoses,
    body: RosBody,
}

impl InitialPoseSubscription {
    /// Subscribes, where that is wanted.
    pub(super) async fn announce(node: &Node, settings: &RosSettings) -> Result<Option<Self>, RosError> {
        let Some(wanted) = &settings.initial_pose else { return Ok(None) };
        let received = node.subscriber(&wanted.topic, Qos::reliable(), QUEUE).await?;
        Ok(Some(Self { received, poses: wanted.poses.clone(), body: settings.body.clone() }))
    }
}

/// Waits for a pose and hands it on; for ever without a subscription.
pub(super) async fn next_initial_pose(topic: Option<&InitialPoseSubscription>) -> Result<(), RosError> {
    let Some(topic) = topic else { return std::future::pending().await };
    let pose = match topic.received.receive().await?.message {
        Ok(message) => map_from_base(&topic.body.frames.map, &message),
        Err(error) => Err(InitialPoseError::Unreadable(error.to_string())),
    };
    match pose {
        // The run reports what is wrong with it.
        Ok(pose) => drop(topic.poses.set(pose, &topic.body.mount.imu_from_base().inverse())),
        Err(error) => topic.poses.refuse(error),
    }
    Ok(())
}

/// The pose that a message states.
pub(super) fn map_from_base(
    map: &str,
    message: &PoseWithCovarianceStamped,
) -> Result<PoseWithCovariance, InitialPoseError> {
    let given = &message.header.frame_id;
    if given != map {
        return Err(InitialPoseError::Frame { given: given.clone(), wanted: map.to_owned() });
    }
    let position = Vector3::from(<[f64; 3]>::from(message.pose.pose.position));
    let orientation = message.pose.pose.orientation;
    let rotation = rotation_of([orientation.x, orientation.y, orientation.z, orientation.w])?;
    // ROS writes the position first.
    let ros = &message.pose.covariance;
    let covariance = Matrix6::from_fn(|row, column| ros[(row + 3) % 6 * 6 + (column + 3) % 6]);
    Ok(PoseWithCovariance::new(Pose::new(rotation, position), covariance))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::covariance_check::CovarianceError;
    use ros_messages::geometry_msgs::Quaternion;
    use ros_messages::std_msgs::Header;

    /// What RViz sends: a pose in the plane.
    pub fn of_rviz() -> PoseWithCovarianceStamped {
        let mut message = PoseWithCovarianceStamped {
            header: Header { frame_id: "map".to_owned(), ..Header::default() },
            ..PoseWithCovarianceStamped::default()
        };
        message.pose.pose.position = [3.0, -2.0, 0.0].into();
        message.pose.pose.orientation = Quaternion { x: 0.0, y: 0.0, z: 0.6, w: 0.8 };
        for (index, variance) in [(0, 0.25), (7, 0.25), (35, 0.068_538_9)] {
            message.pose.covariance[index] = variance;
        }
        message
    }

    fn set(message: &PoseWithCovarianceStamped) -> Result<(), InitialPoseError> {
        let body_from_imu = Pose::new(geometry::rotation::exp(&Vector3::z()), Vector3::new(0.1, 0.0, 0.4));
        InitialPoses::default().set(map_from_base("map", message)?, &body_from_imu)
    }

    #[test]
    fn a_pose_in_the_plane_is_taken_with_its_covariance() {
        let pose = map_from_base("map", &of_rviz()).unwrap();
        assert_eq!(pose.pose.translation, Vector3::new(3.0, -2.0, 0.0));
        assert!((pose.pose.rotation.angle() - 2.0 * 0.6_f64.asin()).abs() < 1e-12);
        let expected = [0.0, 0.0, 0.068_538_9, 0.25, 0.25, 0.0];
        assert_eq!(pose.covariance.diagonal().as_slice(), expected);
        assert_eq!(set(&of_rviz()), Ok(()));
    }

    #[test]
    fn a_quaternion_of_another_length_is_normalized() {
        let mut message = of_rviz();
        message.pose.pose.orientation = Quaternion { x: 0.0, y: 0.0, z: 6.0, w: 8.0 };
        let (scaled, plain) =
            (map_from_base("map", &message).unwrap(), map_from_base("map", &of_rviz()).unwrap());
        assert!(scaled.pose.local(&plain.pose).norm() < 1e-12);
    }

    #[test]
    fn what_is_wrong_with_a_pose_is_named() {
        let refused = |change: &dyn Fn(&mut PoseWithCovarianceStamped)| {
            let mut message = of_rviz();
            change(&mut message);
            set(&message).unwrap_err()
        };
        let other = refused(&|message| message.header.frame_id = "odom".to_owned());
        assert!(other.to_string().contains("\"odom\"") && other.to_string().contains("\"map\""), "{other}");
        let zeros = Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.0 };
        let none = refused(&|message| message.pose.pose.orientation = zeros);
        assert_eq!(none, InitialPoseError::NoRotation { norm: 0.0 });
        for broken in [f64::NAN, f64::INFINITY] {
            assert_eq!(
                refused(&|message| message.pose.pose.position.y = broken),
                InitialPoseError::NotFinite
            );
            assert_eq!(
                refused(&|message| message.pose.pose.orientation.x = broken),
                InitialPoseError::NotFinite
            );
            let covariance = refused(&|message| message.pose.covariance[35] = broken);
            assert_eq!(covariance, InitialPoseError::Covariance(CovarianceError::NotFinite));
        }
        assert_eq!(refused(&|message| message.pose.pose.position.x = 1e12), InitialPoseError::Far);
        assert_eq!(refused(&|message| message.pose.covariance = [0.0; 36]), InitialPoseError::Exact("x"));
        assert_eq!(refused(&|message| message.pose.covariance[35] = 0.0), InitialPoseError::Exact("heading"));
        let negative = refused(&|message| message.pose.covariance[0] = -0.25);
        assert!(matches!(negative, InitialPoseError::Covariance(CovarianceError::NegativeVariance { .. })));
        let too_correlated = refused(&|message| {
            (message.pose.covariance[1], message.pose.covariance[6]) = (0.3, 0.3);
        });
        assert!(too_correlated.to_string().contains("negative eigenvalue"), "{too_correlated}");
    }
}
