//! Independent streams of random numbers from one seed, so that a change to one part leaves the others as they were.
//!
//! Normal numbers are those of `rand_distr::StandardNormal`; this is the only place of the crate that samples them.

use nalgebra::Vector3;
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, StandardNormal};

/// What a stream is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Purpose {
    World = 1,
    Imu = 2,
    Tracks = 3,
    Features = 4,
    Dropouts = 5,
    Reference = 6,
    Path = 7,
    Start = 8,
    NoisyMap = 9,
    Answers = 10,
    Calibration = 11,
    MapShift = 12,
    MapChange = 13,
    Images = 14,
    Wheels = 15,
    Gnss = 16,
    MovedLandmarks = 17,
}

/// The stream for one purpose of one run.
pub(crate) fn stream(seed: u64, run: u64, purpose: Purpose) -> StdRng {
    let mixed = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (run << 32) ^ purpose as u64;
    StdRng::seed_from_u64(mixed)
}

/// A standard normal number.
pub(crate) fn normal(rng: &mut StdRng) -> f64 {
    StandardNormal.sample(rng)
}

/// Three independent standard normal numbers.
pub(crate) fn normal3(rng: &mut StdRng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| normal(rng))
}
