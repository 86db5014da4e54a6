//! How the errors of the poses of two views are correlated: neighbours in a map are known far better relative to each other than in G.

use std::collections::HashMap;
use std::sync::{PoisonError, RwLock};

use map::{CommonError, MapContents};
use nalgebra::Matrix6;
use protocol::KeyframeId;

/// The covariances of the pose errors of two views.
pub(super) enum Correlations<'a> {
    /// All are independent, as reference poses are.
    Independent,
    /// As a map states them for its keyframes.
    OfMap(MapCorrelations<'a>),
}

/// Those of the keyframes of a map.
pub(super) struct MapCorrelations<'a> {
    /// By view.
    common: Vec<Option<&'a CommonError>>,
    /// Blocks beyond the common errors, of views (a, b).
    blocks: HashMap<(usize, usize), Matrix6<f64>>,
    /// Sums that were asked for already: a common error has hundreds of columns.
    known: RwLock<KnownSums>,
}

/// By view (a, b).
type KnownSums = HashMap<(usize, usize), Option<Matrix6<f64>>>;

impl<'a> MapCorrelations<'a> {
    /// # Arguments
    /// * `views`: the keyframe of each view.
    pub(super) fn new(contents: &'a MapContents, views: &[KeyframeId]) -> MapCorrelations<'a> {
        let view_of: HashMap<KeyframeId, usize> = views.iter().copied().zip(0..).collect();
        let mut common = vec![None; views.len()];
        for of_keyframe in &contents.common_errors {
            if let Some(&view) = view_of.get(&of_keyframe.keyframe) {
                common[view] = Some(of_keyframe);
            }
        }
        let mut blocks = HashMap::new();
        for cross in &contents.cross_covariances {
            if let (Some(&a), Some(&b)) = (view_of.get(&cross.a), view_of.get(&cross.b)) {
                blocks.insert((a, b), cross.block);
                blocks.insert((b, a), cross.block.transpose());
            }
        }
        MapCorrelations { common, blocks, known: RwLock::default() }
    }

    fn sum(&self, a: usize, b: usize) -> Option<Matrix6<f64>> {
        let listed = self.blocks.get(&(a, b)).copied();
        let common = self.common[a].zip(self.common[b]).map(|(one, other)| one.covariance_with(other));
        match (listed, common) {
            (Some(listed), Some(common)) => Some(listed + common),
            (one, other) => one.or(other),
        }
    }
}

impl Correlations<'_> {
    /// `E[e_a e_bᵀ]` of two different views, `e = [δθ, δp]` in G (rad, m); `None` where they are independent.
    pub(super) fn between(&self, a: usize, b: usize) -> Option<Matrix6<f64>> {
        let Correlations::OfMap(map) = self else { return None };
        if let Some(known) = map.known.read().unwrap_or_else(PoisonError::into_inner).get(&(a, b)) {
            return *known;
        }
        let sum = map.sum(a, b);
        map.known.write().unwrap_or_else(PoisonError::into_inner).insert((a, b), sum);
        sum
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use geometry::{Pose, PoseWithCovariance};
    use map::{Keyframe, KeyframeCrossCovariance, MapMetadata};
    use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
    use protocol::DescriptorKind;
    use rand::RngExt;
    use rand::rngs::StdRng;
    use rand_distr::StandardNormal;

    /// Two keyframes 0.5 m apart whose errors have most in common, as those of neighbours in a map do.
    pub(crate) struct Neighbours {
        pub(crate) truth: [Pose; 2],
        factor: SMatrix<f64, 12, 18>,
        map: MapContents,
    }

    impl Neighbours {
        pub(crate) fn new(rng: &mut StdRng) -> Neighbours {
            let truth = [[0.0, 0.0, 0.0], [0.4, 0.25, -0.1]].map(|position: [f64; 3]| {
                let turn = 0.1 * Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal));
                Pose::new(UnitQuaternion::from_scaled_axis(turn), Vector3::from(position))
            });
            // The common part acts on both as on one body: their relative pose does not change by it.
            let mut factor = SMatrix::<f64, 12, 18>::zeros();
            for (at, pose) in truth.iter().enumerate() {
                for axis in 0..3 {
                    factor[(6 * at + axis, axis)] = 2e-3;
                    factor[(6 * at + 3 + axis, 3 + axis)] = 2e-2;
                    factor[(6 * at + axis, 6 + 6 * at + axis)] = 2e-4;
                    factor[(6 * at + 3 + axis, 9 + 6 * at + axis)] = 1e-3;
                    let turned = 2e-3 * Vector3::ith(axis, 1.0).cross(&pose.translation);
                    factor.fixed_view_mut::<3, 1>(6 * at + 3, axis).copy_from(&turned);
                }
            }
            let joint = factor * factor.transpose();
            let keyframe = |at: usize| Keyframe {
                id: 5 + at as u64,
                stamp_ns: 0,
                global_from_keyframe: PoseWithCovariance::new(
                    truth[at],
                    joint.fixed_view::<6, 6>(6 * at, 6 * at).into_owned(),
                ),
                camera: testing::camera(),
                features: None,
            };
            let info = MapMetadata::new("two", "test", DescriptorKind::Binary, 32);
            let block = joint.fixed_view::<6, 6>(0, 6).into_owned();
            let map = MapContents {
                keyframes: vec![keyframe(0), keyframe(1)],
                cross_covariances: vec![KeyframeCrossCovariance { a: 5, b: 6, block }],
                ..MapContents::empty(info)
            };
            map.validate().unwrap();
            Neighbours { truth, factor, map }
        }

        /// What the map states of them.
        pub(crate) fn correlations(&self) -> Correlations<'_> {
            Correlations::OfMap(MapCorrelations::new(&self.map, &[5, 6]))
        }

        /// Poses that err as the map states, with their covariances.
        pub(crate) fn sample(&self, rng: &mut StdRng) -> [PoseWithCovariance; 2] {
            let unit = SVector::<f64, 18>::from_fn(|_, _| rng.sample(StandardNormal));
            let errors = self.factor * unit;
            [0, 1].map(|at| {
                let error: Vector6<f64> = errors.fixed_rows::<6>(6 * at).into_owned();
                let covariance = self.map.keyframes[at].global_from_keyframe.covariance;
                PoseWithCovariance::new(self.truth[at].retract(&error), covariance)
            })
        }
    }

    #[test]
    fn common_errors_and_blocks_are_summed_in_either_order() {
        let place = testing::Place::new(&testing::PlaceOptions { keyframes: 5, ..Default::default() });
        let mut map = place.map;
        testing::add_common_errors(&mut map, 3);
        let ids: Vec<KeyframeId> = map.keyframes.iter().rev().map(|keyframe| keyframe.id).collect();
        let correlations = Correlations::OfMap(MapCorrelations::new(&map, &ids));
        let common = |id: KeyframeId| map.common_errors.iter().find(|common| common.keyframe == id).unwrap();
        for (a, b) in [(0, 1), (1, 0), (0, 3), (4, 2)] {
            let (of_a, of_b) = (ids[a], ids[b]);
            let listed = map.cross_covariances.iter().find_map(|cross| {
                (cross.a, cross.b)
                    .eq(&(of_a, of_b))
                    .then_some(cross.block)
                    .or_else(|| (cross.a, cross.b).eq(&(of_b, of_a)).then(|| cross.block.transpose()))
            });
            let expected = common(of_a).covariance_with(common(of_b)) + listed.unwrap_or_else(Matrix6::zeros);
            for _ in 0..2 {
                assert!((correlations.between(a, b).unwrap() - expected).amax() < 1e-18, "{a} and {b}");
            }
        }
        assert_eq!(Correlations::Independent.between(0, 1), None);
    }
}
