//! Laws of the dynamic initialization.

mod world;

use super::*;
use crate::inertial_chain::InertialChain;
use crate::preintegration::PreintegratedImu;
use crate::propagation::{ImuError, MotionEstimate, propagate};
use adjustment::{Factor, NormalEquations};
use geometry::numeric::numeric_jacobian;
use geometry::rotation::{exp, log};
use nalgebra::{DMatrix, DVector};
use rand::{SeedableRng as _, rngs::StdRng};
use world::{Run, USUAL, World, normal, vector, world};

fn start(world: &World) -> Result<(InitialState, InitQuality), DynamicInitError> {
    initialize_dynamic(&world.window, &world.cameras, &world.config, &BiasPrior::default())
}

/// The error of a start without the four numbers that define L, and its NEES.
fn error(world: &World, start: &InitialState) -> (DVector<f64>, f64) {
    let off = log(&(world.truth.local_from_imu.rotation * start.imu.local_from_imu.rotation.inverse()));
    // The true L is turned about z until the error has no part about it.
    let turn = (0..20).fold(exp(&Vector3::new(0.0, 0.0, -off.z)), |turn, _| {
        let left =
            log(&(turn * world.truth.local_from_imu.rotation * start.imu.local_from_imu.rotation.inverse()));
        exp(&Vector3::new(0.0, 0.0, -left.z)) * turn
    });
    let tilt =
        log(&(turn * world.truth.local_from_imu.rotation * start.imu.local_from_imu.rotation.inverse()));
    let velocity = turn * world.truth.velocity - start.imu.velocity;
    let gyroscope = world.truth.gyroscope_bias - start.imu.gyroscope_bias;
    let accelerometer = world.truth.accelerometer_bias - start.imu.accelerometer_bias;
    let parts = [velocity, gyroscope, accelerometer];
    let numbers = [tilt.x, tilt.y].into_iter().chain(parts.iter().flat_map(|part| part.iter().copied()));
    let error = DVector::from_iterator(11, numbers);
    let compared = [0, 1, 6, 7, 8, 9, 10, 11, 12, 13, 14];
    let covariance = DMatrix::from_fn(11, 11, |i, j| start.covariance[(compared[i], compared[j])]);
    let nees = error.dot(&covariance.cholesky().unwrap().solve(&error));
    (error, nees)
}

#[test]
fn the_closed_form_is_exact_without_noise() {
    for stereo in [false, true] {
        let world = world(Run { stereo, noise: 0.0, ..USUAL });
        let integrated = closed_form::integrate(&world.window, &world.config, &Vector3::zeros());
        let found =
            closed_form::solve(&world.window, &world.cameras, &integrated, world.config.gravity).unwrap();
        let to_body = world.first.local_from_imu.rotation.inverse();
        let velocity = to_body * world.first.velocity;
        let down = to_body * Vector3::new(0.0, 0.0, -world.config.gravity);
        assert!((found.velocity - velocity).norm() < 1e-3, "{} m/s off", (found.velocity - velocity).norm());
        assert!((found.gravity - down).norm() < 1e-3, "{} m/s^2 off", (found.gravity - down).norm());
    }
}

#[test]
fn the_minimum_on_the_sphere_is_the_lowest_point_of_it() {
    let mut rng = StdRng::seed_from_u64(5);
    for _ in 0..50 {
        let root = nalgebra::Matrix3::from_fn(|_, _| normal(&mut rng));
        let (matrix, vector) = (root * root.transpose(), vector(&mut rng) * 10.0);
        let value = |x: &Vector3<f64>| 0.5 * x.dot(&(matrix * x)) - vector.dot(x);
        let found = closed_form::minimize_on_sphere(&matrix, &vector, 9.81).unwrap();
        assert!((found.norm() - 9.81).abs() < 1e-9);
        for _ in 0..500 {
            let other = world::vector(&mut rng).normalize() * 9.81;
            assert!(value(&other) >= value(&found) - 1e-9);
        }
    }
}

#[test]
fn the_gyroscope_bias_is_found_from_bearings_alone_of_whichever_camera() {
    for covered_first in [false, true] {
        let world = world(Run { noise: 0.3, covered_first, ..USUAL });
        let bias = Vector3::new(0.1, -0.08, 0.05);
        let mut biased = world.window.clone();
        for reading in biased.readings.iter_mut().flatten() {
            reading.gyroscope += bias;
        }
        let found = gyroscope_bias::refine_bias(&biased, &world.cameras, &Vector3::zeros(), 0.2, 0.3);
        assert!((found - bias - world.truth.gyroscope_bias).norm() < 0.01, "{found}");
    }
}

#[test]
fn a_covered_first_camera_does_not_change_the_start_of_the_others() {
    for seed in 0..4 {
        let run = Run { seed, unknown_biases: true, ..USUAL };
        let alone = start(&world(run)).map(|(initial, _)| initial);
        let beside = start(&world(Run { covered_first: true, ..run })).map(|(initial, _)| initial);
        assert!(seed != 1 || alone.is_ok());
        assert_eq!(beside, alone, "seed {seed}");
    }
}

#[test]
fn jacobians_of_preintegration_are_the_numeric_derivatives() {
    let world = world(USUAL);
    let config = &world.config;
    let interval = PreintegratedImu::new(
        &world.window.readings[3],
        &Vector3::repeat(0.01),
        &Vector3::repeat(0.02),
        config,
    )
    .unwrap();
    let end = world.first.retract(&ImuError::from_fn(|k, _| 0.02 * (k as f64).sin()));
    let row = interval.linearize(&world.first, &end);
    let numeric = numeric_jacobian(30, |error| {
        let begin = world.first.retract(&error.fixed_rows::<15>(0).into());
        let end = end.retract(&error.fixed_rows::<15>(15).into());
        DVector::from_column_slice(interval.residual(&begin, &end).as_slice())
    });
    let off =
        (numeric.columns(0, 15) - row.wrt_begin).amax().max((numeric.columns(15, 15) - row.wrt_end).amax());
    assert!(off < 1e-6, "{off}");
}

#[test]
fn the_equations_of_the_readings_are_the_gradient_of_their_cost() {
    let world = world(USUAL);
    let (readings, config) = (&world.window.readings[3], &world.config);
    let interval =
        PreintegratedImu::new(readings, &Vector3::repeat(0.01), &Vector3::repeat(0.02), config).unwrap();
    let imu_from_body = Pose::new(exp(&Vector3::new(0.1, -0.2, 1.5)), Vector3::new(0.1, 0.3, -0.2));
    let end = world.first.retract(&ImuError::from_fn(|k, _| 0.02 * (k as f64).sin()));
    let chain = InertialChain::new(vec![(0, interval)], end.motion(), imu_from_body, config);
    let states = [world.first, end, world.truth];
    let bundle = Bundle {
        poses: states.iter().map(|state| state.local_from_imu.compose(&imu_from_body)).collect(),
        motions: states.iter().map(ImuState::motion).collect(),
        landmarks: Vec::new(),
    };
    let chain = chain.with_weak_priors();
    let numeric = numeric_jacobian(bundle.layout().dim(), |error| {
        DVector::from_element(1, chain.cost(&bundle.moved(error), f64::INFINITY))
    });
    let mut equations = NormalEquations::new(bundle.layout());
    chain.add_to(&mut equations, &bundle, f64::INFINITY);
    let off = (numeric.transpose() + equations.gradient()).amax();
    assert!(off < 1e-6 * equations.gradient().amax(), "{off}");
}

#[test]
fn preintegration_agrees_with_propagation() {
    let world = world(USUAL);
    let (readings, first) = (&world.window.readings[0], world.first);
    let motion = MotionEstimate::of(&first);
    let propagated =
        propagate(&first, &motion, readings, &world.config.imu_noise, world.config.gravity).state;
    let interval =
        PreintegratedImu::new(readings, &first.gyroscope_bias, &first.accelerometer_bias, &world.config)
            .unwrap();
    assert!(interval.residual(&first, &propagated).amax() < 1e-12);
}

#[test]
fn errors_are_consistent_with_their_covariances() {
    for (stereo, unknown_biases) in [(false, false), (true, false), (false, true), (true, true)] {
        let (mut sum, mut runs) = (0.0, 0);
        for seed in 0..24 {
            let world = world(Run { seed, stereo, unknown_biases, ..USUAL });
            let Ok((start, quality)) = start(&world) else { continue };
            let (error, nees) = error(&world, &start);
            assert!(nees < 45.0, "seed {seed}: NEES {nees} of 11, {error}");
            let speed = world.truth.velocity.norm();
            let off = (start.imu.velocity.norm() / speed - 1.0).abs();
            // With unknown biases the velocity is uncertain in more than its scale.
            assert!(unknown_biases || off < 5.0 * quality.sigma_scale + 0.01, "seed {seed}: off by {off}");
            sum += nees;
            runs += 1;
        }
        assert!(runs >= 20, "{runs} starts");
        let freedom = f64::from(11 * runs);
        // 95 % interval of chi-square for that many degrees of freedom, by its normal limit.
        let half = 1.96 * (2.0 * freedom).sqrt();
        assert!((sum - freedom).abs() < half, "NEES {sum} of {freedom} +- {half} over {runs} runs");
    }
}

#[test]
fn at_constant_velocity_one_camera_is_rejected_and_two_are_accepted() {
    for seed in 0..6 {
        let uniform = Run { seed, shaken: 0.0, ..USUAL };
        let rejected = start(&world(uniform));
        assert!(matches!(rejected, Err(DynamicInitError::ScaleUnknown { .. })), "seed {seed}: {rejected:?}");
        let of_two = world(Run { stereo: true, ..uniform });
        let (start, _) = start(&of_two).unwrap();
        let (error, nees) = error(&of_two, &start);
        assert!(nees < 40.0 && error.fixed_rows::<3>(2).norm() < 0.08, "seed {seed}: {nees} {error}");
    }
}

#[test]
fn outliers_are_dropped() {
    for seed in 0..6 {
        let world = world(Run { seed, outliers: 0.02, ..USUAL });
        let (start, quality) = start(&world).unwrap();
        assert!((0.01..0.04).contains(&quality.outliers), "seed {seed}: {}", quality.outliers);
        let (error, nees) = error(&world, &start);
        assert!(nees < 45.0, "seed {seed}: NEES {nees}, {error}");
    }
}

#[test]
fn wrong_extrinsics_and_missing_tracks_are_rejected() {
    let mut turned = world(USUAL);
    turned.cameras[0].imu_from_camera.rotation *= exp(&Vector3::new(0.0, 0.5, 0.0));
    assert!(matches!(
        start(&turned),
        Err(DynamicInitError::Contradiction { .. } | DynamicInitError::TooFewTracks { .. })
    ));
    let mut blind = world(USUAL);
    blind.window.tracks.truncate(5);
    assert_eq!(start(&blind).unwrap_err(), DynamicInitError::TooFewTracks { have: 5, need: MIN_TRACKS });
}
