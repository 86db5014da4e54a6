//! Where the robot was in the map.

use nalgebra::Vector3;
use ros_messages::geometry_msgs::{Pose, PoseStamped, PoseWithCovarianceStamped};
use ros_messages::nav_msgs::Path;

/// Most poses of a path. When it is full every second one is left out, and from then on they are twice as far apart.
const MAX_POSES: usize = 2000;
/// Poses are so far apart at first, metres; or so much turned, radians.
const SPACING_M: f64 = 0.05;
const SPACING_RAD: f64 = 0.2;

/// The path of a robot in its map, from its first pose there.
#[derive(Clone, Debug)]
pub struct DrivenPath {
    path: Path,
    spacing_m: f64,
    has_changed: bool,
}

impl Default for DrivenPath {
    fn default() -> Self {
        Self { path: Path::default(), spacing_m: SPACING_M, has_changed: false }
    }
}

impl DrivenPath {
    /// Adds a pose, where the robot has moved since the last one.
    pub fn add(&mut self, pose: &PoseWithCovarianceStamped) {
        let new = PoseStamped { header: pose.header.clone(), pose: pose.pose.pose };
        let is_near = |last: &PoseStamped| {
            let (distance_m, turned_rad) = moved(&last.pose, &new.pose);
            distance_m < self.spacing_m && turned_rad < SPACING_RAD * self.spacing_m / SPACING_M
        };
        if self.path.poses.last().is_some_and(is_near) {
            return;
        }
        self.path.header = new.header.clone();
        self.path.poses.push(new);
        self.has_changed = true;
        if self.path.poses.len() >= MAX_POSES {
            let mut at = 0;
            self.path.poses.retain(|_| {
                at += 1;
                at % 2 == 1
            });
            self.spacing_m *= 2.0;
        }
    }

    /// The path, if it has changed since it was last asked for.
    pub fn changed(&mut self) -> Option<&Path> {
        std::mem::take(&mut self.has_changed).then_some(&self.path)
    }
}

/// Metres and radians between two poses.
fn moved(from: &Pose, to: &Pose) -> (f64, f64) {
    let position = |pose: &Pose| Vector3::from(<[f64; 3]>::from(pose.position));
    let (one, other) = (from.orientation, to.orientation);
    let cosine_of_half = (one.x * other.x + one.y * other.y + one.z * other.z + one.w * other.w).abs();
    ((position(to) - position(from)).norm(), 2.0 * cosine_of_half.min(1.0).acos())
}

#[cfg(test)]
mod tests {
    use super::*;
    use ros_messages::geometry_msgs::Quaternion;
    use ros_messages::std_msgs::Header;

    fn pose(x: f64, yaw: f64) -> PoseWithCovarianceStamped {
        let header = Header::new((x * 1e9) as i64, "map").unwrap();
        let mut pose = PoseWithCovarianceStamped { header, ..PoseWithCovarianceStamped::default() };
        pose.pose.pose.position.x = x;
        pose.pose.pose.orientation =
            Quaternion { x: 0.0, y: 0.0, z: (yaw / 2.0).sin(), w: (yaw / 2.0).cos() };
        pose
    }

    #[test]
    fn a_robot_that_stands_does_not_change_its_path() {
        let mut path = DrivenPath::default();
        assert!(path.changed().is_none());
        path.add(&pose(1.0, 0.0));
        assert_eq!(path.changed().unwrap().poses.len(), 1);
        path.add(&pose(1.04, 0.1));
        assert!(path.changed().is_none());
        path.add(&pose(1.06, 0.0));
        path.add(&pose(1.06, 0.3));
        let message = path.changed().unwrap();
        assert_eq!((message.poses.len(), message.header.frame_id.as_str()), (3, "map"));
    }

    #[test]
    fn a_long_path_is_thinned_out_from_its_begin_to_its_end() {
        let mut path = DrivenPath::default();
        for step in 0..100_000 {
            path.add(&pose(f64::from(step) * 0.1, 0.0));
        }
        let poses = &path.changed().unwrap().poses;
        assert!(poses.len() < MAX_POSES && poses.len() > MAX_POSES / 4, "{}", poses.len());
        let x: Vec<f64> = poses.iter().map(|pose| pose.pose.position.x).collect();
        assert!(x[0].abs() < 1e-9 && x[x.len() - 1] > 9_980.0, "{x:?}");
        assert!(x.windows(2).all(|pair| pair[1] - pair[0] > 0.0 && pair[1] - pair[0] < 40.0));
    }
}
