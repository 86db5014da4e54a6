//! Invalidation: keyframes whose errors a new version of the map replaces are dropped, and the filter stays conservative.
//!
//! The state's error is `b + u` with `b = sum of M_j e_j` over the invalidated keyframes. How the new version's errors `e'`
//! depend on the old ones is unknown: a keyframe that was adjusted slightly has nearly the error that it had. With
//! `A = cov(b)`, `P' = cov(e')` and any admissible `C = cov(b, e')`, for any `x > 0`,
//! ```text
//! [ (1 + x) A         0        ]     [ A   C  ]       [ x A   -C   ]
//! [     0       (1 + 1/x) P'   ]  -  [ Cᵀ  P' ]   =   [ -Cᵀ   P'/x ]   is positive semidefinite.
//! ```
//! So the state's covariance grows by `x A`, the covariance of the whole map is inflated by `1 + 1/x`, and the new version
//! enters as independent of the state. Keyframes that both versions share stay, with their sensitivities. Where these depend on
//! the `x` that all keyframes have in common, it stays, too, and `e_j` is what an invalidated keyframe errs beyond it;
//! else `b` contains `X x`.
//!
//! Keyframes evicted earlier have inflation factors of their own. Errors of the new version may depend on any of them, so
//! the largest of these factors holds for every keyframe that enters from then on.
//!
//! **Choice of `x`.** As for eviction, but not below [`MIN_X`]: the state regains its accuracy with the next map updates,
//! whereas the inflation of the map stays and accumulates with each change.
//!
//! Source of the bound: Julier & Uhlmann, "Using covariance intersection for SLAM", RAS 2007.

use super::HeldKeyframes;
use super::inflation::{MAP_WEIGHT, MIN_RELATIVE_INFORMATION, regularized};
use super::keyframe::{HeldKeyframe, KEYFRAME_DIM};
use crate::KeyframeId;
use crate::linear_algebra::dense::{Dense, Factorization};
use faer::linalg::matmul::triangular::BlockStructure::Rectangular;
use nalgebra::{DMatrix, Matrix6};
use std::collections::HashMap;

/// Keyframes of one product: its factors stay in the cache.
const AT_ONCE: usize = 32;
/// One change inflates the map's covariance by at most 1.1: ten changes of all of it make its sigmas 1.6 times as large.
/// The part of the state's error that came from the map gets 3.3 times the sigma until the next map updates.
/// Chosen on 20 runs of `loops` with a map update a second and a change of 0.1 m and 0.9 degrees an axis: NEES in G 0.7 with
/// 1, 0.9 with 3, 1.08 with 10, at equal errors; with a change of size zero 0.109, 0.117 and 0.147 degrees.
const MIN_X: f64 = 10.0;

impl HeldKeyframes {
    /// Drops keyframes, active or inactive, whose errors the map has changed. Slots change.
    ///
    /// # Arguments
    /// * `ids`: those that are not held are ignored.
    /// * `covariance`: `P_AA`, which grows.
    pub fn invalidate(&mut self, ids: &[KeyframeId], covariance: &mut Dense) {
        if ids.is_empty() {
            return;
        }
        self.inflation.note_new_version();
        let (keyframes, sensitivity) = self.remove_invalid(ids);
        if keyframes.is_empty() {
            return;
        }
        let mut of_map = self.covariance_of_sum(&keyframes, &sensitivity);
        if self.common_dim().is_some() && !self.any_has_common_error() {
            let common = self.take_common();
            of_map += common.view() * common.view().transpose();
        }
        of_map /= self.inflation.of_map();
        let relative = relative_information(&of_map, covariance).max(MIN_RELATIVE_INFORMATION);
        let x = (MAP_WEIGHT / relative).sqrt().max(MIN_X);
        let mut target = covariance.view_mut();
        target += of_map * x;
        covariance.mirror_lower();
        self.inflation.inflate_map(1.0 + 1.0 / x);
        for keyframe in keyframes {
            self.correlations.remove(keyframe.id);
        }
    }

    /// Removes keyframes; returns them with their present sensitivities, 6 columns each in the same order.
    fn remove_invalid(&mut self, ids: &[KeyframeId]) -> (Vec<HeldKeyframe>, Dense) {
        let (mut keyframes, mut sensitivity) = self.inactive.remove_many(ids, &mut self.active);
        for &id in ids {
            if let Some(slot) = self.slot_of(id) {
                let (keyframe, own) = self.active.remove(slot);
                keyframes.push(keyframe);
                sensitivity.append(&own);
            }
        }
        (keyframes, sensitivity)
    }

    /// `sum of M_j P_jk M_kᵀ` over all pairs of some keyframes.
    fn covariance_of_sum(&self, keyframes: &[HeldKeyframe], sensitivity: &Dense) -> DMatrix<f64> {
        let positions: HashMap<KeyframeId, usize> =
            keyframes.iter().enumerate().map(|(j, keyframe)| (keyframe.id, j)).collect();
        let columns_of = |j: usize| KEYFRAME_DIM * j..KEYFRAME_DIM * (j + 1);
        let mut sum = Dense::zeros(sensitivity.nrows(), sensitivity.nrows());
        let mut weighted = Dense::default();
        for (chunk, some) in keyframes.chunks(AT_ONCE).enumerate() {
            let first = chunk * AT_ONCE;
            weighted.reset(sensitivity.nrows(), 0);
            for (k, keyframe) in some.iter().enumerate() {
                let mut cross = Dense::zeros(sensitivity.nrows(), KEYFRAME_DIM);
                let mut add = |j: usize, block: &Matrix6<f64>| {
                    let block = Dense::from_columns(KEYFRAME_DIM, block.as_slice());
                    cross.add_product(sensitivity, columns_of(j), &block, 0..KEYFRAME_DIM, Rectangular);
                };
                add(first + k, &keyframe.covariance_of_rest());
                for (other, block) in self.correlations.with(keyframe.id) {
                    if let Some(&j) = positions.get(&other) {
                        add(j, block);
                    }
                }
                weighted.append(&cross);
            }
            let own = columns_of(first).start..columns_of(first + some.len()).start;
            sum.add_lower_outer(&weighted, 0..weighted.ncols(), sensitivity, own);
        }
        sum.mirror_lower();
        sum.view().into_owned()
    }
}

/// `tr(P_AA⁻¹ A)`: the part of the state's information that depends on `b`.
fn relative_information(of_map: &DMatrix<f64>, covariance: &Dense) -> f64 {
    let mut root = regularized(covariance);
    if Factorization::default().cholesky(&mut root).is_err() {
        return covariance.nrows() as f64;
    }
    let mut solved = Dense::from(of_map.clone());
    solved.solve_lower(&root);
    let mut solved = Dense::from(solved.view().transpose());
    solved.solve_lower(&root);
    solved.view().trace()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurement::{LinearizedMeasurement, StateBlocks};
    use crate::propagation::ImuMatrix;
    use geometry::{Pose, PoseWithCovariance};
    use nalgebra::Matrix6xX;
    use rand::{RngExt as _, SeedableRng, rngs::StdRng};

    /// IMU, transform and three clones.
    const DIM: usize = 15 + 6 + 18;
    const MAX_ACTIVE: usize = 6;
    const STEPS: u64 = 150;

    /// Active keyframes and several levels of inactive ones, all with different sensitivities.
    fn held_after_many_steps(correlated: bool, common_dim: usize) -> HeldKeyframes {
        let mut rng = StdRng::seed_from_u64(7);
        let mut draw = |rows: usize, columns: usize| {
            DMatrix::from_fn(rows, columns, |_, _| rng.random_range(-0.2..0.2_f64))
        };
        let mut held = HeldKeyframes::new(DIM, MAX_ACTIVE);
        for id in 0..STEPS {
            let root = Matrix6::from_iterator(draw(6, 6).iter().copied());
            let stated = PoseWithCovariance::new(Pose::identity(), root * root.transpose());
            let block = Matrix6::from_iterator(draw(6, 6).iter().copied()) * 0.1;
            let cross: Vec<_> = (id.saturating_sub(9)..id).step_by(4).map(|other| (other, block)).collect();
            let common = Matrix6xX::from_iterator(common_dim, draw(6, common_dim).iter().copied()) * 0.1;
            let cross: &[_] = if correlated { &cross } else { &[] };
            let slot = held.activate_or_insert(id, &stated, &common, cross);
            let blocks = StateBlocks { keyframes: vec![slot], ..StateBlocks::of_active([15..21, 21..27]) };
            let jacobian = Dense::from(draw(8, blocks.len()));
            let measurement =
                LinearizedMeasurement { blocks, jacobian, residual: vec![0.0; 8], upper_triangular: false };
            held.measurement_update(&measurement, &draw(8, DIM).into(), &Dense::identity(8));
            held.propagate(&ImuMatrix::from_fn(|row, column| if row == column { 0.99 } else { 0.01 }));
            held.gather_rows(&[0..21, 27..DIM, 0..6]);
            held.compact();
            held.deactivate_unused();
        }
        assert!(held.levels().len() > 1 && !held.active.keyframes().is_empty(), "{:?}", held.levels());
        held
    }

    #[test]
    fn the_covariance_that_is_removed_is_the_sum_over_all_pairs_of_keyframes() {
        for (correlated, common_dim) in [(false, 0), (true, 0), (true, 9)] {
            for ids in [(0..STEPS).collect::<Vec<_>>(), (0..STEPS).step_by(3).collect(), vec![3, 3, 999]] {
                let mut held = held_after_many_steps(correlated, common_dim);
                let mut activated = held.clone();
                activated.activate(&(0..STEPS).collect::<Vec<_>>());
                let mut slots: Vec<usize> = ids.iter().filter_map(|id| activated.slot_of(*id)).collect();
                slots.dedup();
                let keyframes: Vec<&HeldKeyframe> = slots.iter().map(|&slot| activated.get(slot)).collect();
                let covariance = activated.covariance_of_rests(&keyframes);
                let of = |slot: usize| {
                    let mut sensitivity = Dense::zeros(DIM, KEYFRAME_DIM);
                    let identity = Dense::identity(KEYFRAME_DIM);
                    activated.active.add_sensitivity_times(slot, &identity, &mut sensitivity);
                    DMatrix::from(sensitivity.view())
                };
                let mut expected = DMatrix::zeros(DIM, DIM);
                for (j, &a) in slots.iter().enumerate() {
                    for (k, &b) in slots.iter().enumerate() {
                        expected += of(a) * covariance.view((6 * j, 6 * k), (6, 6)) * of(b).transpose();
                    }
                }
                let (keyframes, sensitivity) = held.remove_invalid(&ids);
                assert_eq!(held.len(), STEPS as usize - slots.len());
                let sum = held.covariance_of_sum(&keyframes, &sensitivity);
                let difference = (&sum - &expected).amax() / expected.amax();
                assert!(difference < 1e-10, "{difference} of {} keyframes", slots.len());
            }
        }
    }

    #[test]
    fn the_sensitivity_to_what_keyframes_have_in_common_is_that_to_all_of_them() {
        let mut held = held_after_many_steps(true, 9);
        held.activate_common();
        let common = held.active.take_common();
        held.active.set_common(&common);
        held.activate(&(0..STEPS).collect::<Vec<_>>());
        let mut expected = Dense::zeros(DIM, 9);
        for (slot, keyframe) in held.active.keyframes().iter().enumerate() {
            held.active.add_sensitivity_times(slot, &keyframe.common, &mut expected);
        }
        let difference = (common.view() - expected.view()).amax() / expected.view().amax();
        assert!(difference < 1e-10, "{difference}");

        // It is gone with the last keyframe that has any of it, and its covariance is the state's.
        let mut covariance = Dense::identity(DIM);
        let ids: Vec<u64> = (0..STEPS).collect();
        held.invalidate(&ids[1..], &mut covariance);
        assert_eq!(held.common_dim(), Some(9));
        let before = covariance.view().into_owned();
        held.invalidate(&[0], &mut covariance);
        assert_eq!(held.common_dim(), None);
        let least = common.view() * common.view().transpose();
        let growth = covariance.view() - before;
        let rounding = 1e-9 * growth.amax();
        assert!((growth - least).symmetric_eigenvalues().min() > -rounding);
    }
}
