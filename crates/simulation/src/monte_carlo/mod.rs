//! Monte-Carlo runs of the estimator in simulated worlds: its accuracy, and its consistency (NEES).
//!
//! Everything happens in memory: [`crate`] simulates IMU and tracks, `noisy_map` a map whose keyframes have the errors
//! that it states, `answers` the map's replies to images, and `trial` runs the estimator on them. Each seed has its own
//! trajectory, world, noise, map and initial state, which are the same for all variants of the filter.
//!
//! The initial state is the truth minus a sample of the covariance that the filter starts from (`start`), so the true pose
//! of L is known exactly, and the NEES has its expectation from the first image on. Or the filter initializes itself.
//!
//! | module | what is sampled |
//! |---|---|
//! | `start` | the initial state, and the true pose of L |
//! | `noisy_map` | poses and pixels of the map's keyframes, once a seed |
//! | `answers` | pixels of the image, wrong matches, wrong places |
//! | `disturbance` | an undetected failure of the filter, and its rescue |
//! | `map_change` | how the map moves in the middle of a run |
//! | [`calibration`] | the errors of the calibration that the filter is given |
//! | [`wheels`] | the true calibration of the wheels, and noise and slip of their readings |
//! | [`gnss`] | positions of GNSS, and reflections |
//! | `trial` | one run |
//! | [`mod@score`], [`report`] | statistics over all runs, and their table |
//!
//! ```
//! use estimator::EstimatorConfig;
//! use simulation::SimulationOptions;
//! use simulation::monte_carlo::{MonteCarloOptions, ScoreOptions, Variant, run, score};
//!
//! let mut options = MonteCarloOptions::default();
//! options.runs = 2;
//! options.simulation = SimulationOptions { duration_s: Some(3.0), ..SimulationOptions::default() };
//! let variant = Variant { name: "default".to_owned(), config: EstimatorConfig::default(), cameras: 2 };
//! let all = run(&options, &[variant], |_| {})?;
//! let score = score(&all[0], &ScoreOptions::default());
//! assert_eq!((score.runs, score.diverged), (2, 0));
//! # Ok::<(), simulation::SimulationError>(())
//! ```

mod answers;
pub mod calibration;
mod disturbance;
pub mod gnss;
mod lie;
mod map_change;
mod noisy_map;
pub mod report;
pub mod score;
mod start;
mod trial;
pub mod wheels;

#[cfg(test)]
mod tests;

pub use calibration::{CalibrationError, CalibrationErrors};
pub use disturbance::{Disturbance, DisturbedState, Rescue};
pub use gnss::{GnssJump, GnssOptions};
pub use lie::Lie;
pub use map_change::{ChangeStatement, MapChangeOptions, MovedPart};
pub use score::{EnsembleScore, OutputScore, ScoreOptions, score};
pub use trial::{MapCounts, Trial};
pub use wheels::{Slip, WheelOptions};

use crate::{SimulationError, SimulationOptions};
use estimator::EstimatorConfig;
use geometry::Pose;
use geometry::rotation;
use nalgebra::Vector3;
use std::f64::consts::FRAC_PI_2;
use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What is run: 20 seeds from 1 on, by default.
#[derive(Clone, Debug, PartialEq)]
pub struct MonteCarloOptions {
    /// Number of seeds.
    pub runs: usize,
    /// The first seed.
    pub first_seed: u64,
    /// Threads; each seed is run by one.
    pub threads: usize,
    /// The world and its sensors. The field `seed` is replaced by that of each run.
    pub simulation: SimulationOptions,
    /// Errors of the map.
    pub map: MapOptions,
    /// When the map is queried, and errors of its replies.
    pub answers: AnswerOptions,
    /// A change of the map in the middle of the run; only what comes after it is scored.
    pub map_change: Option<MapChangeOptions>,
    /// Errors of the calibration that the filter is given.
    pub calibration: CalibrationErrors,
    /// The wheels, for variants whose settings have some.
    pub wheels: Option<WheelOptions>,
    /// GNSS, for variants whose settings have an antenna.
    pub gnss: Option<GnssOptions>,
    /// What the filter starts from.
    pub start: FilterStart,
    /// Undetected failures of the filter in the middle of the run.
    pub disturbance: Option<Disturbance>,
}

/// What the filter of a run starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FilterStart {
    /// The truth with errors, those of the biases small.
    KnownBiases,
    /// The truth with errors, those of the biases as [`InitialSigmas`](estimator::InitialSigmas) state them.
    UnknownBiases,
    /// What its own initialization finds, at rest or in motion. L is where that put it: the first state has no error in
    /// position and yaw.
    Initialization,
}

impl Default for MonteCarloOptions {
    fn default() -> Self {
        Self {
            runs: 20,
            first_seed: 1,
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            simulation: SimulationOptions::default(),
            map: MapOptions::default(),
            answers: AnswerOptions::default(),
            map_change: None,
            calibration: CalibrationErrors::default(),
            wheels: None,
            gnss: None,
            start: FilterStart::KnownBiases,
            disturbance: None,
        }
    }
}

/// The map: keyframes with noise, once a seed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapOptions {
    /// Standard deviation of a keyframe's rotation about each axis, rad; stated to the filter. The paper's map has 0.0158.
    pub sigma_theta_rad: f64,
    /// The same of its position along each axis, metres. The paper's map has 0.1.
    pub sigma_p_m: f64,
    /// Distance between keyframes, metres; also one after every 0.35 rad of rotation.
    pub keyframe_distance_m: f64,
    /// Standard deviation of the error that all landmarks of a keyframe share in its frame, each axis, as a fraction of
    /// their distance; stated to the filter.
    pub shift: f64,
}

impl Default for MapOptions {
    fn default() -> Self {
        Self { sigma_theta_rad: 0.0158, sigma_p_m: 0.1, keyframe_distance_m: 2.0, shift: 0.02 }
    }
}

/// The replies of the map.
#[derive(Clone, Debug, PartialEq)]
pub struct AnswerOptions {
    /// Time between two queries, seconds.
    pub every_s: f64,
    /// Drop-outs: stretches of the run without replies, seconds.
    pub gaps_s: Vec<Range<f64>>,
    /// Fraction of wrong matches in a reply.
    pub wrong_matches: f64,
    /// Probability that a whole reply is of another place that looks the same. Never the first one, which nothing could
    /// contradict.
    pub wrong_place: f64,
    /// Most keyframes in a reply.
    pub max_keyframes: usize,
    /// Most matches in a reply.
    pub max_matches: usize,
    /// Standard deviation of the map's pixels as it states it, px.
    pub stated_sigma_px: f64,
    /// A server that lies.
    pub lie: Option<Lie>,
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
            stated_sigma_px: 1.0,
            lie: None,
        }
    }
}

/// A filter to compare.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// Its name.
    pub name: String,
    /// Its settings.
    pub config: EstimatorConfig,
    /// Number of cameras that it uses.
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

/// The simulated world in G, with gravity along -x as in the paper's simulations: the filter must not assume z. Runs without a map have
/// a G with z up, as positions of GNSS have.
fn global_from_world() -> Pose {
    Pose::new(rotation::exp(&(Vector3::y() * FRAC_PI_2)), Vector3::zeros())
}

/// Runs every variant on every seed.
///
/// The result depends on the options only, not on the number of threads.
///
/// # Arguments
/// * `progress`: called with the number of finished seeds, from any thread.
///
/// # Returns
/// The runs of each variant, in the order of `variants`.
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
