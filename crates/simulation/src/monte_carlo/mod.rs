//! Many seeded runs of the estimator in simulated worlds: whether it is as good as it says, and as it was.
//!
//! Everything happens in memory: [`crate`] makes IMU and tracks, `noisy_map` a map whose keyframes are off
//! by what it states, `answers` what that map says to an image, and `trial` plays it to the pure estimator. Each seed
//! has its own way, place, noise, map and first state; all variants of the filter get the same of it.
//!
//! What makes the NEES mean something: the first state is the truth minus a draw from the covariance that the filter
//! starts from (`start`), so L is known exactly and every error is judged against it.
//!
//! | module | what it draws |
//! |---|---|
//! | `start` | the first state, and where L lies |
//! | `noisy_map` | poses and pixels of the map's keyframes, once a seed |
//! | `answers` | pixels of the image, wrong matches, wrong places |
//! | `map_change` | how the map moves in the middle of a run |
//! | [`calibration`] | the calibration that the filter is told |
//! | `trial`, [`mod@score`] | one run, and what all of them say |

mod answers;
pub mod calibration;
mod map_change;
mod noisy_map;
pub mod report;
pub mod score;
mod start;
mod trial;

#[cfg(test)]
mod tests;

pub use calibration::{CalibrationError, CalibrationErrors};
pub use map_change::MapChangeOptions;
pub use score::{EnsembleScore, OutputScore, score};
pub use trial::{MapCounts, Trial};

use crate::{SimulationError, SimulationOptions};
use estimator::EstimatorConfig;
use geometry::Pose;
use geometry::rotation;
use nalgebra::Vector3;
use std::f64::consts::FRAC_PI_2;
use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What is run.
#[derive(Clone, Debug, PartialEq)]
pub struct MonteCarloOptions {
    /// How many seeds.
    pub runs: usize,
    /// The first of them.
    pub first_seed: u64,
    /// Threads; a seed is run by one.
    pub threads: usize,
    /// The world and its sensors. Its seed is that of each run.
    pub simulation: SimulationOptions,
    /// How wrong the map is.
    pub map: MapOptions,
    /// When it is asked and how wrong its answers are.
    pub answers: AnswerOptions,
    /// How it changes in the middle of the run; only what comes then is judged.
    pub map_change: Option<MapChangeOptions>,
    /// How wrong the calibration is that the filter is told.
    pub calibration: CalibrationErrors,
}

/// The map: keyframes with noise, once a seed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapOptions {
    /// Standard deviation of a keyframe's rotation about each axis, rad; stated to the filter. The paper's map has 0.0158.
    pub sigma_theta_rad: f64,
    /// The same of its position along each axis, metres. The paper's map has 0.1.
    pub sigma_p_m: f64,
    /// A keyframe every so many metres of way (and every 0.35 rad of turning).
    pub keyframe_distance_m: f64,
    /// How far the landmarks of a keyframe are off together in its frame, in each direction, as a part of their distance;
    /// stated to the filter.
    pub shift: f64,
}

impl Default for MapOptions {
    fn default() -> Self {
        Self { sigma_theta_rad: 0.0158, sigma_p_m: 0.1, keyframe_distance_m: 2.0, shift: 0.02 }
    }
}

/// The answers of the map.
#[derive(Clone, Debug, PartialEq)]
pub struct AnswerOptions {
    /// Time between two images that the map is asked about, seconds.
    pub every_s: f64,
    /// Stretches of the run without any answer, seconds.
    pub gaps_s: Vec<Range<f64>>,
    /// Fraction of the matches of an answer that are of something else.
    pub wrong_matches: f64,
    /// Probability that a whole answer is of another place that looks the same. Never the first one, which nothing
    /// could contradict.
    pub wrong_place: f64,
    /// Keyframes in an answer, at most.
    pub max_keyframes: usize,
    /// Matches in an answer, at most.
    pub max_matches: usize,
}

impl Default for AnswerOptions {
    fn default() -> Self {
        Self {
            every_s: 1.0,
            gaps_s: Vec::new(),
            wrong_matches: 0.0,
            wrong_place: 0.0,
            max_keyframes: 4,
            max_matches: 100,
        }
    }
}

/// One of the filters that are compared.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// What to call it.
    pub name: String,
    /// Its settings.
    pub config: EstimatorConfig,
    /// How many cameras of the rig it uses.
    pub cameras: usize,
}

/// All runs of one variant, in the order of their seeds.
#[derive(Clone, Debug)]
pub struct VariantRuns {
    /// The filter.
    pub variant: Variant,
    /// Its runs.
    pub trials: Vec<Trial>,
}

/// The simulated world in G. It lies on its side, gravity along -x as in the paper's places: nothing may assume z.
fn global_from_world() -> Pose {
    Pose::new(rotation::exp(&(Vector3::y() * FRAC_PI_2)), Vector3::zeros())
}

/// Runs every variant on every seed.
///
/// The same options give the same result on any number of threads.
///
/// # Arguments
/// * `progress`: called with the number of seeds that are done, from any thread.
///
/// # Errors
/// [`SimulationError`] for a world that cannot be simulated.
pub fn run(
    options: &MonteCarloOptions,
    variants: &[Variant],
    progress: impl Fn(usize) + Sync,
) -> Result<Vec<VariantRuns>, SimulationError> {
    let (next, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let results = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..options.threads.clamp(1, options.runs.max(1)) {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    if index >= options.runs {
                        break;
                    }
                    let outcome = trial::run_seed(options, options.first_seed + index as u64, variants);
                    results.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push((index, outcome));
                    progress(done.fetch_add(1, Ordering::Relaxed) + 1);
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    results.sort_by_key(|(index, _)| *index);
    let mut all: Vec<VariantRuns> = variants
        .iter()
        .map(|variant| VariantRuns { variant: variant.clone(), trials: Vec::with_capacity(options.runs) })
        .collect();
    for (_, trials) in results {
        for (of_variant, trial) in all.iter_mut().zip(trials?) {
            of_variant.trials.push(trial);
        }
    }
    Ok(all)
}
