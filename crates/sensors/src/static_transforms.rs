//! Where the sensors of a robot are mounted, by its `/tf_static`.

use geometry::pose::Pose;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use ros_messages::geometry_msgs::Transform;
use ros_messages::tf2_msgs::TFMessage;
use std::collections::BTreeMap;

/// A quaternion whose norm is so near to one is taken with all its digits: that of a rotation which was written as it is.
const WRITTEN_NORM: f64 = 1e-15;

/// The transforms that do not change: of each frame its parent, and `parent_from_frame`. The newest counts.
///
/// ```
/// use geometry::Pose;
/// use ros_messages::{builtin_interfaces::Time, tf2_msgs::TFMessage};
/// use sensors::ros::{StaticTransforms, transform_message};
///
/// let transform = transform_message(Time::default(), "base_link", "imu", &Pose::identity());
/// let mut transforms = StaticTransforms::default();
/// transforms.add(&TFMessage { transforms: vec![transform] });
/// assert_eq!(transforms.between("imu", "base_link"), Some(Pose::identity()));
/// assert_eq!(transforms.between("imu", "cam0"), None);
/// ```
#[derive(Clone, Debug, Default)]
pub struct StaticTransforms(BTreeMap<String, (String, Pose)>);

impl StaticTransforms {
    /// Takes what a message states; what is no transform is left out.
    pub fn add(&mut self, message: &TFMessage) {
        for stamped in &message.transforms {
            let Some(parent_from_frame) = pose_of(&stamped.transform) else { continue };
            let parent = name(&stamped.header.frame_id).to_owned();
            let frame = name(&stamped.child_frame_id).to_owned();
            self.0.insert(frame, (parent, parent_from_frame));
        }
    }

    /// Where the robot is on its IMU: `imu_from_base`; `None` where that is not known, or is the place of no sensor.
    pub fn imu_from_base(&self, imu: &str, base: &str) -> Option<Pose> {
        self.between(imu, base).filter(|imu_from_base| geometry::check_mount(imu_from_base).is_ok())
    }

    /// `a_from_b`, by the nearest frame that both are mounted on; `None` where there is none, and for names that say nothing:
    /// those of one frame, and empty ones.
    pub fn between(&self, a: &str, b: &str) -> Option<Pose> {
        let (a, b) = (name(a), name(b));
        if a.is_empty() || b.is_empty() || a == b {
            return None;
        }
        let (above_a, above_b) = (self.above(a), self.above(b));
        above_a.iter().find_map(|(frame, frame_from_a)| {
            let (_, frame_from_b) = above_b.iter().find(|(other, _)| other == frame)?;
            Some(frame_from_a.inverse() * *frame_from_b)
        })
    }

    /// A frame and all that it is mounted on, each with its pose in that: `ancestor_from_frame`.
    fn above<'a>(&'a self, frame: &'a str) -> Vec<(&'a str, Pose)> {
        let mut found = vec![(frame, Pose::identity())];
        let (mut at, mut at_from_frame) = (frame, Pose::identity());
        // Frames that are mounted on each other have no end.
        while found.len() <= self.0.len()
            && let Some((parent, parent_from_at)) = self.0.get(at)
        {
            (at, at_from_frame) = (parent, *parent_from_at * at_from_frame);
            found.push((at, at_from_frame));
        }
        found
    }
}

/// tf2 knows no `/` before a name; older recordings have it.
fn name(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

/// The pose that a transform states; `None` for numbers that are no pose.
fn pose_of(transform: &Transform) -> Option<Pose> {
    let translation = Vector3::from(<[f64; 3]>::from(transform.translation));
    let ros_messages::geometry_msgs::Quaternion { x, y, z, w } = transform.rotation;
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    if !(norm.is_finite() && norm > 0.0 && translation.iter().all(|value| value.is_finite())) {
        return None;
    }
    let rotation = if (norm - 1.0).abs() < WRITTEN_NORM {
        UnitQuaternion::new_unchecked(quaternion)
    } else {
        UnitQuaternion::new_normalize(quaternion)
    };
    Some(Pose::new(rotation, translation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::rotation;

    fn pose(turn: f64, x: f64) -> Pose {
        Pose::new(rotation::exp(&Vector3::new(turn, 0.3, -turn)), Vector3::new(x, 0.1, 0.2))
    }

    fn tree(transforms: &[(&str, &str, Pose)]) -> StaticTransforms {
        let entry =
            |(parent, frame, pose): &(&str, &str, Pose)| ((*frame).to_owned(), ((*parent).to_owned(), *pose));
        StaticTransforms(transforms.iter().map(entry).collect())
    }

    #[test]
    fn frames_are_related_by_what_both_are_mounted_on() {
        let (base_from_imu, base_from_plate, plate_from_camera) =
            (pose(0.2, 1.0), pose(-0.7, 2.0), pose(1.0, 0.5));
        let transforms = tree(&[
            ("base_link", "imu", base_from_imu),
            ("base_link", "plate", base_from_plate),
            ("plate", "cam0", plate_from_camera),
        ]);
        let expected = base_from_imu.inverse() * base_from_plate * plate_from_camera;
        let found = transforms.between("imu", "/cam0").unwrap();
        assert!(found.local(&expected).norm() < 1e-12);
        let back = transforms.between("cam0", "imu").unwrap();
        assert!((found * back).local(&Pose::identity()).norm() < 1e-12);
        // A camera on the IMU itself has the pose that was written, to the last digit.
        assert_eq!(transforms.between("plate", "cam0"), Some(plate_from_camera));
        // Drivers that name no frames, or one for all, do not say where the camera is.
        for (imu, camera) in [("imu", "cam1"), ("", ""), ("imu", "/imu"), ("", "cam0")] {
            assert_eq!(transforms.between(imu, camera), None, "{imu} {camera}");
        }
    }

    #[test]
    fn frames_that_are_mounted_on_each_other_end() {
        let transforms = tree(&[("a", "b", pose(0.1, 0.0)), ("b", "a", pose(0.2, 0.0))]);
        assert_eq!(transforms.between("a", "c"), None);
    }

    #[test]
    fn what_is_no_pose_is_left_out() {
        let good = Transform::default();
        assert!(pose_of(&good).is_some());
        let mut zeros = good;
        zeros.rotation.w = 0.0;
        assert_eq!(pose_of(&zeros), None);
        let mut endless = good;
        endless.translation.y = f64::INFINITY;
        assert_eq!(pose_of(&endless), None);
        let mut rounded = good;
        (rounded.rotation.w, rounded.rotation.x) = (0.6, 0.8 + 1e-4);
        assert!((pose_of(&rounded).unwrap().rotation.norm() - 1.0).abs() < 1e-12);
    }
}
