//! Poses of keyframes relative to each other.

use geometry::{PoseWithCovariance, compose_jacobians, inverse_jacobian};
use map::Keyframe;
use nalgebra::Matrix6;
use protocol::KeyframeId;

use super::loaded_map::LoadedMap;

impl LoadedMap {
    /// The pose of a keyframe in the frame of another one (rad, m), with the covariance of the errors of both: those that they share
    /// cancel. `None` where the map lacks one of them.
    pub fn relative_pose(&self, from: KeyframeId, to: KeyframeId) -> Option<PoseWithCovariance> {
        let [a, b] = [self.keyframe(from)?, self.keyframe(to)?];
        let [a_pose, b_pose] = [a, b].map(|keyframe| &keyframe.global_from_keyframe.pose);
        let a_from_global = a_pose.inverse();
        let (by_inverse, by_b) = compose_jacobians(&a_from_global, b_pose);
        let by_a = by_inverse * inverse_jacobian(a_pose);
        let covariance = self.covariance_of_sum((a, &by_a), (b, &by_b));
        Some(PoseWithCovariance::new(a_from_global.compose(b_pose), covariance))
    }

    /// Covariance of `J_a e_a + J_b e_b`, where the poses of two keyframes of the map err by `e_a` and `e_b`.
    pub(crate) fn covariance_of_sum(
        &self,
        (a, by_a): (&Keyframe, &Matrix6<f64>),
        (b, by_b): (&Keyframe, &Matrix6<f64>),
    ) -> Matrix6<f64> {
        let [of_a, of_b] = [a, b].map(|keyframe| keyframe.global_from_keyframe.covariance);
        let cross = if a.id == b.id { of_a } else { self.joint_covariance(a.id, b.id).unwrap_or_default() };
        let cross = by_a * cross * by_b.transpose();
        positive_part(
            &(by_a * of_a * by_a.transpose() + by_b * of_b * by_b.transpose() + cross + cross.transpose()),
        )
    }
}

/// A symmetric matrix without its negative eigenvalues: single blocks of a joint covariance are rounded.
fn positive_part(matrix: &Matrix6<f64>) -> Matrix6<f64> {
    let mut eigen = matrix.symmetric_eigen();
    eigen.eigenvalues.apply(|value| *value = value.max(0.0));
    eigen.recompose()
}

#[cfg(test)]
mod tests {
    use map::CommonError;
    use nalgebra::{Matrix6xX, Vector6};
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

    #[test]
    fn the_positive_part_of_a_covariance_is_itself() {
        let root = Matrix6::from_fn(|row, column| ((3 * row + 5 * column) % 7) as f64 - 2.0);
        let covariance = root * root.transpose();
        assert!((positive_part(&covariance) - covariance).norm() < 1e-9 * covariance.norm());
        let diagonal = Matrix6::from_diagonal(&Vector6::new(1.0, -2.0, 3.0, 0.0, -1e-9, 4.0));
        let expected = Matrix6::from_diagonal(&Vector6::new(1.0, 0.0, 3.0, 0.0, 0.0, 4.0));
        assert!((positive_part(&diagonal) - expected).norm() < 1e-12);
    }
}
