//! Giving up keyframes whose errors become others because the map changed, so that the filter stays conservative.
//!
//! The state errs by `a = b + u` with `b = sum of M_j e_j` over the keyframes that are given up. The new version of the map
//! has errors `e'` of which nobody says how they depend on the old ones: a keyframe that was adjusted a little has nearly
//! the error that it had, one that comes anew is of the same images perhaps. With `A = cov(b)`, `P' = cov(e')` and any
//! `C = cov(b, e')` that they allow, and for any `x > 0`,
//! ```text
//! [ (1 + x) A         0        ]     [ A   C  ]       [ x A   -C   ]
//! [     0       (1 + 1/x) P'   ]  -  [ Cᵀ  P' ]   =   [ -Cᵀ   P'/x ]   is positive semidefinite.
//! ```
//! So the state's covariance grows by `x A`, the whole map is taken for `1 + 1/x` times as uncertain from then on, by the
//! one number that `budget` keeps, and the new version enters as independent of the state. Keyframes that are the same in
//! both versions have the same errors: they stay, with their loadings.
//!
//! Keyframes that were dropped before enter again with a factor of their own (`budget`). Errors of the new version may depend
//! on any of them, so the largest of these factors is for every keyframe that enters from then on.
//!
//! **The choice of `x`.** What the state loses comes back with the next answers; what the map loses is lost for good, and
//! again with each change. So `x` is large. It grows further where the state hardly depends on the keyframes,
//! as `budget` says: then neither loses.
//!
//! Source of the bound: Julier & Uhlmann, "Using covariance intersection for SLAM", RAS 2007.

use super::HeldKeyframes;
use super::budget::{LEAST_SHARE, PRICE_OF_MAP, lifted, own_covariance};
use super::layer::product;
use super::moving::KEYFRAME_DIM;
use super::parked::Taken;
use crate::KeyframeId;
use crate::linear_algebra::dense::{Dense, Factorization};
use faer::linalg::matmul::matmul;
use faer::{Accum, MatRef, Par};
use nalgebra::{DMatrix, Matrix6};
use std::collections::{HashMap, HashSet};

/// Keyframes whose weighted loadings are made at once: they stay in the cache until they are used.
const AT_ONCE: usize = 32;
/// The map is taken for at most 1.1 times as uncertain by one change: ten changes of all of it make its deviations 1.6
/// times as large. The part of the state's error that came from the map gets 3.3 times the deviations until the next answers.
/// Tried on 20 runs of `loops` with an answer a second and a change of 0.1 m and 0.9 degrees an axis: NEES in G 0.7 with 1,
/// 0.9 with 3, 1.08 with 10, the errors alike; with a change of no size at all 0.109, 0.117 and 0.147 degrees.
const LEAST_X: f64 = 10.0;

/// See [`HeldKeyframes::give_up`].
pub fn give_up(held: &mut HeldKeyframes, ids: &[KeyframeId], active: &mut Dense) {
    if ids.is_empty() {
        return;
    }
    held.budget.note_other_errors();
    let given_up = take(held, ids);
    if given_up.is_empty() {
        return;
    }
    let of_map = covariance_of_sum(held, &given_up, active.nrows()) / held.budget.map_factor();
    let x = (PRICE_OF_MAP / share(&of_map, active).max(LEAST_SHARE)).sqrt().max(LEAST_X);
    let mut target = active.view_mut();
    target += of_map * x;
    active.mirror_lower();
    held.budget.enlarge_map(1.0 + 1.0 / x);
    for keyframe in given_up.iter().flat_map(|group| &group.keyframes) {
        held.correlations.remove(keyframe.id);
    }
}

/// Takes keyframes out: the parked ones in their layers, and the active ones as if they were of one that is now.
fn take(held: &mut HeldKeyframes, ids: &[KeyframeId]) -> Vec<Taken> {
    let mut groups = held.parked.take_in_layers(ids, &mut held.moving);
    let ids: HashSet<KeyframeId> = ids.iter().copied().collect();
    let n = held.moving.nrows();
    let (mut keyframes, mut loadings) = (Vec::new(), Dense::zeros(n, 0));
    // From behind, so that slots stay what they are.
    for slot in (0..held.active.len()).rev() {
        if ids.contains(&held.active[slot].id) {
            loadings.extend_columns(held.moving.loadings(slot));
            held.moving.remove(slot);
            keyframes.push(held.active.remove(slot));
        }
    }
    if !keyframes.is_empty() {
        groups.push(Taken { keyframes, loadings, to_now: DMatrix::identity(n, n).into() });
    }
    groups
}

/// `sum of M_j P_jk M_kᵀ`, `n` x `n`.
///
/// Loadings of a layer are multiplied in its own rows, and only the products brought to now: beside thousands of
/// keyframes these are small, and a layer's rows are few where it has a waist.
fn covariance_of_sum(held: &HeldKeyframes, groups: &[Taken], n: usize) -> DMatrix<f64> {
    let mut sum = DMatrix::zeros(n, n);
    for (k, columns) in groups.iter().enumerate() {
        let correlated = if held.has_correlations() { groups } else { &[] };
        let others = correlated.iter().enumerate().filter(|(other, _)| *other < k);
        let own = within(held, columns, columns);
        sum += brought_to_now(columns, &own, columns);
        for (_, rows) in others {
            let product = brought_to_now(rows, &within(held, rows, columns), columns);
            sum += &product;
            sum += product.transpose();
        }
    }
    sum
}

/// `sum of M_j P_jk M_kᵀ` over `j` of one layer and `k` of another, in their rows.
fn within(held: &HeldKeyframes, rows: &Taken, columns: &Taken) -> Dense {
    let places: HashMap<KeyframeId, usize> = if held.has_correlations() {
        rows.keyframes.iter().enumerate().map(|(j, keyframe)| (keyframe.id, j)).collect()
    } else {
        HashMap::new()
    };
    let same = std::ptr::eq(rows, columns);
    let mut sum = Dense::zeros(rows.loadings.nrows(), columns.loadings.nrows());
    let mut weighted = Dense::default();
    for (chunk, keyframes) in columns.keyframes.chunks(AT_ONCE).enumerate() {
        weighted.reset(rows.loadings.nrows(), KEYFRAME_DIM * keyframes.len());
        let begin = chunk * AT_ONCE;
        let mut add = |j: usize, block: &Matrix6<f64>, k: usize| {
            let target = weighted.faer_mut().subcols_mut(KEYFRAME_DIM * k, KEYFRAME_DIM);
            let of_j = rows.loadings.faer().subcols(KEYFRAME_DIM * j, KEYFRAME_DIM);
            let block = MatRef::from_column_major_slice(block.as_slice(), KEYFRAME_DIM, KEYFRAME_DIM);
            matmul(target, Accum::Add, of_j, block, 1.0, Par::Seq);
        };
        for (k, keyframe) in keyframes.iter().enumerate() {
            if same {
                add(begin + k, &own_covariance(keyframe), k);
            }
            for (other, block) in held.correlations.with(keyframe.id) {
                if let Some(&j) = places.get(&other) {
                    add(j, block, k);
                }
            }
        }
        let own = KEYFRAME_DIM * begin..KEYFRAME_DIM * begin + weighted.ncols();
        if same {
            sum.add_lower_outer(&weighted, 0..weighted.ncols(), &columns.loadings, own);
        } else {
            let own = columns.loadings.faer().subcols(own.start, own.len()).transpose();
            matmul(sum.faer_mut(), Accum::Add, weighted.faer(), own, 1.0, Par::Seq);
        }
    }
    if same {
        sum.mirror_lower();
    }
    sum
}

/// `T_rows X T_columnsᵀ`.
fn brought_to_now(rows: &Taken, between: &Dense, columns: &Taken) -> DMatrix<f64> {
    let half = product(&rows.to_now, between);
    let mut whole = Dense::zeros(half.nrows(), columns.to_now.nrows());
    matmul(whole.faer_mut(), Accum::Add, half.faer(), columns.to_now.faer().transpose(), 1.0, Par::Seq);
    whole.view().into_owned()
}

/// `tr(P_AA⁻¹ A)`: how much of the state is `b`.
fn share(of_map: &DMatrix<f64>, active: &Dense) -> f64 {
    let mut root = lifted(active);
    if Factorization::default().cholesky(&mut root).is_err() {
        return active.nrows() as f64;
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
    use rand::{RngExt as _, SeedableRng, rngs::StdRng};

    /// IMU, transform and three clones.
    const DIM: usize = 15 + 6 + 18;
    const MOST_ACTIVE: usize = 6;
    const STEPS: u64 = 150;

    /// Keyframes in several layers and in use, each with loadings of its own.
    fn lived_through(correlated: bool) -> HeldKeyframes {
        let mut rng = StdRng::seed_from_u64(7);
        let mut draw = |rows: usize, columns: usize| {
            DMatrix::from_fn(rows, columns, |_, _| rng.random_range(-0.2..0.2_f64))
        };
        let mut held = HeldKeyframes::new(DIM, MOST_ACTIVE);
        for id in 0..STEPS {
            let root = Matrix6::from_iterator(draw(6, 6).iter().copied());
            let stated = PoseWithCovariance::new(Pose::identity(), root * root.transpose());
            let block = Matrix6::from_iterator(draw(6, 6).iter().copied()) * 0.1;
            let cross: Vec<_> = (id.saturating_sub(9)..id).step_by(4).map(|other| (other, block)).collect();
            held.activate_or_insert(id, &stated, if correlated { &cross } else { &[] });
            let slot = held.slot_of(id).unwrap();
            let columns = StateBlocks { keyframes: vec![slot], ..StateBlocks::of_active([15..21, 21..27]) };
            let jacobian = Dense::from(draw(8, columns.len()));
            let rows = LinearizedMeasurement {
                blocks: columns,
                jacobian,
                residual: vec![0.0; 8],
                upper_triangular: false,
            };
            held.measurement_update(&rows, &draw(8, DIM).into(), &DMatrix::identity(8, 8).into());
            held.transform_rows(&ImuMatrix::from_fn(|row, column| if row == column { 0.99 } else { 0.01 }));
            held.gather_rows(&[0..21, 27..DIM, 0..6]);
            held.compact();
            held.deactivate_unused();
        }
        assert!(held.layers().len() > 1 && !held.active.is_empty(), "{:?}", held.layers());
        held
    }

    #[test]
    fn the_sum_by_layers_is_the_sum_of_loadings_brought_to_now() {
        for correlated in [false, true] {
            for given_up in [(0..STEPS).collect::<Vec<_>>(), (0..STEPS).step_by(3).collect(), vec![3, 3, 999]]
            {
                let mut held = lived_through(correlated);
                let mut revived = held.clone();
                revived.activate(&(0..STEPS).collect::<Vec<_>>());
                let chosen: Vec<usize> = given_up
                    .iter()
                    .collect::<HashSet<_>>()
                    .into_iter()
                    .filter_map(|id| revived.slot_of(*id))
                    .collect();
                let mut expected = DMatrix::zeros(DIM, DIM);
                let covariance = revived.covariance_of(&chosen);
                for (j, &a) in chosen.iter().enumerate() {
                    for (k, &b) in chosen.iter().enumerate() {
                        let [left, right] = [a, b]
                            .map(|slot| DMatrix::from_vec(DIM, KEYFRAME_DIM, revived.moving.loadings(slot)));
                        let block = covariance.view((6 * j, 6 * k), (6, 6));
                        expected += left * block * right.transpose();
                    }
                }
                let groups = take(&mut held, &given_up);
                assert_eq!(held.len(), STEPS as usize - chosen.len());
                let sum = covariance_of_sum(&held, &groups, DIM);
                let apart = (&sum - &expected).amax() / expected.amax();
                assert!(apart < 1e-10, "{apart} of {} keyframes", chosen.len());
            }
        }
    }
}
