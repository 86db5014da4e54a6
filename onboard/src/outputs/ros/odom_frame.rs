//! The odometry frame of ROS, which outlives the one of the estimator.

use geometry::{Pose, PoseWithCovariance, rotation};
use nalgebra::{Matrix6, Vector3};

/// The frame `odom`, in which the robot never jumps (REP-105).
///
/// It is the estimator's L until the map or GNSS corrects the pose in L, or the estimator is initialized again: its new L
/// has another origin and yaw. `odom` is then placed so that the robot stays where it was. Both have z up, so only yaw and
/// translation differ.
#[derive(Clone, Debug, Default)]
pub struct OdomFrame {
    /// With the corrections that `odom` does not show as its error, in the axes of `odom`.
    odom_from_local: Option<PoseWithCovariance>,
    /// Of the robot before the estimator was lost.
    last_odom_from_base: Option<Pose>,
    last_covariance: Matrix6<f64>,
}

impl OdomFrame {
    /// The estimator is lost; the next L is another one.
    pub fn restart(&mut self) {
        self.odom_from_local = None;
    }

    /// The map or GNSS corrected the pose of the IMU in L, at one time. What that took from its uncertainty stays in `odom`.
    pub fn correct(&mut self, before: &PoseWithCovariance, after: &PoseWithCovariance) {
        let Some(old) = self.odom_from_local else { return };
        if before.pose == after.pose {
            return;
        }
        let pose = old.pose * with_yaw_of(&before.pose, &after.pose);
        let gained = before.change_of_parent(&old.pose).covariance - after.change_of_parent(&pose).covariance;
        // Errors of `odom` as they move the robot, which has a lever about the origin of L.
        let [old_lever, lever] = [(&old.pose, &before.pose), (&pose, &after.pose)]
            .map(|(odom_from_local, local)| odom_from_local.rotation * local.translation);
        let of_robot = turned_about(&-old_lever, &old.covariance) + positive_part(&gained);
        let covariance = turned_about(&lever, &of_robot);
        self.odom_from_local = Some(PoseWithCovariance { pose, covariance });
    }

    /// The pose of L in `odom` at the last update; `None` before the first of an initialization.
    pub fn newest(&self) -> Option<PoseWithCovariance> {
        self.odom_from_local
    }

    /// The pose of L in `odom`.
    ///
    /// # Arguments
    /// * `local_from_base`: pose of the robot now.
    pub fn update(&mut self, local_from_base: &Pose) -> PoseWithCovariance {
        let odom_from_local = match (self.odom_from_local, self.last_odom_from_base) {
            (Some(odom_from_local), _) => odom_from_local,
            (None, Some(last)) => {
                PoseWithCovariance::new(with_yaw_of(&last, local_from_base), self.last_covariance)
            }
            (None, None) => PoseWithCovariance::exact(Pose::identity()),
        };
        self.odom_from_local = Some(odom_from_local);
        self.last_odom_from_base = Some(odom_from_local.pose * *local_from_base);
        self.last_covariance = odom_from_local.covariance;
        odom_from_local
    }
}

/// The transformation about z that takes `pose` to the position and heading of `goal`.
fn with_yaw_of(goal: &Pose, pose: &Pose) -> Pose {
    let turn = (goal.rotation * pose.rotation.inverse()).scaled_axis();
    let rotation = rotation::exp(&Vector3::new(0.0, 0.0, turn.z));
    Pose::new(rotation, goal.translation - rotation * pose.translation)
}

/// The covariance of an error `[δθ, δp]` of a point, seen at the origin of a lever to it.
fn turned_about(lever: &Vector3<f64>, covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let mut by_point = Matrix6::identity();
    by_point.fixed_view_mut::<3, 3>(3, 0).copy_from(&rotation::skew(lever));
    by_point * covariance * by_point.transpose()
}

/// The nearest covariance: an update that re-linearizes need not reduce every direction.
fn positive_part(symmetric: &Matrix6<f64>) -> Matrix6<f64> {
    let mut eigen = symmetric.symmetric_eigen();
    eigen.eigenvalues.apply(|value| *value = value.max(0.0));
    eigen.recompose()
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
        assert_eq!(odom.update(&pose(1.0, 0.2)).pose, Pose::identity());
        let last = pose(2.0, 0.9);
        assert_eq!(odom.update(&last).pose, Pose::identity());
        odom.restart();
        let odom_from_local = odom.update(&Pose::identity());
        let robot = odom_from_local.pose * Pose::identity();
        assert!((robot.translation - last.translation).norm() < 1e-12);
        assert!(robot.rotation.angle_to(&last.rotation) < 1e-12);
        // From there on it moves as the estimator says.
        assert_eq!(odom.update(&pose(3.0, 0.1)), odom_from_local);
    }

    #[test]
    fn a_correction_by_the_map_moves_neither_the_robot_nor_its_uncertainty() {
        let mut odom = OdomFrame::default();
        let level = |x: f64, yaw: f64, scale: f64| {
            let diagonal = [0.01, 0.01, 0.04, 0.5, 0.6, 0.2].map(|sigma: f64| sigma * scale);
            PoseWithCovariance::new(pose(x, yaw), Matrix6::from_diagonal(&diagonal.into()))
        };
        let mut before = level(40.0, 0.3, 1.0);
        odom.update(&before.pose);
        for (x, yaw, scale) in [(38.5, 0.25, 0.4), (39.0, 0.5, 0.1)] {
            let in_odom = odom.update(&before.pose).compose(&before);
            let after = level(x, yaw, scale);
            odom.correct(&before, &after);
            let corrected = odom.update(&after.pose).compose(&after);
            assert!(
                in_odom.pose.local(&corrected.pose).norm() < 1e-9,
                "{:?} {:?}",
                in_odom.pose,
                corrected.pose
            );
            let difference = in_odom.covariance - corrected.covariance;
            assert!(difference.amax() < 1e-9, "{difference}");
            before = after;
        }
    }
}
