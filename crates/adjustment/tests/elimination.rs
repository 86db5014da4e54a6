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
    for pose in 0..poses {
        let information = Matrix6::identity() * 30.0;
        let gradient = Vector6::from_fn(|_, _| rng.random_range(-1.0..1.0));
        run.add_pose(pose, &information, &gradient);
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
        run.add_pose(a, &six(by_a.transpose() * by_a), &vector(by_a.transpose() * &column_residual));
        run.add_pose(b, &six(by_b.transpose() * by_b), &vector(by_b.transpose() * &column_residual));
        run.add_pair(a, b, &six(by_a.transpose() * by_b));
        run.add_landmark(&LandmarkBlocks {
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
    let mut equations = NormalEquations::new(StateLayout { views: poses, motions: 0 });
    equations.add_landmarks(run);
    let step = equations.solve(0.0).unwrap();
    let solution = full.cholesky().unwrap().solve(&right);
    let points_found =
        DVector::from_iterator(3 * landmarks, step.landmarks.iter().flat_map(|x| x.iter().copied()));
    assert!((solution.rows(0, 6 * poses) - step.states).amax() < 1e-9 * solution.norm());
    assert!((solution.rows(6 * poses, 3 * landmarks) - points_found).amax() < 1e-9 * solution.norm());
}
