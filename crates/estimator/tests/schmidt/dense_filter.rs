//! The reference: a Schmidt-Kalman filter with one dense matrix over the active state and every keyframe of the map, and
//! random steps that it and the filter under test make together.

use estimator::covariance::JointCovariance;
use estimator::linear_algebra::dense::Dense;
use estimator::linear_algebra::dependence::Dependence;
use estimator::measurement::StateBlocks;
use estimator::propagation::ImuMatrix;
use geometry::{Pose, PoseWithCovariance};
use nalgebra::{DMatrix, Matrix3, Matrix6, Matrix6xX, SVector};
use rand::{RngExt as _, rngs::StdRng};

/// Size of the IMU state, which is never marginalized.
pub const FIXED: usize = 15;
pub const POSE: usize = 6;
const LANDMARK: usize = 3;
/// Keyframes of the map that share one covariance.
pub const BLOCK: u64 = 4;

pub fn spd(rng: &mut StdRng, n: usize, scale: f64) -> DMatrix<f64> {
    let draw = DMatrix::from_fn(n, n, |_, _| rng.random_range(-1.0..1.0));
    (&draw * draw.transpose() + DMatrix::identity(n, n)) * scale
}

/// How the errors of the map's keyframes are correlated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Correlation {
    /// Not at all.
    None,
    /// Blocks of four keyframes share one covariance.
    Blocks,
    /// Dimension of the error common to all keyframes but those of every third block.
    BlocksAndCommon(usize),
}

/// The map.
pub struct Map {
    blocks: Vec<DMatrix<f64>>,
    /// The errors common to keyframes.
    common: Vec<Matrix6xX<f64>>,
    correlation: Correlation,
    pub keyframes: u64,
}

impl Map {
    pub fn new(rng: &mut StdRng, keyframes: u64, scale: f64, correlation: Correlation) -> Self {
        let blocks = (0..keyframes / BLOCK).map(|_| spd(rng, POSE * BLOCK as usize, scale)).collect();
        let common = (0..keyframes).map(|id| match correlation {
            Correlation::BlocksAndCommon(dim) if (id / BLOCK) % 3 != 2 => {
                Matrix6xX::from_fn(dim, |_, _| (scale / dim as f64).sqrt() * rng.random_range(-5.0..5.0))
            }
            _ => Matrix6xX::zeros(0),
        });
        Self { blocks, common: common.collect(), correlation, keyframes }
    }

    pub fn block(&self, a: u64, b: u64) -> Matrix6<f64> {
        let [of_a, of_b] = [a, b].map(|id| &self.common[id as usize]);
        let dim = of_a.ncols().min(of_b.ncols());
        self.block_of_rests(a, b) + of_a.columns(0, dim) * of_b.columns(0, dim).transpose()
    }

    /// What is not common to all.
    fn block_of_rests(&self, a: u64, b: u64) -> Matrix6<f64> {
        let (group_a, group_b) = ((a / BLOCK) as usize, (b / BLOCK) as usize);
        if a != b && (group_a != group_b || self.correlation == Correlation::None) {
            return Matrix6::zeros();
        }
        let corner = (POSE * (a % BLOCK) as usize, POSE * (b % BLOCK) as usize);
        self.blocks[group_a].fixed_view::<6, 6>(corner.0, corner.1).into_owned()
    }

    pub fn keyframe(&self, id: u64) -> PoseWithCovariance {
        PoseWithCovariance { pose: Pose::identity(), covariance: self.block(id, id) }
    }

    /// The same map with other names: keyframe `BLOCK + k` becomes `k`, and so on round.
    pub fn renamed(mut self) -> Self {
        self.blocks.rotate_left(1);
        self.common.rotate_left(BLOCK as usize);
        self
    }

    /// The same map after the errors of some keyframes turned to their opposite.
    pub fn opposite(mut self, ids: &[u64]) -> Self {
        for &id in ids {
            self.common[id as usize].neg_mut();
        }
        self
    }

    /// Blocks towards the keyframes that are held, as the server sends them.
    fn cross(&self, id: u64, joint: &JointCovariance) -> Vec<(u64, Matrix6<f64>)> {
        let others = joint.held.ids().filter(|&other| other != id);
        let blocks = others.map(|other| (other, self.block_of_rests(id, other)));
        blocks.filter(|(_, block)| *block != Matrix6::zeros()).collect()
    }

    /// Activates a keyframe, or inserts it with what the server sends.
    pub fn activate_one(&self, id: u64, joint: &mut JointCovariance) -> usize {
        let cross = self.cross(id, joint);
        joint.held.activate_or_insert(id, &self.keyframe(id), &self.common[id as usize], &cross)
    }

    /// Activates matched keyframes, or inserts them; `at_once`: together.
    pub fn activate(&self, ids: &[u64], joint: &mut JointCovariance, at_once: bool) {
        if at_once {
            joint.held.activate(ids);
        }
        for &id in ids {
            self.activate_one(id, joint);
        }
    }
}

/// A joint covariance of the active state and the whole map. `P_NN` never changes.
pub struct DenseFilter {
    pub covariance: DMatrix<f64>,
    pub active: usize,
    keyframes: usize,
    landmarks: usize,
}

impl DenseFilter {
    /// Holds the whole map from the start.
    pub fn new(start: &DMatrix<f64>, map: &Map) -> Self {
        let (active, keyframes) = (start.nrows(), map.keyframes as usize);
        let mut covariance = DMatrix::zeros(active + POSE * keyframes, active + POSE * keyframes);
        covariance.view_mut((0, 0), (active, active)).copy_from(start);
        for a in 0..keyframes {
            for b in 0..keyframes {
                let corner = (active + POSE * a, active + POSE * b);
                let block = map.block(a as u64, b as u64);
                covariance.fixed_view_mut::<6, 6>(corner.0, corner.1).copy_from(&block);
            }
        }
        Self { covariance, active, keyframes, landmarks: 0 }
    }

    pub fn column_of(&self, id: u64) -> usize {
        self.active + POSE * id as usize
    }

    pub fn of_active(&self) -> DMatrix<f64> {
        self.covariance.view((0, 0), (self.active, self.active)).into_owned()
    }

    /// `P ← [F 0; 0 I] P [F 0; 0 I]ᵀ + [Q 0; 0 0]`.
    fn transform(&mut self, transition: &DMatrix<f64>, noise: &DMatrix<f64>) {
        let n = POSE * self.keyframes;
        let own = transition * self.of_active() * transition.transpose() + noise;
        let cross = transition * self.covariance.view((0, self.active), (self.active, n));
        self.active = transition.nrows();
        self.assemble(&own, &cross);
    }

    /// The covariance with these blocks of the active state and with the map; that of the map stays.
    fn assemble(&mut self, own: &DMatrix<f64>, cross: &DMatrix<f64>) {
        let (active, n) = cross.shape();
        let old = self.covariance.nrows() - n;
        if active != old {
            let before = std::mem::replace(&mut self.covariance, DMatrix::zeros(active + n, active + n));
            self.covariance.view_mut((active, active), (n, n)).copy_from(&before.view((old, old), (n, n)));
        }
        self.covariance.view_mut((0, 0), (active, active)).copy_from(own);
        self.covariance.view_mut((0, active), (active, n)).copy_from(cross);
        self.covariance.view_mut((active, 0), (n, active)).copy_from(&cross.transpose());
    }

    /// The errors of the map become `turn e`.
    pub fn turn_map(&mut self, turn: &DMatrix<f64>) {
        let (active, n) = (self.active, POSE * self.keyframes);
        let (own, cross) =
            (self.of_active(), self.covariance.view((0, active), (active, n)) * turn.transpose());
        let map = turn * self.covariance.view((active, active), (n, n)) * turn.transpose();
        self.assemble(&own, &cross);
        self.covariance.view_mut((active, active), (n, n)).copy_from(&map);
    }

    /// Columns of a measurement over everything.
    pub fn over_all(&self, jacobian: &DMatrix<f64>, touched: &[usize], ids: &[u64]) -> DMatrix<f64> {
        let mut full = DMatrix::zeros(jacobian.nrows(), self.covariance.nrows());
        for (k, &column) in touched.iter().enumerate() {
            full.column_mut(column).copy_from(&jacobian.column(k));
        }
        for (k, id) in ids.iter().enumerate() {
            let own = jacobian.columns(touched.len() + POSE * k, POSE);
            full.columns_mut(self.column_of(*id), POSE).copy_from(&own);
        }
        full
    }

    /// `H P Hᵀ + I`.
    pub fn innovation(&self, jacobian: &DMatrix<f64>) -> DMatrix<f64> {
        jacobian * &self.covariance * jacobian.transpose()
            + DMatrix::identity(jacobian.nrows(), jacobian.nrows())
    }

    /// The rows of the full gain that Schmidt keeps.
    pub fn gain(&self, jacobian: &DMatrix<f64>) -> DMatrix<f64> {
        let projected = jacobian * self.covariance.columns(0, self.active);
        self.innovation(jacobian).cholesky().unwrap().solve(&projected).transpose()
    }

    /// Any gain for the active state and none for the map, in Joseph's form: true whatever the gain is.
    pub fn update(&mut self, gain: &DMatrix<f64>, jacobian: &DMatrix<f64>) {
        let n = POSE * self.keyframes;
        let mut keep = -gain * jacobian;
        for k in 0..self.active {
            keep[(k, k)] += 1.0;
        }
        let kept = &keep * &self.covariance;
        let own = &kept * keep.transpose() + gain * gain.transpose();
        self.assemble(&own, &kept.columns(self.active, n).into_owned());
    }

    /// Propagates, clones, marginalizes, lets landmarks in and out; in both filters.
    pub fn random_step(&mut self, rng: &mut StdRng, joint: &mut JointCovariance) {
        self.propagate(rng, joint);
        self.gather(joint, &[0..self.active, 0..POSE]);
        if rng.random_bool(0.3) {
            self.depend(rng, joint);
        }
        let clones = FIXED + LANDMARK * self.landmarks;
        if self.active > clones + 5 * POSE {
            self.gather(joint, &[0..clones, clones + POSE..self.active]);
        }
        if self.landmarks < 4 && rng.random_bool(0.3) {
            self.insert(rng, joint);
        } else if self.landmarks > 0 && rng.random_bool(0.2) {
            let leaving = FIXED + LANDMARK * rng.random_range(0..self.landmarks);
            self.gather(joint, &[0..leaving, leaving + LANDMARK..self.active]);
            self.landmarks -= 1;
        }
    }

    fn propagate(&mut self, rng: &mut StdRng, joint: &mut JointCovariance) {
        // Fades a little, so that nothing grows without bound: numbers are compared over thousands of steps.
        let transition = DMatrix::identity(FIXED, FIXED) * 0.97
            + DMatrix::from_fn(FIXED, FIXED, |_, _| rng.random_range(-0.05..0.05));
        let noise = spd(rng, FIXED, 1e-3);
        joint.time_update(
            &ImuMatrix::from_column_slice(transition.as_slice()),
            &ImuMatrix::from_column_slice(noise.as_slice()),
        );
        let mut full = DMatrix::identity(self.active, self.active);
        full.view_mut((0, 0), (FIXED, FIXED)).copy_from(&transition);
        let mut full_noise = DMatrix::zeros(self.active, self.active);
        full_noise.view_mut((0, 0), (FIXED, FIXED)).copy_from(&noise);
        self.transform(&full, &full_noise);
    }

    fn gather(&mut self, joint: &mut JointCovariance, ranges: &[std::ops::Range<usize>]) {
        joint.gather(ranges);
        let source: Vec<usize> = ranges.iter().flat_map(Clone::clone).collect();
        let mut select = DMatrix::zeros(source.len(), self.active);
        for (row, &column) in source.iter().enumerate() {
            select[(row, column)] = 1.0;
        }
        let silent = DMatrix::zeros(source.len(), source.len());
        self.transform(&select, &silent);
    }

    /// The newest clone depends on one more number of the IMU, and all positions on the rotations of their poses.
    fn depend(&mut self, rng: &mut StdRng, joint: &mut JointCovariance) {
        let (begin, of) = (self.active - POSE, rng.random_range(POSE..FIXED));
        let jacobian = SVector::<f64, POSE>::from_fn(|_, _| rng.random_range(-0.1..0.1));
        self.add_dependences(joint, &[Dependence { begin, of, jacobian }]);
        let clones = FIXED + LANDMARK * self.landmarks;
        let positions: Vec<_> = (0..1)
            .chain((clones..self.active).step_by(POSE))
            .map(|of| {
                let jacobian = Matrix3::from_fn(|_, _| rng.random_range(-0.1..0.1));
                Dependence { begin: of + 3, of, jacobian }
            })
            .collect();
        self.add_dependences(joint, &positions);
    }

    fn add_dependences<const R: usize, const C: usize>(
        &mut self,
        joint: &mut JointCovariance,
        dependences: &[Dependence<R, C>],
    ) {
        joint.add_dependences(dependences);
        let mut full = DMatrix::identity(self.active, self.active);
        for Dependence { begin, of, jacobian } in dependences {
            full.fixed_view_mut::<R, C>(*begin, *of).copy_from(jacobian);
        }
        let silent = DMatrix::zeros(self.active, self.active);
        self.transform(&full, &silent);
    }

    /// A landmark that depends on all clones.
    fn insert(&mut self, rng: &mut StdRng, joint: &mut JointCovariance) {
        let at = FIXED + LANDMARK * self.landmarks;
        let of = at..self.active;
        let jacobian = DMatrix::from_fn(LANDMARK, of.len(), |_, _| rng.random_range(-0.5..0.5));
        let noise = spd(rng, LANDMARK, 0.1);
        let columns = StateBlocks::of_active(std::iter::once(of.clone()));
        joint.insert(at, &columns, &Dense::from(jacobian.clone()), std::iter::once(noise.clone()));
        let dim = self.active + LANDMARK;
        let mut full = DMatrix::zeros(dim, self.active);
        full.view_mut((0, 0), (at, at)).fill_with_identity();
        full.view_mut((at, of.start), jacobian.shape()).copy_from(&jacobian);
        full.view_mut((at + LANDMARK, at), (of.len(), of.len())).fill_with_identity();
        let mut full_noise = DMatrix::zeros(dim, dim);
        full_noise.view_mut((at, at), noise.shape()).copy_from(&noise);
        self.transform(&full, &full_noise);
        self.landmarks += 1;
    }
}

/// Up to three different keyframes.
pub fn some_keyframes(rng: &mut StdRng, of: u64) -> Vec<u64> {
    let mut ids: Vec<u64> = (0..rng.random_range(1..4)).map(|_| rng.random_range(0..of)).collect();
    ids.sort_unstable();
    ids.dedup();
    ids
}
