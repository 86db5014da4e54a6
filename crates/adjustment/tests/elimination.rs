//! Eliminating the landmarks is solving everything at once.

use adjustment::{LandmarkBlocks, LandmarkEquations, NormalEquations, StateLayout};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Matrix6x3, Vector3, Vector6};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

#[test]
fn eliminating_landmarks_solves_the_full_equations() {
    let mut rng = StdRng::seed_from_u64(10);
    let (poses, landmarks) = (4, 6);
    let size = 6 * poses + 3 * landmarks;
    let mut run = LandmarkEquations::new(0..poses);
    let mut full = DMatrix::zeros(size, size);
    let mut right = DVector::zeros(size);
    let mut equations = NormalEquations::new(StateLayout { views: poses, motions: 0 });
    for pose in 0..poses {
        let information = Matrix6::identity() * 30.0;
        let gradient = Vector6::from_fn(|_, _| rng.random_range(-1.0..1.0));
        let of_pose = DMatrix::from_column_slice(6, 6, information.as_slice());
        equations.add_information(6 * pose..6 * pose + 6, &of_pose, gradient.as_slice());
        let mut block = full.fixed_view_mut::<6, 6>(6 * pose, 6 * pose);
        block += information;
        let mut part = right.fixed_rows_mut::<6>(6 * pose);
        part += gradient;
    }
    for index in 0..landmarks {
        let (a, b) = (index % poses, (index + 1) % poses);
        let column = 6 * poses + 3 * index;
        let jacobian = |rng: &mut StdRng| DMatrix::from_fn(8, 15, |_, _| rng.random_range(-1.0..1.0));
        let j = jacobian(&mut rng);
        let residual = DVector::from_fn(8, |_, _| rng.random_range(-1.0..1.0));
        let (by_a, by_b, by_landmark) = (j.columns(0, 6), j.columns(6, 6), j.columns(12, 3));
        let six = |matrix: DMatrix<f64>| Matrix6::from_column_slice(matrix.as_slice());
        let coupling = |matrix: DMatrix<f64>| Matrix6x3::from_column_slice(matrix.as_slice());
        let vector = |matrix: DMatrix<f64>| Vector6::from_column_slice(matrix.as_slice());
        let column_residual = DMatrix::from_column_slice(8, 1, residual.as_slice());
        run.add_landmark(&LandmarkBlocks {
            poses: vec![
                (a, six(by_a.transpose() * by_a), vector(by_a.transpose() * &column_residual)),
                (b, six(by_b.transpose() * by_b), vector(by_b.transpose() * &column_residual)),
            ],
            pairs: vec![(a, b, six(by_a.transpose() * by_b))],
            couplings: vec![
                (a, coupling(by_a.transpose() * by_landmark)),
                (b, coupling(by_b.transpose() * by_landmark)),
            ],
            information: Matrix3::from_column_slice((by_landmark.transpose() * by_landmark).as_slice()),
            gradient: Vector3::from_column_slice((by_landmark.transpose() * &residual).as_slice()),
        });
        let mut row = DMatrix::zeros(8, size);
        row.columns_mut(6 * a, 6).copy_from(&by_a);
        row.columns_mut(6 * b, 6).copy_from(&by_b);
        row.columns_mut(column, 3).copy_from(&by_landmark);
        full += row.transpose() * &row;
        right += row.transpose() * residual;
    }
    equations.add_landmarks(run);
    let step = equations.solve(0.0).unwrap();
    let solution = full.cholesky().unwrap().solve(&right);
    let points_found =
        DVector::from_iterator(3 * landmarks, step.landmarks.iter().flat_map(|x| x.iter().copied()));
    assert!((solution.rows(0, 6 * poses) - step.states).amax() < 1e-9 * solution.norm());
    assert!((solution.rows(6 * poses, 3 * landmarks) - points_found).amax() < 1e-9 * solution.norm());
}

/// Two views of one point whose pixels do not change along one direction of it, but for rounding.
#[test]
fn a_landmark_that_is_not_determined_says_nothing_of_the_poses() {
    let mut rng = StdRng::seed_from_u64(11);
    let by_pose: [DMatrix<f64>; 2] =
        [(); 2].map(|()| DMatrix::from_fn(2, 6, |_, _| rng.random_range(-1.0..1.0)));
    let residual: DVector<f64> = DVector::from_fn(2, |_, _| rng.random_range(-1.0..1.0));
    let along = Vector3::new(1.0, -2.0, 0.5).normalize();
    let across = Matrix3::identity() - along * along.transpose();
    let by_landmark: [DMatrix<f64>; 2] = [(); 2].map(|()| {
        let any: DMatrix<f64> = DMatrix::from_fn(2, 3, |_, _| rng.random_range(-1.0..1.0));
        any * DMatrix::from_column_slice(3, 3, across.as_slice())
    });
    let blocks = |depth: f64| {
        let mut blocks =
            LandmarkBlocks { information: along * along.transpose() * depth, ..LandmarkBlocks::default() };
        for (view, (by_pose, by_landmark)) in by_pose.iter().zip(&by_landmark).enumerate() {
            let information = by_landmark.tr_mul(by_landmark);
            blocks.information += Matrix3::from_column_slice(information.as_slice());
            blocks.gradient += Vector3::from_column_slice(by_landmark.tr_mul(&residual).as_slice());
            let of_pose = Matrix6::from_column_slice(by_pose.tr_mul(by_pose).as_slice());
            blocks.poses.push((
                view,
                of_pose,
                Vector6::from_column_slice(by_pose.tr_mul(&residual).as_slice()),
            ));
            blocks
                .couplings
                .push((view, Matrix6x3::from_column_slice(by_pose.tr_mul(by_landmark).as_slice())));
        }
        blocks
    };
    let solved = |depth: f64| {
        let mut equations = NormalEquations::new(StateLayout { views: 2, motions: 0 });
        for view in 0..2 {
            equations.add_information(6 * view..6 * view + 6, &DMatrix::identity(6, 6), &[0.1; 6]);
        }
        let mut run = LandmarkEquations::new(0..2);
        run.add_landmark(&blocks(depth));
        equations.add_landmarks(run);
        (equations.covariance().unwrap().columns(0..12), equations.solve(0.0).unwrap())
    };
    let (covariance, step) = solved(0.0);
    assert!((covariance - DMatrix::identity(12, 12)).amax() < 1e-12);
    assert!((step.states - DVector::repeat(12, 0.1)).amax() < 1e-12);
    assert_eq!(step.landmarks, vec![Vector3::zeros()]);
    // With a little information along the direction they say what they say whatever it is.
    let [(weak, _), (strong, _)] = [1e-6, 1e-3].map(solved);
    assert!(weak.trace() < 11.8 && (weak - strong).amax() < 1e-6);
}
