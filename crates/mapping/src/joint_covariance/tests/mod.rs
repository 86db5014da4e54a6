//! Laws of what is stated instead of a joint covariance, on random trajectories of which the exact one is known.

mod trajectories;

use adjustment::POSE;
use geometry::rotation::skew;
use nalgebra::{Cholesky, DMatrix, Matrix6};
use rand::{SeedableRng, rngs::StdRng};

use super::*;
use trajectories::{Place, exact, positions};

const PLACES: [Place; 3] = [Place::Street, Place::Rounds, Place::Town];
/// For 150 poses what [`FORM`] is for 750: a pose has 8 times as many neighbours in each direction as there are poses from
/// one anchor to the next.
const SMALL: Form = Form { all_up_to: 20, anchors: 27, neighbours: 90 };
/// What was stated before: tapered blocks only.
const TAPERED: Form = Form { all_up_to: 20, anchors: 0, neighbours: 40 };

/// A trajectory with its exact covariance.
struct Trajectory {
    positions: Vec<Vector3<f64>>,
    exact: DMatrix<f64>,
}

impl Trajectory {
    fn new(place: Place, count: usize, seed: u64) -> Trajectory {
        let positions = positions(place, count, &mut StdRng::seed_from_u64(seed));
        Trajectory { exact: exact(&positions), positions }
    }

    /// What is stated, and the matrix that follows from it.
    fn stated(&self, form: Form) -> (Blocks, DMatrix<f64>) {
        let count = self.positions.len();
        let column = |j: usize| (0..count).map(|i| block(&self.exact, i, j)).collect();
        let blocks = stated(form, &self.positions, column, |_, _| {});
        let mut whole = DMatrix::zeros(POSE * count, POSE * count);
        let mut add = |i: usize, j: usize, block: &Matrix6<f64>| {
            let mut at = whole.fixed_view_mut::<POSE, POSE>(POSE * i, POSE * j);
            at += block;
        };
        for (i, own) in blocks.own.iter().enumerate() {
            add(i, i, own);
        }
        for (i, j, block) in &blocks.cross {
            add(*i, *j, block);
            add(*j, *i, &block.transpose());
        }
        for (i, of_i) in blocks.common.iter().enumerate() {
            for (j, of_j) in blocks.common.iter().enumerate().filter(|(j, _)| *j != i) {
                add(i, j, &(of_i * of_j.transpose()));
            }
        }
        (blocks, whole)
    }

    /// Covariance of the pose `j` relative to the pose `i`, in G.
    fn relative(&self, matrix: &DMatrix<f64>, i: usize, j: usize) -> Matrix6<f64> {
        let mut moved = Matrix6::identity();
        let turned = -skew(&(self.positions[j] - self.positions[i]));
        moved.fixed_view_mut::<3, 3>(3, 0).copy_from(&turned);
        let cross = moved * block(matrix, i, j);
        moved * block(matrix, i, i) * moved.transpose() + block(matrix, j, j) - cross - cross.transpose()
    }

    /// Exact over stated variance of relative poses.
    ///
    /// # Arguments
    /// * `apart`: of poses so many steps from each other.
    fn of_relative_poses(&self, stated: &DMatrix<f64>, apart: std::ops::Range<usize>) -> Ratios {
        let count = self.positions.len();
        let pairs =
            (0..count).flat_map(|j| (0..j).map(move |i| (i, j))).filter(|(i, j)| apart.contains(&(j - i)));
        let ratios = pairs.step_by(3).map(|(i, j)| {
            let [of, over] = [&self.exact, stated].map(|matrix| self.relative(matrix, i, j));
            let [of, over] =
                [of, over].map(|matrix| DMatrix::from_column_slice(POSE, POSE, matrix.as_slice()));
            Ratios::of(&of, &over)
        });
        Ratios::all(ratios)
    }
}

fn block(matrix: &DMatrix<f64>, i: usize, j: usize) -> Matrix6<f64> {
    matrix.fixed_view::<POSE, POSE>(POSE * i, POSE * j).into()
}

/// Variances in all directions over other ones in the same directions.
#[derive(Clone, Copy, Debug)]
struct Ratios {
    least: f64,
    most: f64,
    mean: f64,
}

impl Ratios {
    /// Of two covariances; infinite where the second one is not positive definite.
    fn of(variance: &DMatrix<f64>, over: &DMatrix<f64>) -> Ratios {
        let Some(root) = Cholesky::new(over.clone()) else {
            return Ratios { least: 0.0, most: f64::INFINITY, mean: f64::INFINITY };
        };
        let half = root.l().solve_lower_triangular(variance).unwrap();
        let whitened = root.l().solve_lower_triangular(&half.transpose()).unwrap();
        let values = ((&whitened + whitened.transpose()) * 0.5).symmetric_eigenvalues();
        Ratios { least: values.min(), most: values.max(), mean: values.mean() }
    }

    fn all(ratios: impl Iterator<Item = Ratios>) -> Ratios {
        let mut all = Ratios { least: f64::INFINITY, most: 0.0, mean: 0.0 };
        let mut count = 0.0;
        for ratio in ratios {
            all.least = all.least.min(ratio.least);
            all.most = all.most.max(ratio.most);
            all.mean += ratio.mean;
            count += 1.0;
        }
        Ratios { mean: all.mean / count, ..all }
    }
}

#[test]
fn relative_poses_near_and_far_keep_their_variance() {
    for place in PLACES {
        let trajectory = Trajectory::new(place, 150, 1);
        let (_, stated) = trajectory.stated(SMALL);
        for apart in [1..2, 2..9, 9..41, 41..150] {
            let ratios = trajectory.of_relative_poses(&stated, apart.clone());
            let right = ratios.most < 1.02 && ratios.least > 0.8 && (0.95..1.01).contains(&ratios.mean);
            assert!(right, "{place:?}, {apart:?} apart: {ratios:?}");
        }
    }
}

#[test]
fn no_combination_of_errors_is_understated_by_much() {
    for place in PLACES {
        let trajectory = Trajectory::new(place, 150, 2);
        let (_, stated) = trajectory.stated(SMALL);
        let ratios = Ratios::of(&trajectory.exact, &stated);
        let right = ratios.most < 1.5 && ratios.least > 0.6 && (0.95..1.0).contains(&ratios.mean);
        assert!(right, "{place:?}: {ratios:?}");
    }
}

/// The laws above have power: what was stated before breaks them.
#[test]
fn tapered_blocks_alone_err_both_ways() {
    for place in PLACES {
        let trajectory = Trajectory::new(place, 150, 1);
        let (blocks, stated) = trajectory.stated(TAPERED);
        assert!(blocks.common.iter().all(|factor| factor.ncols() == 0));
        let near = trajectory.of_relative_poses(&stated, 1..2);
        assert!(near.mean < 0.8, "{place:?}: {near:?}");
        let all = Ratios::of(&trajectory.exact, &stated);
        assert!(all.most > 4.0, "{place:?}: {all:?}");
    }
}

#[test]
fn what_is_stated_is_a_covariance_whatever_is_left_out() {
    for (place, seed) in PLACES.into_iter().zip(3..) {
        let trajectory = Trajectory::new(place, 60, seed);
        for anchors in [0, 1, 5, 60, 100] {
            for neighbours in [2, 10, 60] {
                let form = Form { all_up_to: 20, anchors, neighbours };
                let (blocks, stated) = trajectory.stated(form);
                assert!(Cholesky::new(stated.clone()).is_some(), "{place:?}, {form:?}");
                for (at, own) in blocks.own.iter().enumerate() {
                    assert_eq!(*own, block(&trajectory.exact, at, at));
                }
                if anchors >= 60 {
                    assert!((stated - &trajectory.exact).amax() < 1e-6 * trajectory.exact.amax());
                }
            }
        }
    }
}

#[test]
fn small_maps_state_every_block_as_it_is() {
    let trajectory = Trajectory::new(Place::Town, 30, 7);
    let (blocks, stated) = trajectory.stated(Form { all_up_to: 30, ..SMALL });
    assert!(blocks.common.is_empty() && blocks.cross.len() == 30 * 29 / 2);
    assert_eq!(stated, trajectory.exact);
}

#[test]
#[ignore = "prints figures, takes minutes"]
fn figures() {
    for place in PLACES {
        let trajectory = Trajectory::new(place, 200, 1);
        for (anchors, neighbours) in [(0, 20), (16, 50), (16, 100), (32, 50), (32, 100)] {
            let (_, stated) = trajectory.stated(Form { all_up_to: 20, anchors, neighbours });
            println!("{place:?}, {anchors} anchors, {neighbours} neighbours: exact over stated variance");
            println!("    any combination: {:.3?}", Ratios::of(&trajectory.exact, &stated));
            for apart in [1..2, 2..9, 9..41, 41..200] {
                let ratios = trajectory.of_relative_poses(&stated, apart.clone());
                println!("    {apart:?} apart: {ratios:.3?}");
            }
        }
    }
}
