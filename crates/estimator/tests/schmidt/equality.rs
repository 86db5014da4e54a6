//! Exactness: deactivated, moved from level to level and activated again, keyframes are correlated with the state as if every step
//! had touched all of them.

use crate::schmidt::dense_filter::{Correlation, DenseFilter, FIXED, Map, POSE, some_keyframes, spd};
use estimator::covariance::JointCovariance;
use estimator::measurement::{Information, LinearizedMeasurement, StateBlocks};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt as _, SeedableRng, rngs::StdRng};

/// Steps of every run of the tests, and of the nightly one. From the 400th to the 500th nothing is matched.
const STEPS: usize = 600;
const ALL_STEPS: usize = 1_000;
/// Relative, everywhere.
const TOLERANCE: f64 = 1e-9;
/// Rows of a measurement, at least.
const ROWS: usize = 10;

fn relative(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
    (a - b).amax() / b.amax().max(1e-12)
}

/// Random propagation, cloning, marginalization, landmarks and updates, with keyframes that are inserted when they
/// are first matched, deactivated and activated again, against a filter that held all of them all the time.
fn check(steps: usize, seed: u64, keyframes: u64, correlation: Correlation) {
    let mut rng = StdRng::seed_from_u64(seed);
    let start = spd(&mut rng, FIXED, 0.1);
    let mut joint = JointCovariance::new(start.clone(), 6);
    let map = Map::new(&mut rng, keyframes, 0.01, correlation);
    let mut dense = DenseFilter::new(&start, &map);
    let (mut most_levels, mut fewest_rows) = (0, usize::MAX);
    for step in 0..steps {
        dense.random_step(&mut rng, &mut joint);
        // Now and then match up to three keyframes; else an update from tracks only.
        // Once in a while nothing is matched for long.
        let ids =
            if step % 3 == 0 && step % 500 < 400 { some_keyframes(&mut rng, keyframes) } else { Vec::new() };
        map.activate(&ids, &mut joint, step % 2 == 0);
        let ranges = if step % 5 == 0 {
            vec![0..POSE, FIXED..dense.active]
        } else {
            std::iter::once(FIXED..dense.active).collect()
        };
        let touched: Vec<usize> = ranges.iter().flat_map(Clone::clone).collect();
        let columns = StateBlocks {
            active: ranges,
            keyframes: ids.iter().map(|id| joint.held.slot_of(*id).unwrap()).collect(),
        };
        // Rows as they are; now and then so many that they are summed up.
        let summed = step % 4 == 0;
        let count = if summed { columns.len() + ROWS } else { ROWS };
        let jacobian = DMatrix::from_fn(count, columns.len(), |_, _| rng.random_range(-1.0..1.0));
        let residual = DVector::from_fn(count, |_, _| rng.random_range(-1.0..1.0));
        let full = dense.over_all(&jacobian, &touched, &ids);
        let mut correction = DVector::zeros(0);
        let squared = if summed {
            let mut information = Information::new(columns);
            information.add(&jacobian, &residual);
            let squared = joint.information_nis(&information).unwrap().total;
            // Known beforehand without changing anything: the update after it says the same.
            let mut announced = DVector::zeros(0);
            joint.information_correction(&information, &mut announced).unwrap();
            joint.information_update(&information, &mut correction).unwrap();
            assert!((&announced - &correction).amax() <= TOLERANCE * announced.amax(), "step {step}");
            squared
        } else {
            let (residual, upper_triangular) = (residual.as_slice().to_vec(), false);
            let rows = LinearizedMeasurement {
                blocks: columns,
                jacobian: jacobian.into(),
                residual,
                upper_triangular,
            };
            let squared = joint.nis(&rows).unwrap();
            joint.measurement_update(&rows, &mut correction).unwrap();
            squared
        };
        let expected = residual.dot(&dense.innovation(&full).lu().solve(&residual).unwrap());
        assert!((squared - expected).abs() < TOLERANCE * (1.0 + expected), "innovation at step {step}");
        let gain = dense.gain(&full);
        let expected = &gain * &residual;
        let apart = (correction - &expected).amax() / (1.0 + expected.amax());
        assert!(apart < TOLERANCE, "correction at step {step}: {apart:e}");
        dense.update(&gain, &full);
        joint.held.deactivate_unused();
        most_levels = most_levels.max(joint.held.levels().len());
        fewest_rows = joint.held.levels().iter().map(|(_, rows)| *rows).fold(fewest_rows, usize::min);

        let stated = joint.active().view().into_owned();
        let apart = relative(&stated, &dense.of_active());
        assert!(apart < TOLERANCE, "covariance at step {step}: {apart:e}");
        // The newest clone is a copy of the body's pose: without it the covariance has full rank.
        let rank = dense.active - POSE;
        assert!(stated.view((0, 0), (rank, rank)).cholesky().is_some(), "not positive definite at {step}");
    }
    assert!(most_levels >= 3, "{most_levels} levels: the law was hardly exercised");
    assert!(fewest_rows < FIXED + 2 * POSE, "{fewest_rows} rows: no rank factorization took place");
    for id in joint.held.ids().collect::<Vec<_>>() {
        let slot = map.activate_one(id, &mut joint);
        let expected = dense.covariance.view((0, dense.column_of(id)), (dense.active, POSE));
        let apart = relative(&joint.held.cross_covariance(slot), &expected.into_owned());
        assert!(apart < TOLERANCE, "keyframe {id}: {apart:e}");
        // Schmidt: what the map said of a keyframe is never changed.
        let own = DMatrix::from_column_slice(POSE, POSE, map.block(id, id).as_slice());
        assert_eq!(joint.held.covariance_of(&[slot]), own);
        assert_eq!(joint.held.get(slot).global_from_keyframe, map.keyframe(id));
    }
}

#[test]
fn it_equals_the_dense_filter_with_keyframes_deactivated_and_activated_again() {
    check(STEPS, 0, 40, Correlation::None);
    check(STEPS, 1, 60, Correlation::None);
}

#[test]
fn it_equals_the_dense_filter_with_cross_covariances_of_the_map() {
    check(STEPS, 10, 24, Correlation::Blocks);
    check(STEPS, 11, 88, Correlation::Blocks);
}

#[test]
fn it_equals_the_dense_filter_with_what_all_keyframes_err_together() {
    check(STEPS, 20, 24, Correlation::BlocksAndCommon(9));
    check(STEPS, 21, 40, Correlation::BlocksAndCommon(30));
}

#[test]
#[ignore = "more steps"]
fn it_equals_the_dense_filter_over_a_thousand_steps() {
    check(ALL_STEPS, 0, 40, Correlation::None);
    check(ALL_STEPS, 1, 60, Correlation::None);
    check(ALL_STEPS, 10, 24, Correlation::Blocks);
    check(ALL_STEPS, 11, 88, Correlation::Blocks);
    check(ALL_STEPS, 20, 24, Correlation::BlocksAndCommon(9));
    check(ALL_STEPS, 21, 40, Correlation::BlocksAndCommon(30));
}
