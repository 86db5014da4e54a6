//! Laws of the equations: Jacobians, elimination, joint covariance.

use std::cell::RefCell;

use estimator::EstimatorConfig;
use geometry::numeric::numeric_jacobian;
use geometry::pose::Pose;
use geometry::rotation;
use geometry::uncertain_pose::{PoseWithCovariance, isotropic_covariance};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, Matrix6x3, UnitQuaternion, Vector2, Vector3, Vector6};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use sensors::{CameraSensor, ImuSample};

use super::{camera, dense, world};
use crate::bundle_adjustment::{Bundle, Problem};
use crate::camera::{CameraPose, MappingCamera};
use crate::inertial::{InertialChain, Motion, buffered};
use crate::joint_covariance::joint_covariance;
use crate::landmark::{InverseDepthLandmark, LandmarkObservation};
use crate::landmark_equations::{LandmarkBlocks, LandmarkEquations};
use crate::layout::{POSE, StateLayout};
use crate::normal_equations::NormalEquations;
use crate::pose_prior::PosePrior;
use crate::pose_priors::{PriorFactor, PriorFactors};
use crate::relative_pose::RelativePose;
use crate::sparse_system::SparseSystem;
use crate::stored_poses::Posterior;

#[test]
fn jacobians_of_a_prediction_are_right() {
    let mut rng = StdRng::seed_from_u64(9);
    let random = |rng: &mut StdRng| Vector3::from_fn(|_, _| rng.random_range(-0.3..0.3));
    for _ in 0..20 {
        let second = Pose::new(rotation::exp(&(random(&mut rng) * 0.1)), Vector3::new(0.11, 0.01, -0.02));
        let sensor = |imu_from_camera| CameraSensor { camera: camera(), imu_from_camera, rate_hz: 1.0 };
        let cameras = MappingCamera::of_sensors(&[sensor(Pose::identity()), sensor(second)]);
        let anchor = Pose::new(rotation::exp(&random(&mut rng)), random(&mut rng));
        let view = Pose::new(rotation::exp(&random(&mut rng)), random(&mut rng) * 3.0);
        let observation =
            |view, camera| LandmarkObservation { feature: (view, 0), camera, pixel: Vector2::zeros() };
        let landmark = InverseDepthLandmark {
            anchor: 0,
            ray: Vector2::new(rng.random_range(-0.2..0.2), rng.random_range(-0.2..0.2)),
            inverse_depth: rng.random_range(0.05..0.3),
            observations: vec![observation(0, 0), observation(0, 1), observation(1, 0), observation(1, 1)],
            prior: None,
        };
        for observation in &landmark.observations[1..] {
            let at = |anchor: &Pose, view: &Pose, landmark: &InverseDepthLandmark| {
                let poses = [CameraPose::from(anchor), CameraPose::from(view)];
                let pixel = landmark.project(&cameras, &poses, observation).unwrap();
                DVector::from_column_slice(pixel.as_slice())
            };
            let error6 = |error: &DVector<f64>| Vector6::from_column_slice(error.as_slice());
            let poses = [CameraPose::from(&anchor), CameraPose::from(&view)];
            let predicted = landmark.predict(&cameras, &poses, observation).unwrap();
            assert!((at(&anchor, &view, &landmark) - predicted.pixel).norm() < 1e-12);
            let numeric = numeric_jacobian(6, |error| at(&anchor.retract(&error6(error)), &view, &landmark));
            assert!((predicted.by_anchor - numeric).amax() < 1e-5);
            let numeric = numeric_jacobian(6, |error| at(&anchor, &view.retract(&error6(error)), &landmark));
            assert!((predicted.by_view - numeric).amax() < 1e-5);
            let numeric = numeric_jacobian(3, |error| {
                at(&anchor, &view, &landmark.corrected(&Vector3::from_column_slice(error.as_slice())))
            });
            assert!((predicted.by_landmark - numeric).amax() < 1e-5);
        }
    }
}

const fn of_poses(views: usize) -> StateLayout {
    StateLayout { views, motions: 0 }
}

/// Random reduced equations of poses in a chain with a few loops, and the same as a dense matrix.
fn chain_with_loops(rng: &mut StdRng, poses: usize) -> (SparseSystem, DMatrix<f64>) {
    let layout = of_poses(poses);
    let mut system = SparseSystem::new(layout.dim());
    let mut dense = DMatrix::identity(layout.dim(), layout.dim()) * 0.3;
    for index in 0..layout.dim() {
        system.add_diagonal(index, 0.3);
    }
    let pairs = (1..poses).map(|i| (i - 1, i)).chain([(0, poses - 1), (2, poses / 2), (poses - 2, 1)]);
    for (i, j) in pairs.collect::<Vec<_>>() {
        let jacobian = DMatrix::from_fn(POSE, 2 * POSE, |_, _| rng.random_range(-1.0..1.0));
        let information = jacobian.tr_mul(&jacobian);
        let indices: Vec<usize> = layout.pose(i).chain(layout.pose(j)).collect();
        system.add(&indices, &indices, &information);
        for (row, &at) in indices.iter().enumerate() {
            for (column, &other) in indices.iter().enumerate() {
                dense[(at, other)] += information[(row, column)];
            }
        }
    }
    (system, dense)
}

#[test]
fn the_joint_covariance_is_the_inverse_of_the_equations() {
    let mut rng = StdRng::seed_from_u64(11);
    let (system, full) = chain_with_loops(&mut rng, 12);
    // Of some of the poses only: the others are marginalized.
    let views = [0, 2, 3, 4, 5, 7, 8, 9, 11];
    let factor = system.factor().unwrap();
    let posterior = Posterior::new(&factor, of_poses(12), &[], &views, &[]);
    let joint = joint_covariance(&posterior, &views, &[Vector3::zeros(); 9], |_, _| ());
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
    let factor = chain_with_loops(&mut rng, 420).0.factor().unwrap();
    let positions: Vec<_> = (0..420).map(|i| Vector3::new(f64::from(i), 0.0, 0.0)).collect();
    let views: Vec<usize> = (0..420).collect();
    let posterior = Posterior::new(&factor, of_poses(420), &[], &views, &[]);
    let joint = joint_covariance(&posterior, &views, &positions, |_, _| ());
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
    let mut equations = NormalEquations::new(of_poses(poses));
    equations.add_landmarks(run);
    let step = equations.solve(0.0).unwrap();
    let solution = full.cholesky().unwrap().solve(&right);
    let points_found =
        DVector::from_iterator(3 * landmarks, step.landmarks.iter().flat_map(|x| x.iter().copied()));
    assert!((solution.rows(0, 6 * poses) - step.states).amax() < 1e-9 * solution.norm());
    assert!((solution.rows(6 * poses, 3 * landmarks) - points_found).amax() < 1e-9 * solution.norm());
}

#[test]
fn the_equations_are_the_gradient_of_the_cost() {
    let rng = RefCell::new(StdRng::seed_from_u64(14));
    let vector = |size: f64| Vector3::from_fn(|_, _| size * rng.borrow_mut().random_range(-1.0..1.0));
    let pose = || Pose::new(rotation::exp(&vector(0.4)), vector(1.0));
    let poses = vec![pose(), pose(), pose()];
    let motion =
        || Motion { velocity: vector(2.0), gyroscope_bias: vector(0.02), accelerometer_bias: vector(0.1) };
    let motions = vec![motion(), motion(), motion()];
    let readings: Vec<ImuSample> = (0..=200)
        .map(|index| ImuSample {
            stamp_ns: index * 5_000_000,
            gyroscope: vector(0.5),
            accelerometer: Vector3::new(0.0, 0.0, 9.81) + vector(1.0),
        })
        .collect();
    let world = world(3, 0.0, 1.0);
    let camera = MappingCamera::of_sensors(&world.sequence.cameras);
    let imu_from_camera = world.sequence.cameras[0].imu_from_camera;
    let config = EstimatorConfig::default();
    // The third view has no readings of its own.
    let stamps_ns = [3_000_000, 700_000_000, 5_000_000_000];
    let chain = InertialChain::new(&buffered(&readings), &stamps_ns, &motions, imu_from_camera, &config);
    let prior = PoseWithCovariance::new(pose(), isotropic_covariance(0.1, 0.2));
    let relative = RelativePose {
        views: [0, 2],
        first_from_second: pose(),
        information: Matrix6::from_diagonal(&Vector6::new(3.0, 2.0, 1.0, 4.0, 5.0, 6.0)),
    };
    let at = |view: usize, pixel: [f64; 2]| LandmarkObservation {
        feature: (view, 0),
        camera: 0,
        pixel: Vector2::from(pixel),
    };
    let landmark = InverseDepthLandmark {
        anchor: 0,
        ray: Vector2::new(0.1, -0.05),
        inverse_depth: 0.1,
        observations: vec![at(0, [400.0, 230.0]), at(1, [380.0, 260.0])],
        prior: None,
    };
    let (priors, relative_poses) = ([PosePrior::of_reference(1, &prior)], [relative]);
    let measured = |view: usize, rotation: Option<UnitQuaternion<f64>>| {
        let mut information = Matrix6::zeros();
        information.fixed_view_mut::<3, 3>(3, 3).fill_diagonal(40.0);
        if rotation.is_some() {
            information.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(90.0);
            information[(1, 5)] = 7.0;
            information[(5, 1)] = 7.0;
        }
        PriorFactor { view, point_in_camera: vector(1.0), position: vector(1.0), rotation, information }
    };
    let known = [measured(0, None), measured(2, Some(rotation::exp(&vector(0.6))))];
    let measured = PriorFactors::new(&known, &poses);
    let without = Problem {
        cameras: &camera,
        priors: &priors,
        measured: &measured,
        inertial: None,
        relative_poses: &relative_poses,
        stored: &[],
        ties: &[],
        sigma_px: 1.5,
    };
    let bundle = Bundle { poses, motions: Vec::new(), landmarks: vec![landmark] };
    equations_are_the_gradient(&without, &bundle);
    // The readings outweigh everything else, so they are checked by themselves too.
    equations_are_the_gradient(&Problem { inertial: Some(&chain), ..without }, &Bundle { motions, ..bundle });
}

fn equations_are_the_gradient(problem: &Problem<'_>, bundle: &Bundle) {
    let equations = problem.equations(bundle, 3.0, 0.0);
    let dim = bundle.layout().dim();
    for index in 0..dim {
        let cost = |step: f64| {
            let mut error = DVector::zeros(dim);
            error[index] = step;
            problem.cost(&bundle.moved(&error), 3.0)
        };
        let numeric = (cost(1e-6) - cost(-1e-6)) / 2e-6;
        let stated = -equations.gradient()[index];
        let tolerance = 1e-6 * equations.gradient().amax();
        assert!((numeric - stated).abs() < tolerance, "{index}: {numeric} {stated}");
    }
}
