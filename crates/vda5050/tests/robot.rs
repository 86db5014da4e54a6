//! What a robot publishes.

use geometry::{Pose, PoseWithCovariance, rotation};
use nalgebra::{Matrix6, Vector3};
use protocol::{MapIdentity, RobotOdometry, RobotPose, RobotState, RobotStatus};

/// A pose with 3 cm and 4 cm of standard deviation in x and y.
pub fn pose(stamp_ns: i64, x: f64, yaw: f64) -> RobotPose {
    let sigmas = [0.01, 0.01, 0.02, 0.03, 0.04, 0.05];
    let covariance = Matrix6::from_diagonal(&sigmas.map(|sigma: f64| sigma * sigma).into());
    let rotation = rotation::exp(&Vector3::new(0.0, 0.0, yaw));
    let known = PoseWithCovariance::new(Pose::new(rotation, Vector3::new(x, -2.0, 0.4)), covariance);
    RobotPose {
        stamp_ns,
        map: "hall".to_owned(),
        map_version: 3,
        map_identity: MapIdentity::from_bytes([7; 16]),
        global_from_imu: known,
        global_from_local: known,
    }
}

/// 1 m/s along y of the odometry frame, and 0.5 rad/s.
pub fn odometry(stamp_ns: i64, yaw: f64) -> RobotOdometry {
    RobotOdometry {
        stamp_ns,
        local_from_imu: pose(stamp_ns, 0.0, yaw).global_from_imu,
        velocity_in_local: [0.0, 1.0, 0.0],
        angular_velocity_in_imu: [0.0, 0.0, 0.5],
    }
}

pub fn status(state: RobotState) -> RobotStatus {
    RobotStatus {
        stamp_ns: 5,
        state,
        reason: "a test".to_owned(),
        map: Some("hall".to_owned()),
        last_map_update_ns: None,
        keyframes_held: 0,
        queries_sent: 0,
        queries_answered: 0,
    }
}
