//! The odometry frame of ROS, which outlives the one of the estimator.

use geometry::{Pose, rotation};
use nalgebra::Vector3;

/// The frame `odom`, in which the robot never jumps (REP-105).
///
/// It is the estimator's L, until the estimator is initialized again: its new L has another origin and yaw, and `odom` is
/// placed so that the robot is where it was last. Both have z up, so only yaw and translation differ.
#[derive(Clone, Debug, Default)]
pub struct OdomFrame {
    odom_from_local: Option<Pose>,
    last_odom_from_base: Option<Pose>,
}

impl OdomFrame {
    /// The estimator is lost; the next L is another one.
    pub fn restart(&mut self) {
        self.odom_from_local = None;
    }

    /// The pose of L in `odom`.
    ///
    /// # Arguments
    /// * `local_from_base`: pose of the robot now.
    pub fn update(&mut self, local_from_base: &Pose) -> Pose {
        let odom_from_local = match (self.odom_from_local, self.last_odom_from_base) {
            (Some(odom_from_local), _) => odom_from_local,
            (None, Some(last)) => with_yaw_of(&last, local_from_base),
            (None, None) => Pose::identity(),
        };
        self.odom_from_local = Some(odom_from_local);
        self.last_odom_from_base = Some(odom_from_local * *local_from_base);
        odom_from_local
    }
}

/// The transformation about z that takes `pose` to the position and heading of `goal`.
fn with_yaw_of(goal: &Pose, pose: &Pose) -> Pose {
    let turn = (goal.rotation * pose.rotation.inverse()).scaled_axis();
    let rotation = rotation::exp(&Vector3::new(0.0, 0.0, turn.z));
    Pose::new(rotation, goal.translation - rotation * pose.translation)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f64, yaw: f64) -> Pose {
        Pose::new(rotation::exp(&Vector3::new(0.0, 0.0, yaw)), Vector3::new(x, 0.0, 0.5))
    }

    #[test]
    fn the_robot_stays_where_it_was_when_the_estimator_restarts() {
        let mut odom = OdomFrame::default();
        assert_eq!(odom.update(&pose(1.0, 0.2)), Pose::identity());
        let last = pose(2.0, 0.9);
        assert_eq!(odom.update(&last), Pose::identity());
        odom.restart();
        let odom_from_local = odom.update(&Pose::identity());
        let robot = odom_from_local * Pose::identity();
        assert!((robot.translation - last.translation).norm() < 1e-12);
        assert!(robot.rotation.angle_to(&last.rotation) < 1e-12);
        // From there on it moves as the estimator says.
        assert_eq!(odom.update(&pose(3.0, 0.1)), odom_from_local);
    }
}
