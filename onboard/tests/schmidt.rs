//! The joint covariance against the dense Schmidt-Kalman filter that it claims to equal.
#![allow(clippy::unwrap_used)]

use geometry::{Pose, PoseWithCovariance};
use nalgebra::{DMatrix, DVector, Matrix6};
use onboard::estimator::covariance::JointCovariance;
use onboard::estimator::information::{Columns, Information};
use onboard::estimator::propagation::ImuMatrix;
use rand::{RngExt as _, SeedableRng, rngs::StdRng};

/// The textbook filter: one dense matrix over the active state and every keyframe of the map.
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

/// The map: blocks of four keyframes share one covariance.
struct Map {
    blocks: Vec<DMatrix<f64>>,
    correlated: bool,
}

const KEYFRAMES: u64 = 16;
const FIXED: usize = 15;
const POSE: usize = 6;
const STEPS: usize = 120;

impl Map {
    fn new(rng: &mut StdRng, correlated: bool) -> Self {
        Self { blocks: (0..KEYFRAMES / 4).map(|_| spd(rng, 24, 0.01)).collect(), correlated }
    }

    fn block(&self, a: u64, b: u64) -> Matrix6<f64> {
        let (group_a, group_b) = ((a / 4) as usize, (b / 4) as usize);
        if a != b && (group_a != group_b || !self.correlated) {
            return Matrix6::zeros();
        }
        self.blocks[group_a].fixed_view::<6, 6>(6 * (a % 4) as usize, 6 * (b % 4) as usize).into_owned()
    }

    fn keyframe(&self, id: u64) -> PoseWithCovariance {
        PoseWithCovariance { pose: Pose::identity(), covariance: self.block(id, id) }
    }

    /// Blocks towards the keyframes that are held, as the server sends them.
    fn cross(&self, id: u64, joint: &JointCovariance) -> Vec<(u64, Matrix6<f64>)> {
        let others =
            joint.held.ids().filter(|&other| other != id && self.block(id, other) != Matrix6::zeros());
        others.map(|other| (other, self.block(id, other))).collect()
    }

    /// The textbook filter holds the whole map from the start.
    fn dense(&self, start: &DMatrix<f64>) -> Dense {
        let active = start.nrows();
        let keyframes: Vec<u64> = (0..KEYFRAMES).collect();
        let mut covariance = DMatrix::zeros(active + 6 * keyframes.len(), active + 6 * keyframes.len());
        covariance.view_mut((0, 0), (active, active)).copy_from(start);
        for &a in &keyframes {
            for &b in &keyframes {
                let corner = (active + 6 * a as usize, active + 6 * b as usize);
                covariance.fixed_view_mut::<6, 6>(corner.0, corner.1).copy_from(&self.block(a, b));
            }
        }
        Dense { covariance, active, keyframes }
    }
}

/// Random propagation, cloning, marginalization and updates, with keyframes that are pulled when they
/// are first matched, parked and pulled again, against a filter that held all of them all the time;
/// `correlated` keyframes carry cross-covariances of the map.
fn check(seed: u64, correlated: bool, max_active: usize) {
    let mut rng = StdRng::seed_from_u64(seed);
    let start = spd(&mut rng, FIXED, 0.1);
    let mut joint = JointCovariance::new(start.clone(), max_active);
    let map = Map::new(&mut rng, correlated);
    let mut dense = map.dense(&start);
    let mut parked = 0;
    for step in 0..STEPS {
        move_on(&mut rng, &mut joint, &mut dense);
        // Now and then match up to three keyframes; else an update from tracks only.
        let mut ids: Vec<u64> = Vec::new();
        if step % 3 == 0 {
            for _ in 0..rng.random_range(1..4) {
                let id = rng.random_range(0..KEYFRAMES);
                if !ids.contains(&id) {
                    ids.push(id);
                }
            }
        }
        for &id in &ids {
            let cross = map.cross(id, &joint);
            joint.held.pull(id, &map.keyframe(id), &cross);
        }
        let touched: Vec<usize> = (FIXED..dense.active).collect();
        let columns = Columns {
            active: std::iter::once(FIXED..dense.active).filter(|range| !range.is_empty()).collect(),
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
        let mut correction = DVector::zeros(0);
        joint.measurement_update(&information, &mut correction).unwrap();
        let expected = dense.update(&full, &residual);
        assert!(
            (correction - &expected).amax() < 1e-9 * (1.0 + expected.amax()),
            "correction at step {step}"
        );
        joint.held.park_unused();
        parked = parked.max(joint.held.parked_len());
        let active = dense.covariance.view((0, 0), (dense.active, dense.active)).into_owned();
        assert!(
            relative(&joint.active().view().into_owned(), &active) < 1e-9,
            "covariance at step {step}: {}",
            relative(&joint.active().view().into_owned(), &active)
        );
        // The newest clone is still a copy of the body's pose: without it the covariance has full rank.
        let rank = dense.active - POSE;
        assert!(
            joint.active().view().view((0, 0), (rank, rank)).cholesky().is_some(),
            "not positive definite at step {step}"
        );
    }
    assert!(parked > 0, "nothing was parked: the law was not tried");
    for id in joint.held.ids().collect::<Vec<_>>() {
        let slot = joint.held.pull(id, &map.keyframe(id), &[]);
        let expected = dense.covariance.view((0, dense.column_of(id)), (dense.active, 6)).into_owned();
        assert!((joint.held.cross(slot) - expected).amax() < 1e-9, "keyframe {id}");
        // Schmidt: what the map said of a keyframe is never changed.
        assert_eq!(
            joint.held.covariance_of(&[slot]),
            DMatrix::from_column_slice(6, 6, map.block(id, id).as_slice())
        );
        assert_eq!(joint.held.get(slot).global_from_keyframe, map.keyframe(id));
    }
}

/// Propagates the first 15 numbers, clones, marginalizes, in both filters.
fn move_on(rng: &mut StdRng, joint: &mut JointCovariance, dense: &mut Dense) {
    let transition = DMatrix::identity(FIXED, FIXED)
        + DMatrix::from_fn(FIXED, FIXED, |_, _| rng.random_range(-0.05..0.05));
    let noise = spd(rng, FIXED, 1e-3);
    joint.time_update(
        &ImuMatrix::from_column_slice(transition.as_slice()),
        &ImuMatrix::from_column_slice(noise.as_slice()),
    );
    let mut active = DMatrix::identity(dense.active, dense.active);
    active.view_mut((0, 0), (FIXED, FIXED)).copy_from(&transition);
    let mut full_noise = DMatrix::zeros(dense.covariance.nrows(), dense.covariance.nrows());
    full_noise.view_mut((0, 0), (FIXED, FIXED)).copy_from(&noise);
    let full = dense.with_keyframes(&active, dense.active);
    dense.left_multiply(&full, &full_noise);

    let ranges = if dense.active > FIXED + 4 * POSE {
        vec![0..FIXED, FIXED + POSE..dense.active, 0..POSE]
    } else {
        vec![0..dense.active, 0..POSE]
    };
    joint.gather(&ranges);
    let source: Vec<usize> = ranges.into_iter().flatten().collect();
    let mut select = DMatrix::zeros(source.len(), dense.active);
    for (row, &column) in source.iter().enumerate() {
        select[(row, column)] = 1.0;
    }
    let full = dense.with_keyframes(&select, source.len());
    let silent = DMatrix::zeros(full.nrows(), full.nrows());
    dense.left_multiply(&full, &silent);
    dense.active = source.len();
}

#[test]
fn it_equals_the_dense_filter_with_keyframes_parked_and_used_again() {
    for seed in 0..2 {
        check(seed, false, 6);
    }
}

#[test]
fn it_equals_the_dense_filter_with_cross_covariances_of_the_map() {
    for seed in 10..12 {
        check(seed, true, 6);
    }
}

#[test]
fn a_map_that_knows_a_keyframe_exactly_is_no_fault_of_the_filter() {
    // A builder that fixes its gauge at the first keyframe gives it no covariance at all.
    let mut joint = JointCovariance::new(DMatrix::identity(21, 21) * 0.1, 6);
    let slot = joint.held.pull(1, &PoseWithCovariance::exact(Pose::identity()), &[]);
    let mut information =
        Information::new(Columns { keyframes: vec![slot], ..Columns::of_active(std::iter::once(15..21)) });
    let jacobian = DMatrix::from_fn(8, 12, |row, column| ((3 * row + column) as f64).sin());
    information.add(&jacobian, &DVector::from_element(8, 0.1));
    assert!(joint.innovation_squared(&information).is_ok(), "reported as a diverged filter");
    assert!(
        joint.measurement_update(&information, &mut DVector::zeros(0)).is_ok(),
        "reported as a diverged filter"
    );
}
