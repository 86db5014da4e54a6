//! Poses of keyframes relative to each other.

use geometry::{PoseWithCovariance, compose_jacobians, inverse_jacobian};
use protocol::KeyframeId;

use super::consensus::positive_part;
use super::loaded_map::LoadedMap;

impl LoadedMap {
    /// The pose of a keyframe in the frame of another one (rad, m), with the covariance of the errors of both: those that they share
    /// cancel. `None` where the map lacks one of them.
    pub fn relative_pose(&self, from: KeyframeId, to: KeyframeId) -> Option<PoseWithCovariance> {
        let [a, b] = [self.keyframe(from)?, self.keyframe(to)?].map(|keyframe| keyframe.global_from_keyframe);
        let a_from_global = a.pose.inverse();
        let (by_inverse, by_b) = compose_jacobians(&a_from_global, &b.pose);
        let by_a = by_inverse * inverse_jacobian(&a.pose);
        let cross = by_a * self.joint_covariance(from, to).unwrap_or_default() * by_b.transpose();
        let covariance = by_a * a.covariance * by_a.transpose()
            + by_b * b.covariance * by_b.transpose()
            + cross
            + cross.transpose();
        Some(PoseWithCovariance::new(a_from_global.compose(&b.pose), positive_part(&covariance)))
    }
}

#[cfg(test)]
mod tests {
    use map::CommonError;
    use nalgebra::{Matrix6, Matrix6xX, Vector6};
    use testing::{Place, PlaceOptions};

    use super::*;

    #[test]
    fn an_error_that_keyframes_share_leaves_their_relative_pose_certain() {
        let mut contents =
            Place::new(&PlaceOptions { keyframes: 3, landmarks: 50, ..PlaceOptions::default() }).map;
        let mut factor = Matrix6xX::zeros(1);
        factor[3] = 2.0;
        let error = &factor * factor.transpose() + Matrix6::identity() * 1e-6;
        contents.cross_covariances.clear();
        let ids: Vec<KeyframeId> = contents.keyframes.iter().map(|keyframe| keyframe.id).collect();
        contents.common_errors =
            ids[..2].iter().map(|&keyframe| CommonError { keyframe, factor: factor.clone() }).collect();
        for keyframe in &mut contents.keyframes {
            keyframe.global_from_keyframe.covariance = error;
        }
        let map = LoadedMap::from_contents(contents).unwrap();
        assert!(map.relative_pose(ids[0], ids[1]).unwrap().sigma_p_m() < 0.01);
        assert!(map.relative_pose(ids[0], ids[2]).unwrap().sigma_p_m() > 1.0);
        assert!(map.relative_pose(ids[0], 10_000).is_none());
    }

    #[test]
    fn the_covariance_is_that_of_first_order_errors() {
        let contents =
            Place::new(&PlaceOptions { keyframes: 3, landmarks: 50, ..PlaceOptions::default() }).map;
        let map = LoadedMap::from_contents(contents).unwrap();
        let ids: Vec<KeyframeId> = map.keyframes().map(|keyframe| keyframe.id).collect();
        let [a, b] = [ids[0], ids[1]].map(|id| map.keyframe(id).unwrap().global_from_keyframe);
        let relative = |error_a: &Vector6<f64>, error_b: &Vector6<f64>| {
            a.pose.retract(error_a).inverse().compose(&b.pose.retract(error_b))
        };
        // Columns: by the error of a, by that of b.
        let none = Vector6::zeros();
        let [mut by_a, mut by_b] = [Matrix6::zeros(); 2];
        for axis in 0..6 {
            let step = Vector6::ith(axis, 1e-6);
            by_a.set_column(axis, &(relative(&-step, &none).local(&relative(&step, &none)) / 2e-6));
            by_b.set_column(axis, &(relative(&none, &-step).local(&relative(&none, &step)) / 2e-6));
        }
        let cross = by_a * map.joint_covariance(ids[0], ids[1]).unwrap() * by_b.transpose();
        let expected = by_a * a.covariance * by_a.transpose()
            + by_b * b.covariance * by_b.transpose()
            + cross
            + cross.transpose();
        let stated = map.relative_pose(ids[0], ids[1]).unwrap().covariance;
        assert!((stated - expected).norm() < 1e-5 * expected.norm(), "{stated} {expected}");
    }
}
