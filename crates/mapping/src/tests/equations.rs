//! Laws of the joint covariance.

use adjustment::{NormalEquations, POSE, StateLayout};
use nalgebra::{DMatrix, Vector3};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use super::dense;
use crate::joint_covariance::{FrameAndScale, joint_covariance};
use crate::stored_poses::Posterior;

/// Random reduced equations of poses in a chain with a few loops, and the same as a dense matrix.
fn chain_with_loops(rng: &mut StdRng, poses: usize) -> (NormalEquations, DMatrix<f64>) {
    let layout = StateLayout { views: poses, motions: 0 };
    let mut equations = NormalEquations::new(layout);
    let mut dense = DMatrix::identity(layout.dim(), layout.dim()) * 0.3;
    for pose in 0..poses {
        equations.add_information(layout.pose(pose), &(DMatrix::identity(POSE, POSE) * 0.3), &[0.0; POSE]);
    }
    let pairs = (1..poses).map(|i| (i - 1, i)).chain([(0, poses - 1), (2, poses / 2), (poses - 2, 1)]);
    for (i, j) in pairs.collect::<Vec<_>>() {
        let jacobian = DMatrix::from_fn(POSE, 2 * POSE, |_, _| rng.random_range(-1.0..1.0));
        let information = jacobian.tr_mul(&jacobian);
        let indices: Vec<usize> = layout.pose(i).chain(layout.pose(j)).collect();
        for (row, &at) in indices.iter().enumerate() {
            for (column, &other) in indices.iter().enumerate() {
                dense[(at, other)] += information[(row, column)];
            }
        }
        equations.add_information(indices, &information, &[0.0; 2 * POSE]);
    }
    (equations, dense)
}

#[test]
fn the_joint_covariance_is_the_inverse_of_the_equations() {
    let mut rng = StdRng::seed_from_u64(11);
    let (equations, full) = chain_with_loops(&mut rng, 12);
    // Of some of the poses only: the others are marginalized.
    let views = [0, 2, 3, 4, 5, 7, 8, 9, 11];
    let covariance = equations.covariance().unwrap();
    let posterior = Posterior::new(&covariance, &[], &views, &[]);
    let (whole, as_adjusted) = ((&views[..], views.len()), FrameAndScale::AsAdjusted);
    let joint = joint_covariance(&posterior, whole, &[Vector3::zeros(); 9], as_adjusted, |_, _| ());
    let inverse = full.try_inverse().unwrap();
    let expected = DMatrix::from_fn(54, 54, |row, column| {
        inverse[(6 * views[row / 6] + row % 6, 6 * views[column / 6] + column % 6)]
    });
    let own: Vec<_> = joint.own.values().copied().collect();
    let at = |view: usize| views.iter().position(|&other| other == view).unwrap();
    let cross = joint.cross.iter().map(|(i, j, block)| (at(*i), at(*j), *block));
    assert!((dense(&own, cross) - &expected).amax() < 1e-9 * expected.amax());
}

#[test]
fn what_a_large_map_leaves_out_leaves_a_covariance() {
    let mut rng = StdRng::seed_from_u64(12);
    let covariance = chain_with_loops(&mut rng, 420).0.covariance().unwrap();
    let positions: Vec<_> = (0..420).map(|i| Vector3::new(f64::from(i), 0.0, 0.0)).collect();
    let views: Vec<usize> = (0..420).collect();
    let posterior = Posterior::new(&covariance, &[], &views, &[]);
    let (whole, as_adjusted) = ((&views[..], views.len()), FrameAndScale::AsAdjusted);
    let joint = joint_covariance(&posterior, whole, &positions, as_adjusted, |_, _| ());
    assert!(joint.cross.len() < 420 * 419 / 2 && joint.cross.len() > 420 * 30, "{}", joint.cross.len());
    let own: Vec<_> = joint.own.values().copied().collect();
    let mut stated = dense(&own, joint.cross);
    for (i, of_i) in &joint.common {
        for (j, of_j) in joint.common.iter().filter(|(j, _)| *j != i) {
            let mut block = stated.fixed_view_mut::<6, 6>(6 * i, 6 * j);
            block += of_i * of_j.transpose();
        }
    }
    assert!(stated.clone().cholesky().is_some(), "{}", stated.symmetric_eigenvalues().min());
}
