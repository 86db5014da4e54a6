//! Exactness: parked, moved from layer to layer, and used again, keyframes are correlated with the state as if every step
//! had touched all of them.

use crate::textbook::{FIXED, Map, POSE, Textbook, some_keyframes, spd};
use estimator::covariance::JointCovariance;
use estimator::measurement::{Information, LinearizedMeasurement, StateBlocks};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt as _, SeedableRng, rngs::StdRng};

const STEPS: usize = 2_000;
/// Relative, everywhere.
const TOLERANCE: f64 = 1e-9;
/// Rows of a measurement, at least.
const ROWS: usize = 10;

fn relative(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
    (a - b).amax() / b.amax().max(1e-12)
}

/// Random propagation, cloning, marginalization, landmarks and updates, with keyframes that are pulled when they
/// are first matched, parked and pulled again, against a filter that held all of them all the time;
/// `correlated` keyframes carry cross-covariances of the map.
fn check(seed: u64, keyframes: u64, correlated: bool) {
    let mut rng = StdRng::seed_from_u64(seed);
    let start = spd(&mut rng, FIXED, 0.1);
    let mut joint = JointCovariance::new(start.clone(), 6);
    let map = Map::new(&mut rng, keyframes, 0.01, correlated);
    let mut textbook = Textbook::new(&start, &map);
    let (mut most_layers, mut narrowest) = (0, usize::MAX);
    for step in 0..STEPS {
        textbook.move_on(&mut rng, &mut joint);
        // Now and then match up to three keyframes; else an update from tracks only.
        // Once in a while nothing is matched for long.
        let ids =
            if step % 3 == 0 && step % 500 < 400 { some_keyframes(&mut rng, keyframes) } else { Vec::new() };
        map.pull(&ids, &mut joint, step % 2 == 0);
        let ranges = if step % 5 == 0 {
            vec![0..POSE, FIXED..textbook.active]
        } else {
            std::iter::once(FIXED..textbook.active).collect()
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
        let full = textbook.over_all(&jacobian, &touched, &ids);
        let mut correction = DVector::zeros(0);
        let squared = if summed {
            let mut information = Information::new(columns);
            information.add(&jacobian, &residual);
            let squared = joint.information_nis(&information).unwrap();
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
        let expected = residual.dot(&textbook.innovation(&full).lu().solve(&residual).unwrap());
        assert!((squared - expected).abs() < TOLERANCE * (1.0 + expected), "innovation at step {step}");
        let gain = textbook.gain(&full);
        let expected = &gain * &residual;
        let apart = (correction - &expected).amax() / (1.0 + expected.amax());
        assert!(apart < TOLERANCE, "correction at step {step}: {apart:e}");
        textbook.update(&gain, &full);
        joint.held.deactivate_unused();
        most_layers = most_layers.max(joint.held.layers().len());
        narrowest = joint.held.layers().iter().map(|(_, rows)| *rows).fold(narrowest, usize::min);

        let stated = joint.active().view().into_owned();
        let apart = relative(&stated, &textbook.of_active());
        assert!(apart < TOLERANCE, "covariance at step {step}: {apart:e}");
        // The newest clone is a copy of the body's pose: without it the covariance has full rank.
        let rank = textbook.active - POSE;
        assert!(stated.view((0, 0), (rank, rank)).cholesky().is_some(), "not positive definite at {step}");
    }
    assert!(most_layers >= 3, "{most_layers} layers: the law was hardly tried");
    assert!(narrowest < FIXED + 2 * POSE, "{narrowest} rows: no waist was found");
    for id in joint.held.ids().collect::<Vec<_>>() {
        let slot = joint.held.activate_or_insert(id, &map.keyframe(id), &[]);
        let expected = textbook.covariance.view((0, textbook.column_of(id)), (textbook.active, POSE));
        let apart = relative(&joint.held.cross_covariance(slot), &expected.into_owned());
        assert!(apart < TOLERANCE, "keyframe {id}: {apart:e}");
        // Schmidt: what the map said of a keyframe is never changed.
        let own = DMatrix::from_column_slice(POSE, POSE, map.block(id, id).as_slice());
        assert_eq!(joint.held.covariance_of(&[slot]), own);
        assert_eq!(joint.held.get(slot).global_from_keyframe, map.keyframe(id));
    }
}

#[test]
fn it_equals_the_dense_filter_with_keyframes_parked_and_used_again() {
    check(0, 40, false);
    check(1, 60, false);
}

#[test]
fn it_equals_the_dense_filter_with_cross_covariances_of_the_map() {
    check(10, 24, true);
    check(11, 88, true);
}
