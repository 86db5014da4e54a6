//! Which cameras of a rig belong together: stereo pairs where two see the same, else single cameras.

use crate::{Camera, Pose};
use nalgebra::Vector2;

/// Distance at which it is looked whether two cameras see the same, metres.
const DISTANCE_M: f64 = 5.0;
/// Two cameras are a stereo pair where one of them sees at least this share of what the other sees. With less in common, each finds
/// more points on its own.
const LEAST_SHARE: f64 = 0.5;
/// Pixels in a row and in a column of the grid that is looked at.
const GRID: u32 = 16;

/// A stereo pair, or a single camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CameraGroup {
    /// Index of the camera, of a pair that of the camera in which points are found.
    pub first: usize,
    /// Index of the other camera of a pair.
    pub second: Option<usize>,
}

impl CameraGroup {
    /// The cameras of the group, the first one first.
    pub fn cameras(&self) -> impl Iterator<Item = usize> {
        [Some(self.first), self.second].into_iter().flatten()
    }
}

/// The groups of a rig, in the order of their first cameras. Every camera is in one of them.
///
/// A camera makes a pair with the later one that it has most in common with, if that is at least half of what one of them sees.
///
/// # Arguments
/// * `cameras`: projections, and poses in a common frame (`imu_from_camera`).
///
/// # Example
/// ```
/// use geometry::{Camera, CameraGroup, Distortion, Pose, camera_groups};
/// use nalgebra::{UnitQuaternion, Vector3};
///
/// let camera = Camera {
///     width: 640, height: 480, focal: [400.0; 2], centre: [320.0, 240.0], distortion: Distortion::None,
/// };
/// let at = |x_m: f64, turned_rad: f64| {
///     Pose::new(UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turned_rad), Vector3::x() * x_m)
/// };
/// let pair_and_one_behind = [at(0.0, 0.0), at(0.1, 0.0), at(0.0, 3.1)];
/// let expected = [CameraGroup { first: 0, second: Some(1) }, CameraGroup { first: 2, second: None }];
/// assert_eq!(camera_groups(pair_and_one_behind.iter().map(|pose| (&camera, pose))), expected);
/// ```
pub fn camera_groups<'a>(cameras: impl IntoIterator<Item = (&'a Camera, &'a Pose)>) -> Vec<CameraGroup> {
    let cameras: Vec<(&Camera, &Pose)> = cameras.into_iter().collect();
    let mut is_grouped = vec![false; cameras.len()];
    let mut groups = Vec::new();
    for first in 0..cameras.len() {
        if is_grouped[first] {
            continue;
        }
        let in_common = |second: &usize| {
            let (one, other) = (cameras[first], cameras[*second]);
            share_seen(one, other).max(share_seen(other, one))
        };
        let second = (first + 1..cameras.len())
            .filter(|second| !is_grouped[*second])
            .map(|second| (second, in_common(&second)))
            .filter(|(_, share)| *share >= LEAST_SHARE)
            // Of equal ones the first.
            .min_by(|a, b| b.1.total_cmp(&a.1))
            .map(|(second, _)| second);
        let group = CameraGroup { first, second };
        group.cameras().for_each(|camera| is_grouped[camera] = true);
        groups.push(group);
    }
    groups
}

/// The share of the pixels of a camera whose points at [`DISTANCE_M`] another one sees.
fn share_seen(
    (camera, frame_from_camera): (&Camera, &Pose),
    (other, frame_from_other): (&Camera, &Pose),
) -> f64 {
    let other_from_camera = frame_from_other.inverse() * *frame_from_camera;
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let centre_of = |cell: u32, size: f64| (f64::from(cell) + 0.5) / f64::from(GRID) * size;
    let cells = (0..GRID).flat_map(|row| (0..GRID).map(move |column| (column, row)));
    let (mut seen, mut all) = (0, 0);
    for (column, row) in cells {
        let pixel = Vector2::new(centre_of(column, width), centre_of(row, height));
        let Ok(ray) = camera.bearing(&pixel) else { continue };
        all += 1;
        let point = other_from_camera.transform(&(ray.into_inner() * DISTANCE_M));
        seen += u32::from(other.project(&point).is_ok_and(|pixel| other.contains(&pixel)));
    }
    f64::from(seen) / f64::from(all.max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Distortion;
    use nalgebra::{UnitQuaternion, Vector3};
    use std::f64::consts::PI;

    /// A camera of 90 degrees at `x_m` to the right, turned to the right.
    fn at(x_m: f64, turned_degrees: f64) -> (Camera, Pose) {
        let camera = Camera {
            width: 640,
            height: 480,
            focal: [320.0; 2],
            centre: [320.0, 240.0],
            distortion: Distortion::None,
        };
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turned_degrees * PI / 180.0);
        (camera, Pose::new(rotation, Vector3::x() * x_m))
    }

    fn groups(cameras: &[(Camera, Pose)]) -> Vec<(usize, Option<usize>)> {
        let groups = camera_groups(cameras.iter().map(|(camera, pose)| (camera, pose)));
        groups.iter().map(|group| (group.first, group.second)).collect()
    }

    #[test]
    fn cameras_that_see_the_same_are_pairs_and_the_others_are_alone() {
        for (name, cameras, expected) in [
            ("none", vec![], vec![]),
            ("one", vec![at(0.0, 0.0)], vec![(0, None)]),
            ("stereo", vec![at(0.0, 0.0), at(0.1, 0.0)], vec![(0, Some(1))]),
            (
                "surround",
                (0..4).map(|k| at(0.0, 90.0 * f64::from(k))).collect(),
                (0..4).map(|k| (k, None)).collect(),
            ),
            (
                "five, which overlap by a fifth",
                (0..5).map(|k| at(0.0, 72.0 * f64::from(k))).collect(),
                (0..5).map(|k| (k, None)).collect(),
            ),
            (
                "two pairs, interleaved",
                vec![at(0.0, 0.0), at(0.0, 180.0), at(0.1, 0.0), at(0.1, 180.0)],
                vec![(0, Some(2)), (1, Some(3))],
            ),
            (
                "of three the two that are most alike",
                vec![at(0.0, 0.0), at(0.1, 30.0), at(0.2, 2.0)],
                vec![(0, Some(2)), (1, None)],
            ),
        ] {
            assert_eq!(groups(&cameras), expected, "{name}");
        }
    }

    #[test]
    fn a_narrow_camera_and_a_wide_one_are_a_pair_in_either_order() {
        let mut narrow = at(0.1, 0.0);
        narrow.0.focal = [960.0; 2];
        assert_eq!(groups(&[at(0.0, 0.0), narrow.clone()]), [(0, Some(1))]);
        assert_eq!(groups(&[narrow, at(0.0, 0.0)]), [(0, Some(1))]);
    }
}
