//! The transition is the numeric one, the noise that of noisy runs, and gaps are as uncertain as they are.

use super::*;

const GRAVITY: f64 = 9.81;

fn readings(seconds: f64) -> Vec<ImuSample> {
    let count = (seconds * 400.0) as i64;
    (0..=count)
        .map(|k| {
            let t = k as f64 / 400.0;
            ImuSample {
                stamp_ns: k * 2_500_000,
                gyroscope: Vector3::new(0.5 * (2.0 * t).sin(), 0.3 * t.cos(), 0.8),
                accelerometer: Vector3::new(1.0 * (3.0 * t).cos(), 0.5, 9.81 + 0.7 * t.sin()),
            }
        })
        .collect()
}

fn start() -> ImuState {
    ImuState {
        local_from_imu: Pose::new(rotation::exp(&Vector3::new(0.3, -0.4, 1.0)), Vector3::new(1.0, -2.0, 0.5)),
        velocity: Vector3::new(0.7, -0.2, 0.1),
        gyroscope_bias: Vector3::new(0.01, -0.02, 0.03),
        accelerometer_bias: Vector3::new(0.05, 0.02, -0.04),
    }
}

fn difference(to: &ImuState, from: &ImuState) -> SVector<f64, 15> {
    let mut error = SVector::<f64, 15>::zeros();
    error.fixed_rows_mut::<6>(0).copy_from(&from.local_from_imu.local(&to.local_from_imu));
    error.fixed_rows_mut::<3>(VELOCITY).copy_from(&(to.velocity - from.velocity));
    error.fixed_rows_mut::<3>(GYROSCOPE_BIAS).copy_from(&(to.gyroscope_bias - from.gyroscope_bias));
    error
        .fixed_rows_mut::<3>(ACCELEROMETER_BIAS)
        .copy_from(&(to.accelerometer_bias - from.accelerometer_bias));
    error
}

#[test]
fn the_transition_is_the_numeric_derivative_of_the_propagation() {
    let (state, noise, readings) = (start(), ImuNoise::default(), readings(0.1));
    let run = |from: &ImuState| propagate(from, &MotionEstimate::of(from), &readings, &noise, GRAVITY);
    let reference = run(&state);
    for column in 0..IMU_DIM {
        let mut error = SVector::<f64, 15>::zeros();
        error[column] = 1e-5;
        let forward = run(&state.retract(&error)).state;
        let backward = run(&state.retract(&-error)).state;
        let numeric =
            (difference(&forward, &reference.state) - difference(&backward, &reference.state)) / 2e-5;
        let analytic = reference.transition.column(column);
        assert!((numeric - analytic).amax() < 2e-5, "column {column}: {}", (numeric - analytic).amax());
    }
}

#[test]
fn rotating_the_frame_about_gravity_and_moving_it_stays_unobservable() {
    // The transition carries each of the four gauge directions into the same direction at the end,
    // also when the begin is linearized at a first estimate that differs from the newest one.
    let (state, noise, readings) = (start(), ImuNoise::default(), readings(0.3));
    let first = MotionEstimate {
        position: state.local_from_imu.translation + Vector3::new(0.02, -0.01, 0.03),
        velocity: state.velocity + Vector3::new(-0.02, 0.03, 0.01),
    };
    let moved = propagate(&state, &first, &readings, &noise, GRAVITY);
    let up = Vector3::z();
    let gauge = |motion: &MotionEstimate| {
        let mut direction = SVector::<f64, 15>::zeros();
        direction.fixed_rows_mut::<3>(0).copy_from(&up);
        direction.fixed_rows_mut::<3>(3).copy_from(&up.cross(&motion.position));
        direction.fixed_rows_mut::<3>(VELOCITY).copy_from(&up.cross(&motion.velocity));
        direction
    };
    let difference = moved.transition * gauge(&first) - gauge(&MotionEstimate::of(&moved.state));
    assert!(difference.amax() < 1e-12, "{difference}");
}

#[test]
fn a_tilt_stays_unobservable_beside_the_bias_that_explains_it_as_long_as_the_body_does_not_rotate() {
    let (state, noise) = (start(), ImuNoise::default());
    let mut readings = readings(0.3);
    for reading in &mut readings {
        reading.gyroscope = state.gyroscope_bias;
    }
    let first = MotionEstimate {
        position: state.local_from_imu.translation + Vector3::new(0.02, -0.01, 0.03),
        velocity: state.velocity + Vector3::new(-0.02, 0.03, 0.01),
    };
    let moved = propagate(&state, &first, &readings, &noise, GRAVITY);
    let gravity = Vector3::new(0.0, 0.0, -GRAVITY);
    let direction = |tilt: &Vector3<f64>, motion: &MotionEstimate| {
        let mut direction = SVector::<f64, 15>::zeros();
        direction.fixed_rows_mut::<3>(0).copy_from(tilt);
        direction.fixed_rows_mut::<3>(3).copy_from(&tilt.cross(&motion.position));
        direction.fixed_rows_mut::<3>(VELOCITY).copy_from(&tilt.cross(&motion.velocity));
        let bias = state.local_from_imu.rotation.inverse() * gravity.cross(tilt);
        direction.fixed_rows_mut::<3>(ACCELEROMETER_BIAS).copy_from(&bias);
        direction
    };
    for tilt in [Vector3::x(), Vector3::y()] {
        let end = direction(&tilt, &MotionEstimate::of(&moved.state));
        let difference = moved.transition * direction(&tilt, &first) - end;
        assert!(difference.amax() < 1e-9, "{difference}");
    }
}

#[test]
fn a_gap_in_the_samples_increases_the_process_noise() {
    let (state, noise, whole) = (start(), ImuNoise::default(), readings(1.0));
    let holed: Vec<ImuSample> = whole
        .iter()
        .filter(|reading| !(300_000_000..700_000_000).contains(&reading.stamp_ns))
        .copied()
        .collect();
    let truth = propagate(&state, &MotionEstimate::of(&state), &whole, &noise, GRAVITY);
    let bridged = propagate(&state, &MotionEstimate::of(&state), &holed, &noise, GRAVITY);
    let error = difference(&truth.state, &bridged.state);
    for k in 0..9 {
        assert!(error[k].abs() < 3.0 * bridged.noise[(k, k)].sqrt(), "state {k}");
        assert!(bridged.noise[(k, k)] > 100.0 * truth.noise[(k, k)], "state {k}");
    }
}

/// Images cut it: what is not known of the turn and of the velocity in it is the same.
#[test]
fn a_gap_is_as_uncertain_in_parts_as_in_one_piece() {
    let (state, noise) = (start(), ImuNoise::default());
    let ends = [readings(1.0)[0], readings(1.0)[readings(1.0).len() / 2]];
    let spacing_ns = ends[1].stamp_ns - ends[0].stamp_ns;
    let in_parts = |count: i64| {
        let mut propagation = Propagation::new(&state, &MotionEstimate::of(&state), &noise, GRAVITY);
        let at = |part: i64| {
            let stamp_ns = ends[0].stamp_ns + spacing_ns * part / count;
            ImuSample::between(&ends[0], &ends[1], stamp_ns)
        };
        (0..count).for_each(|part| propagation.step_within(&at(part), &at(part + 1), spacing_ns));
        propagation.end().noise
    };
    let whole = in_parts(1);
    assert!(whole[(2, 2)].sqrt() > 0.9 * GAP_RATE * spacing_ns as f64 * 1e-9);
    for count in [2, 5, 15] {
        let cut = in_parts(count);
        for k in [0, 1, 2] {
            assert!((cut[(k, k)] / whole[(k, k)] - 1.0).abs() < 1e-9, "{count} parts, {k}");
        }
        // That of the turn in a part moves what comes after it, too.
        for k in [3, 4, 5, VELOCITY, VELOCITY + 1, VELOCITY + 2] {
            assert!(
                cut[(k, k)] > 0.99 * whole[(k, k)],
                "{count} parts, {k}: {} {}",
                cut[(k, k)],
                whole[(k, k)]
            );
        }
    }
}

#[test]
fn the_process_noise_is_the_sample_covariance_of_noisy_runs() {
    use rand::{RngExt as _, SeedableRng, rngs::StdRng};
    let mut noise = ImuNoise::default();
    (noise.gyroscope, noise.accelerometer) = (2e-3, 2e-2);
    (noise.gyroscope_walk, noise.accelerometer_walk) = (0.0, 0.0);
    let (state, clean) = (start(), readings(0.5));
    let reference = propagate(&state, &MotionEstimate::of(&state), &clean, &noise, GRAVITY);
    let mut rng = StdRng::seed_from_u64(7);
    let mut normal = move || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
    let runs = 400;
    let mut sample = ImuMatrix::zeros();
    for _ in 0..runs {
        let noisy: Vec<ImuSample> = clean
            .iter()
            .map(|reading| {
                let mut draw = || Vector3::new(normal(), normal(), normal());
                ImuSample {
                    gyroscope: reading.gyroscope + draw() * (noise.gyroscope * 20.0),
                    accelerometer: reading.accelerometer + draw() * (noise.accelerometer * 20.0),
                    ..*reading
                }
            })
            .collect();
        let error = difference(
            &propagate(&state, &MotionEstimate::of(&state), &noisy, &noise, GRAVITY).state,
            &reference.state,
        );
        sample += error * error.transpose() / f64::from(runs);
    }
    for k in 0..9 {
        let ratio = sample[(k, k)] / reference.noise[(k, k)];
        assert!((0.75..1.3).contains(&ratio), "state {k}: {ratio}");
    }
}
