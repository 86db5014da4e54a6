//! Errors of a map in its own frame, in units of what it states.

use std::collections::BTreeMap;

use evaluation::{Alignment, align};
use geometry::Pose;
use map::MapContents;
use nalgebra::{DMatrix, DVector, Vector3};
use sensors::Sequence;

/// The true poses of camera 0 at the times of images, in the world.
#[derive(Default)]
pub struct Truth(BTreeMap<i64, Pose>);

impl Truth {
    /// Adds those of a session.
    pub fn add(&mut self, session: &Sequence) {
        let imu_from_camera = session.cameras[0].imu_from_camera;
        let rows = session.groundtruth.iter().flatten();
        self.0.extend(rows.map(|row| (row.stamp_ns, row.pose.compose(&imu_from_camera))));
    }

    /// From the world to the frame of a map, which its keyframes define.
    pub fn global_from_world(&self, map: &MapContents) -> Pose {
        let positions: Vec<_> = map
            .keyframes
            .iter()
            .map(|keyframe| {
                (keyframe.global_from_keyframe.pose.translation, self.0[&keyframe.stamp_ns].translation)
            })
            .collect();
        let gravity = -Vector3::z();
        let yaw = Alignment::Yaw { gravity_in_reference: gravity, gravity_in_estimate: gravity };
        align(&positions, &yaw).unwrap()
    }

    /// The squared error of all keyframes together over their joint covariance, a degree of freedom, and the root mean square of the
    /// positions' errors along an axis (m).
    pub fn nees(&self, map: &MapContents, global_from_world: &Pose) -> [f64; 2] {
        let size = 6 * map.keyframes.len();
        let (mut covariance, mut error) = (DMatrix::zeros(size, size), DVector::zeros(size));
        let mut squares = 0.0;
        for (at, keyframe) in map.keyframes.iter().enumerate() {
            let truth = global_from_world.compose(&self.0[&keyframe.stamp_ns]);
            let own = keyframe.global_from_keyframe.pose.local(&truth);
            squares += own.fixed_rows::<3>(3).norm_squared();
            error.fixed_rows_mut::<6>(6 * at).copy_from(&own);
            let stated = &keyframe.global_from_keyframe.covariance;
            covariance.fixed_view_mut::<6, 6>(6 * at, 6 * at).copy_from(stated);
        }
        let at = |id: u64| 6 * map.keyframes.binary_search_by_key(&id, |keyframe| keyframe.id).unwrap();
        assert!(map.common_errors.is_empty());
        for cross in &map.cross_covariances {
            let (a, b) = (at(cross.a), at(cross.b));
            covariance.fixed_view_mut::<6, 6>(a, b).copy_from(&cross.block);
            covariance.fixed_view_mut::<6, 6>(b, a).copy_from(&cross.block.transpose());
        }
        let nees = error.dot(&covariance.cholesky().unwrap().solve(&error)) / size as f64;
        [nees, (squares / (size / 2) as f64).sqrt()]
    }
}
