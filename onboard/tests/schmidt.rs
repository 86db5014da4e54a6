//! The joint covariance against the dense Schmidt-Kalman filter that it claims to equal.
#![allow(clippy::unwrap_used)]

use geometry::{Pose, PoseWithCovariance};
use nalgebra::{DMatrix, DVector, Matrix6};
use onboard::estimator::covariance::{Columns, Information, JointCovariance};
use rand::{RngExt as _, SeedableRng, rngs::StdRng};

/// The textbook filter: one dense matrix over the active state and every keyframe ever pulled.
struct Dense {
    covariance: DMatrix<f64>,
    active: usize,
    keyframes: Vec<u64>,
}

impl Dense {
    fn left_multiply(&mut self, full: &DMatrix<f64>, noise: &DMatrix<f64>) {
        self.covariance = full * &self.covariance * full.transpose() + noise;
    }

    fn with_keyframes(&self, active: &DMatrix<f64>, rows: usize) -> DMatrix<f64> {
        let n = 6 * self.keyframes.len();
        let mut full = DMatrix::zeros(rows + n, self.active + n);
        full.view_mut((0, 0), (rows, self.active)).copy_from(active);
        full.view_mut((rows, self.active), (n, n)).fill_with_identity();
        full
    }

    fn column_of(&self, id: u64) -> usize {
        self.active + 6 * self.keyframes.iter().position(|held| *held == id).unwrap()
    }

    /// Schmidt: the full gain with its nuisance rows set to zero, in Joseph's form.
    fn update(&mut self, jacobian: &DMatrix<f64>, residual: &DVector<f64>) -> DVector<f64> {
        let rows = jacobian.nrows();
        let innovation = jacobian * &self.covariance * jacobian.transpose() + DMatrix::identity(rows, rows);
        let mut gain = &self.covariance * jacobian.transpose() * innovation.try_inverse().unwrap();
        gain.rows_mut(self.active, 6 * self.keyframes.len()).fill(0.0);
        let n = self.covariance.nrows();
        let keep = DMatrix::identity(n, n) - &gain * jacobian;
        self.covariance = &keep * &self.covariance * keep.transpose() + &gain * gain.transpose();
        (gain * residual).rows(0, self.active).into_owned()
    }
}

fn spd(rng: &mut StdRng, n: usize, scale: f64) -> DMatrix<f64> {
    let draw = DMatrix::from_fn(n, n, |_, _| rng.random_range(-1.0..1.0));
    (&draw * draw.transpose() + DMatrix::identity(n, n)) * scale
}

fn relative(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
    (a - b).amax() / b.amax().max(1e-12)
}

/// Random propagation, cloning, marginalization and updates, with keyframes that are pulled, parked
/// and pulled again; `correlated` keyframes carry cross-covariances of the map.
fn check(seed: u64, correlated: bool, max_active: usize) {
    let mut rng = StdRng::seed_from_u64(seed);
    let (fixed, pose) = (15, 6);
    let start = spd(&mut rng, fixed, 0.1);
    let mut joint = JointCovariance::new(start.clone(), max_active);
    let mut dense = Dense { covariance: start, active: fixed, keyframes: Vec::new() };
    // The map: blocks of four keyframes share one covariance.
    let map: Vec<DMatrix<f64>> = (0..12).map(|_| spd(&mut rng, 24, 0.01)).collect();
    let block = |a: u64, b: u64| -> Matrix6<f64> {
        let (group_a, group_b) = ((a / 4) as usize, (b / 4) as usize);
        if a != b && (group_a != group_b || !correlated) {
            return Matrix6::zeros();
        }
        map[group_a].fixed_view::<6, 6>(6 * (a % 4) as usize, 6 * (b % 4) as usize).into_owned()
    };
    for step in 0..400 {
        // Propagate the first 15, clone, marginalize.
        let transition =
            DMatrix::identity(fixed, fixed) + DMatrix::from_fn(fixed, fixed, |_, _| rng.random_range(-0.05..0.05));
        let noise = spd(&mut rng, fixed, 1e-3);
        joint.time_update(&transition, &noise);
        let mut active = DMatrix::identity(dense.active, dense.active);
        active.view_mut((0, 0), (fixed, fixed)).copy_from(&transition);
        let mut full_noise = DMatrix::zeros(dense.covariance.nrows(), dense.covariance.nrows());
        full_noise.view_mut((0, 0), (fixed, fixed)).copy_from(&noise);
        let full = dense.with_keyframes(&active, dense.active);
        dense.left_multiply(&full, &full_noise);

        let mut source: Vec<usize> = (0..dense.active).chain(0..pose).collect();
        if dense.active > fixed + 4 * pose {
            source.drain(fixed..fixed + pose);
        }
        joint.gather(&source);
        let mut select = DMatrix::zeros(source.len(), dense.active);
        for (row, &column) in source.iter().enumerate() {
            select[(row, column)] = 1.0;
        }
        let full = dense.with_keyframes(&select, source.len());
        let silent = DMatrix::zeros(full.nrows(), full.nrows());
        dense.left_multiply(&full, &silent);
        dense.active = source.len();

        // Now and then match up to three keyframes; else an update from tracks only.
        let mut ids: Vec<u64> = Vec::new();
        if step % 3 == 0 {
            for _ in 0..rng.random_range(1..4) {
                let id = rng.random_range(0..48_u64);
                if !ids.contains(&id) {
                    ids.push(id);
                }
            }
        }
        for &id in &ids {
            let held: Vec<u64> = joint.held.ids().collect();
            let cross: Vec<(u64, Matrix6<f64>)> =
                held.iter().filter(|&&other| block(id, other) != Matrix6::zeros()).map(|&other| (other, block(id, other))).collect();
            let keyframe = PoseWithCovariance { pose: Pose::identity(), covariance: block(id, id) };
            joint.held.pull(id, &keyframe, &cross);
            if !dense.keyframes.contains(&id) {
                let n = dense.covariance.nrows();
                let old = std::mem::replace(&mut dense.covariance, DMatrix::zeros(0, 0));
                dense.covariance = old.insert_rows(n, 6, 0.0).insert_columns(n, 6, 0.0);
                dense.keyframes.push(id);
                for (k, &other) in dense.keyframes.clone().iter().enumerate() {
                    let column = dense.active + 6 * k;
                    dense.covariance.fixed_view_mut::<6, 6>(n, column).copy_from(&block(id, other));
                    dense.covariance.fixed_view_mut::<6, 6>(column, n).copy_from(&block(other, id));
                }
            }
        }
        let touched: Vec<usize> = (fixed..dense.active).collect();
        let columns = Columns {
            active: touched.clone(),
            keyframes: ids.iter().map(|id| joint.held.slot_of(*id).unwrap()).collect(),
        };
        let rows = 10;
        let jacobian = DMatrix::from_fn(rows, columns.len(), |_, _| rng.random_range(-1.0..1.0));
        let residual = DVector::from_fn(rows, |_, _| rng.random_range(-1.0..1.0));
        let mut information = Information::new(columns);
        information.add(&jacobian, &residual);
        let mut full = DMatrix::zeros(rows, dense.covariance.nrows());
        for (k, &column) in touched.iter().enumerate() {
            full.column_mut(column).copy_from(&jacobian.column(k));
        }
        for (k, id) in ids.iter().enumerate() {
            full.columns_mut(dense.column_of(*id), 6).copy_from(&jacobian.columns(touched.len() + 6 * k, 6));
        }
        let innovation = &full * &dense.covariance * full.transpose() + DMatrix::identity(rows, rows);
        let expected = residual.dot(&innovation.lu().solve(&residual).unwrap());
        let squared = joint.innovation_squared(&information).unwrap();
        assert!((squared - expected).abs() < 1e-8 * (1.0 + expected), "innovation at step {step}");
        let correction = joint.measurement_update(&information).unwrap();
        let expected = dense.update(&full, &residual);
        assert!((correction - &expected).amax() < 1e-9 * (1.0 + expected.amax()), "correction at step {step}");
        joint.held.park_unused();
        let active = dense.covariance.view((0, 0), (dense.active, dense.active)).into_owned();
        assert!(relative(&joint.active, &active) < 1e-9, "covariance at step {step}: {}", relative(&joint.active, &active));
    }
    assert!(correlated || joint.held.parked_len() > 0, "nothing was parked: the law was not tried");
    for id in dense.keyframes.clone() {
        let slot = joint.held.pull(id, &PoseWithCovariance { pose: Pose::identity(), covariance: block(id, id) }, &[]);
        let expected = dense.covariance.view((0, dense.column_of(id)), (dense.active, 6)).into_owned();
        assert!((joint.held.cross(slot) - expected).amax() < 1e-9, "keyframe {id}");
    }
}

#[test]
fn it_equals_the_dense_filter_with_keyframes_parked_and_used_again() {
    for seed in 0..3 {
        check(seed, false, 6);
    }
}

#[test]
fn it_equals_the_dense_filter_with_cross_covariances_of_the_map() {
    for seed in 10..12 {
        check(seed, true, 6);
    }
}
