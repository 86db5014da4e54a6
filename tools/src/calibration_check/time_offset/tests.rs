//! Lags of irregular motion are found; regular motion and none tell nothing.

use super::*;
use nalgebra::Vector3;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng};

const MAX_SIGMA_S: f64 = 0.03;
const IMU_NS: i64 = 5_000_000;
const FRAME_NS: i64 = 50_000_000;

/// Half a minute of images of a motion, and of a gyroscope with noise and bias whose clock is `offset_s` ahead.
fn found(
    rate: impl Fn(f64) -> Vector3<f64>,
    offset_s: f64,
    noise: f64,
    random: &mut StdRng,
) -> CoarseTimeOffset {
    let mut noisy = |of: f64| Vector3::from_fn(|_, _| of * random.random_range(-1.7..1.7));
    let reading = |k: i64| ImuSample {
        stamp_ns: k * IMU_NS,
        gyroscope: rate((k * IMU_NS) as f64 * 1e-9 - offset_s)
            + Vector3::new(0.05, -0.03, 0.01)
            + noisy(2e-3),
        accelerometer: Vector3::zeros(),
    };
    let readings: Vec<ImuSample> = (-200..6200).map(reading).collect();
    let image = |k: i64| {
        let (from_ns, to_ns) = (k * FRAME_NS, (k + 1) * FRAME_NS);
        let middle_s = 0.5e-9 * (from_ns + to_ns) as f64;
        ImageRate { from_ns, to_ns, rate: rate(middle_s) + noisy(noise) }
    };
    let images: Vec<ImageRate> = (0..600).map(image).collect();
    search(&images, &GyroscopeAngles::new(&readings), 0, MAX_SIGMA_S)
}

/// Rates of a hand: sums of sines that do not repeat.
fn irregular(random: &mut StdRng) -> impl Fn(f64) -> Vector3<f64> + use<> {
    let waves: Vec<(Vector3<f64>, f64, f64)> = (0..12)
        .map(|_| {
            let size = Vector3::from_fn(|_, _| random.random_range(-0.3..0.3));
            (size, random.random_range(0.5..8.0), random.random_range(0.0..6.3))
        })
        .collect();
    move |at: f64| waves.iter().map(|(size, rate, phase)| size * (rate * at + phase).sin()).sum()
}

#[test]
fn the_lag_of_irregular_motion_is_found_as_certain_as_stated() {
    for seed in 0..8 {
        let mut random = StdRng::seed_from_u64(seed);
        let (offset_s, noise) = (random.random_range(-1.0..1.0), random.random_range(0.0..0.05));
        let motion = irregular(&mut random);
        let found = found(motion, offset_s, noise, &mut random);
        assert_eq!(found.undetermined, None, "{found:?}");
        let (error_s, sigma_s) = (found.offset_s().unwrap() - offset_s, found.sigma_s.unwrap());
        assert!(error_s.abs() < 5.0 * sigma_s + 2e-3, "{error_s} s, {found:?}");
    }
}

#[test]
fn constant_rotation_and_rest_tell_nothing() {
    let mut random = StdRng::seed_from_u64(3);
    for constant in [Vector3::zeros(), Vector3::new(0.0, 0.1, 0.8)] {
        for offset_s in [0.0, 0.4] {
            let found = found(|_| constant, offset_s, 0.02, &mut random);
            assert_eq!(found.undetermined, Some(Undetermined::NoCorrelation), "{found:?}");
            assert!(found.offset_s().is_none());
        }
    }
}

#[test]
fn motion_that_repeats_itself_within_the_range_is_ambiguous() {
    let mut random = StdRng::seed_from_u64(4);
    let found = found(|at| Vector3::y() * (9.0 * at).sin(), 0.25, 0.02, &mut random);
    assert!(found.offset_s().is_none(), "{found:?}");
}

#[test]
fn an_offset_beyond_the_range_is_not_told() {
    let mut random = StdRng::seed_from_u64(5);
    let motion = irregular(&mut random);
    let found = found(motion, 2.5, 0.02, &mut random);
    assert!(found.offset_s().is_none(), "{found:?}");
}

#[test]
fn too_few_images_tell_nothing() {
    let found = search(&[], &GyroscopeAngles::new(&[]), 0, MAX_SIGMA_S);
    assert_eq!((found.undetermined, found.intervals), (Some(Undetermined::TooFewIntervals), 0));
    assert!(found.best.is_none());
}
