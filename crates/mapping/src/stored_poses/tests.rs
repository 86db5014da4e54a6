//! The law of tied keyframes: adjusting them, with the others following, is adjusting all of them.

use adjustment::{Bundle, Factor, NormalEquations, StateCovariance, StateLayout, pose_error};
use geometry::pose::Pose;
use geometry::uncertain_pose::PoseWithCovariance;
use map::contents::MapContents;
use map::model::{CommonError, Keyframe, KeyframeCrossCovariance, MapMetadata};
use nalgebra::{DMatrix, Matrix6, Matrix6xX, SMatrix, Vector3, Vector6};
use protocol::DescriptorKind;
use rand::{RngExt, SeedableRng, rngs::StdRng};

use super::*;
use crate::tests::camera;

const KEYFRAMES: usize = 9;
const TIED: [usize; 3] = [1, 4, 5];

/// A random map without landmarks: common errors, and blocks between neighbours.
fn random_map(rng: &mut StdRng, extent_m: f64) -> MapContents {
    let mut small = |size: f64| Vector3::from_fn(|_, _| size * rng.random_range(-1.0..1.0));
    let mut contents = MapContents::empty(MapMetadata::new("hall", "test", DescriptorKind::Binary, 32));
    for at in 0..KEYFRAMES {
        let pose = Pose::new(geometry::rotation::exp(&small(0.5)), small(extent_m));
        contents.keyframes.push(Keyframe {
            id: at as u64 + 1,
            stamp_ns: at as i64,
            global_from_keyframe: PoseWithCovariance::new(pose, Matrix6::zeros()),
            camera: camera(),
            features: None,
        });
    }
    let mut factor = |columns: usize| Matrix6xX::from_fn(columns, |_, _| 1e-3 * rng.random_range(-1.0..1.0));
    // What remains: each pose shares some noise with the next.
    let own: Vec<_> = (0..KEYFRAMES).map(|_| factor(6)).collect();
    let next: Vec<_> = (0..KEYFRAMES).map(|_| factor(3)).collect();
    let before: Vec<_> = (0..KEYFRAMES).map(|_| factor(3)).collect();
    for at in 0..KEYFRAMES {
        let common = factor(4);
        let mut covariance = &common * common.transpose() + &own[at] * own[at].transpose();
        covariance += &next[at] * next[at].transpose();
        if at > 0 {
            covariance += &before[at] * before[at].transpose();
            let block = &next[at - 1] * before[at].transpose();
            contents.cross_covariances.push(KeyframeCrossCovariance {
                a: at as u64,
                b: at as u64 + 1,
                block,
            });
        }
        contents.keyframes[at].global_from_keyframe.covariance = covariance;
        contents.common_errors.push(CommonError { keyframe: at as u64 + 1, factor: common });
    }
    contents
}

fn of_poses(poses: &[Pose]) -> Bundle {
    Bundle { poses: poses.to_vec(), ..Bundle::default() }
}

/// Some maps, measured in some of their keyframes.
struct Adjustment {
    stored: Vec<StoredPoses>,
    layout: StateLayout,
    poses: Vec<Pose>,
}

impl Adjustment {
    /// # Arguments
    /// * `tied`: of each map.
    fn new(maps: &[MapContents], tied: &[usize], free: impl Fn(usize) -> bool) -> Adjustment {
        let stored = |(at, map): (usize, &MapContents)| {
            let stored = StoredPoses::of_map(map, KEYFRAMES * at, tied.to_vec()).unwrap();
            if free(at) { stored.without_frame().unwrap() } else { stored }
        };
        let poses =
            maps.iter().flat_map(|map| &map.keyframes).map(|keyframe| keyframe.global_from_keyframe.pose);
        Adjustment {
            stored: maps.iter().enumerate().map(stored).collect(),
            layout: StateLayout { views: KEYFRAMES * maps.len(), motions: 0 },
            poses: poses.collect(),
        }
    }

    /// Measures the tied poses of all maps, each relative to the next, and adjusts them.
    fn adjust(&mut self, rng: &mut StdRng) -> StateCovariance {
        let of_maps = (0..self.stored.len()).flat_map(|map| TIED.map(|keyframe| KEYFRAMES * map + keyframe));
        let measured: Vec<usize> = of_maps.collect();
        let offsets: Vec<Vector6<f64>> = measured
            .windows(2)
            .map(|_| Vector6::from_fn(|_, _| 3e-3 * rng.random_range(-1.0..1.0)))
            .collect();
        let start = self.poses.clone();
        let mut jacobian = SMatrix::<f64, POSE, { 2 * POSE }>::zeros();
        jacobian.fixed_view_mut::<POSE, POSE>(0, 0).fill_with_identity();
        jacobian.fixed_view_mut::<POSE, POSE>(0, POSE).copy_from(&-Matrix6::identity());
        let information = Matrix6::identity() / 1e-3_f64.powi(2);
        let mut covariance = None;
        for _ in 0..10 {
            let bundle = of_poses(&self.poses);
            let mut equations = NormalEquations::new(self.layout);
            for stored in &self.stored {
                stored.prior().add_to(&mut equations, &bundle, f64::INFINITY);
                stored.held().for_each(|held| held.add_to(&mut equations, &bundle, f64::INFINITY));
            }
            for (pair, offset) in measured.windows(2).zip(&offsets) {
                let error = |view: usize| start[view].local(&self.poses[view]);
                let residual = error(pair[0]) - error(pair[1]) - offset;
                let indices = pair.iter().flat_map(|view| self.layout.pose(*view));
                equations.add_residual(indices, &jacobian, &information, &residual);
            }
            let step = equations.solve(0.0).unwrap().states;
            for (view, pose) in self.poses.iter_mut().enumerate() {
                *pose = pose.retract(&step.fixed_rows::<POSE>(POSE * view).into_owned());
            }
            covariance = equations.covariance();
        }
        for stored in &self.stored {
            stored.follow(&mut self.poses);
        }
        covariance.unwrap()
    }

    fn covariance(&self, covariance: &StateCovariance) -> DMatrix<f64> {
        let views: Vec<usize> = (0..self.layout.views).collect();
        let posterior = Posterior::new(covariance, &self.poses, &views, &self.stored);
        let mut covariance = DMatrix::zeros(self.layout.dim(), self.layout.dim());
        for column in &views {
            for (row, block) in posterior.column(*column).iter().enumerate() {
                covariance.fixed_view_mut::<POSE, POSE>(POSE * row, POSE * column).copy_from(block);
            }
        }
        covariance
    }
}

fn assert_the_same(maps: &[MapContents], free: impl Fn(usize) -> bool + Copy) {
    let all: Vec<usize> = (0..KEYFRAMES).collect();
    let [some, whole] = [&TIED[..], &all].map(|tied| {
        let mut adjustment = Adjustment::new(maps, tied, free);
        let covariance = adjustment.adjust(&mut StdRng::seed_from_u64(5));
        let covariance = adjustment.covariance(&covariance);
        (adjustment.poses, covariance)
    });
    let start = Adjustment::new(maps, &all, free).poses;
    let moved = whole.0.iter().zip(&start).map(|(pose, start)| start.local(pose).norm()).fold(0.0, f64::max);
    let apart = some.0.iter().zip(&whole.0).map(|(one, other)| other.local(one).norm()).fold(0.0, f64::max);
    assert!(moved > 5e-4 && apart < 1e-6 * moved, "moved {moved}, apart {apart}");
    let scale = whole.1.amax();
    assert!((&some.1 - &whole.1).amax() < 1e-5 * scale, "{} of {scale}", (&some.1 - &whole.1).amax());
    assert!((&some.1 - some.1.transpose()).amax() < 1e-9 * scale);
    assert!(some.1.clone().cholesky().is_some());
}

#[test]
fn following_keyframes_are_where_an_adjustment_of_all_puts_them() {
    let mut rng = StdRng::seed_from_u64(1);
    let maps = [random_map(&mut rng, 3.0)];
    assert_the_same(&maps, |_| false);
}

/// The update of Schmidt 1966, with a dense filter: the gain of the map's rows is zero.
#[test]
fn a_considered_map_stays_as_it_is_and_what_is_located_in_it_is_as_certain_as_with_a_schmidt_update() {
    let mut rng = StdRng::seed_from_u64(6);
    let maps = [random_map(&mut rng, 3.0), random_map(&mut rng, 3.0)];
    let mut adjustment = Adjustment::new(&maps, &TIED, |_| false);
    let states = adjustment.adjust(&mut StdRng::seed_from_u64(7));
    let optimal = adjustment.covariance(&states);
    // Errors are relative to the stored poses in one, to the adjusted ones in the other.
    let mut to_stored = DMatrix::identity(optimal.nrows(), optimal.ncols());
    for view in KEYFRAMES..2 * KEYFRAMES {
        let mean = &maps[1].keyframes[view - KEYFRAMES].global_from_keyframe.pose;
        let jacobian = pose_error(mean, &adjustment.poses[view]).1;
        to_stored.fixed_view_mut::<POSE, POSE>(POSE * view, POSE * view).copy_from(&jacobian);
    }
    let optimal = &to_stored * optimal * to_stored.transpose();
    let considered = adjustment.stored.pop().unwrap().considered();
    adjustment.stored.push(considered);
    let stated = adjustment.covariance(&states);
    let (of_first, all) = (POSE * KEYFRAMES, adjustment.layout.dim());
    let of_map = MapCovariance::of_map(&maps[1]).unwrap();
    for keyframe in 0..KEYFRAMES {
        let column = stated.view((of_first, of_first + POSE * keyframe), (all - of_first, POSE));
        assert!((column - of_map.column(keyframe)).amax() < 1e-15);
    }
    // P+ of a Schmidt update differs from that of the optimal one by what the map would have learned: K_m S K_m^T.
    let difference = &stated - &optimal;
    let scale = optimal.amax();
    assert!(difference.view((0, 0), (of_first, all)).amax() < 1e-9 * scale, "{difference}");
    let learned = difference.view((of_first, of_first), (all - of_first, all - of_first)).into_owned();
    let least = learned.symmetric_eigen().eigenvalues.min();
    assert!(least > -1e-5 * scale, "{least} of {scale}");
    assert!(stated.cholesky().is_some());
}

#[test]
fn so_are_those_of_two_maps_one_of_which_has_no_frame() {
    let mut rng = StdRng::seed_from_u64(2);
    let maps = [random_map(&mut rng, 3.0), random_map(&mut rng, 3.0)];
    assert_the_same(&maps, |map| map == 0);
}

/// A column of the covariance is a change of the states by which the keyframes that follow move as their rows of it say.
#[test]
fn keyframes_that_follow_move_as_their_covariance_with_what_was_adjusted_says() {
    let mut rng = StdRng::seed_from_u64(8);
    let maps = [random_map(&mut rng, 3.0), random_map(&mut rng, 3.0)];
    let mut adjustment = Adjustment::new(&maps, &TIED, |map| map == 0);
    let states = adjustment.adjust(&mut StdRng::seed_from_u64(9));
    let views: Vec<usize> = (0..adjustment.layout.views).collect();
    let posterior = Posterior::new(&states, &adjustment.poses, &views, &adjustment.stored);
    let tied = TIED[1];
    let changes = states.columns(adjustment.layout.pose(tied));
    let column = posterior.column(tied);
    for axis in 0..POSE {
        let moved = posterior.moved(&changes.column(axis).into_owned(), adjustment.layout);
        for (view, (moved, block)) in moved.iter().zip(&column).enumerate() {
            let apart = (moved - block.column(axis)).amax();
            assert!(apart < 1e-9 * block.amax().max(1e-9), "view {view}: {apart}");
        }
    }
}

#[test]
fn a_map_that_lists_pairs_says_the_same_as_one_with_common_errors() {
    let common = random_map(&mut StdRng::seed_from_u64(3), 3.0);
    let mut listed = common.clone();
    listed.cross_covariances.clear();
    listed.common_errors.clear();
    for b in 1..KEYFRAMES {
        for a in 0..b {
            let neighbours = common
                .cross_covariances
                .iter()
                .find(|cross| (cross.a, cross.b) == (a as u64 + 1, b as u64 + 1));
            let block = neighbours.map_or(Matrix6::zeros(), |cross| cross.block)
                + common.common_errors[a].covariance_with(&common.common_errors[b]);
            listed.cross_covariances.push(KeyframeCrossCovariance {
                a: a as u64 + 1,
                b: b as u64 + 1,
                block,
            });
        }
    }
    let [listed, common] = [listed, common].map(|map| MapCovariance::of_map(&map).unwrap());
    for keyframe in 0..KEYFRAMES {
        assert!((listed.column(keyframe) - common.column(keyframe)).amax() < 1e-15);
    }
    let z = DMatrix::from_fn(POSE * TIED.len(), 2, |row, column| (row + 5 * column) as f64);
    let [one, other] = [&listed, &common].map(|map| map.times(&TIED, &z, &[true; KEYFRAMES]));
    assert!((one - other).amax() < 1e-12);
    assert!((listed.of_keyframes(&TIED) - common.of_keyframes(&TIED)).amax() < 1e-15);
}

#[test]
fn a_map_without_its_frame_says_nothing_of_yaw_and_position() {
    let map = random_map(&mut StdRng::seed_from_u64(4), 3.0);
    let stored = || StoredPoses::of_map(&map, 0, TIED.to_vec()).unwrap();
    let [with, without] = [stored().prior(), stored().without_frame().unwrap().prior()];
    let poses: Vec<Pose> = map.keyframes.iter().map(|keyframe| keyframe.global_from_keyframe.pose).collect();
    let small =
        Pose::new(geometry::rotation::exp(&Vector3::new(0.0, 0.0, 1e-4)), Vector3::new(3e-4, -2e-4, 1e-4));
    let turned = of_poses(&poses.iter().map(|pose| small.compose(pose)).collect::<Vec<_>>());
    assert!(without.cost(&turned, 1.0) < 1e-4 * with.cost(&turned, 1.0));
    let mut bent = poses;
    bent[1] = small.compose(&bent[1]);
    assert!(without.cost(&of_poses(&bent), 1.0) > 0.1 * with.cost(&of_poses(&bent), 1.0));
}
