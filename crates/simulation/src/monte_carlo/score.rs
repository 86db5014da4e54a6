//! The score of all runs of a variant: RMSE and NEES of each output, with a verdict.

use super::disturbance::THREE_SIGMA;
use super::{MapCounts, Trial, VariantRuns};
use evaluation::ensemble::over_time;
use evaluation::trajectory::StateKind;
use evaluation::{EnsembleNees, ErrorSample, Nees, NeesSeries, TimePoint};
use serde::Serialize;

/// Confidence of all intervals.
pub const CONFIDENCE: f64 = 0.95;

/// Which part of a run is scored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScoreOptions {
    /// Time after the begin from which on the local pose is scored, seconds.
    pub skip_s: f64,
    /// Time after the map initialization from which on the transform and the pose in G are scored, seconds.
    pub skip_after_initialization_s: f64,
}

impl Default for ScoreOptions {
    fn default() -> Self {
        Self { skip_s: 0.0, skip_after_initialization_s: 5.0 }
    }
}

/// One output of a variant over all runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OutputScore {
    /// Root mean square of the rotation error over runs and times, degrees.
    pub rmse_deg: f64,
    /// The same of the position, metres.
    pub rmse_m: f64,
    /// NEES of the rotation, per degree of freedom.
    pub rotation: EnsembleNees,
    /// Of the position.
    pub position: EnsembleNees,
    /// Of both.
    pub pose: EnsembleNees,
}

/// A variant over all runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EnsembleScore {
    /// Its name.
    pub name: String,
    /// Number of runs.
    pub runs: usize,
    /// Runs that ended early.
    pub diverged: usize,
    /// Runs with a map that were not localized at the end.
    pub not_localized: usize,
    /// `local_from_imu`.
    pub local: Option<OutputScore>,
    /// `global_from_local`: its error hardly changes within a run, so the NEES is that of the last estimate of each run.
    pub transform: Option<OutputScore>,
    /// `global_from_imu`.
    pub pose: Option<OutputScore>,
    /// Runs whose last pose in G was within 3 sigma of the truth (99.73 % of 6 degrees of freedom).
    pub ended_within_3_sigma: usize,
    /// Counts of the map's replies, over all runs.
    pub map: MapCounts,
}

impl EnsembleScore {
    /// The score of one of the outputs.
    pub fn get(&self, kind: StateKind) -> Option<&OutputScore> {
        match kind {
            StateKind::LocalFromImu => self.local.as_ref(),
            StateKind::GlobalFromLocal => self.transform.as_ref(),
            StateKind::GlobalFromImu => self.pose.as_ref(),
        }
    }
}

/// Scores all runs of a variant.
pub fn score(all: &VariantRuns, options: &ScoreOptions) -> EnsembleScore {
    let trials = &all.trials;
    let uses_map = all.variant.config.mode != estimator::MapMode::Odometry;
    let output = |kind| output_score(trials, kind, options);
    let sum = |of: fn(&MapCounts) -> usize| trials.iter().map(|trial| of(&trial.map)).sum();
    EnsembleScore {
        name: all.variant.name.clone(),
        runs: trials.len(),
        diverged: trials.iter().filter(|trial| trial.diverged.is_some()).count(),
        not_localized: trials.iter().filter(|trial| uses_map && !trial.localized).count(),
        local: output(StateKind::LocalFromImu),
        transform: output(StateKind::GlobalFromLocal),
        pose: output(StateKind::GlobalFromImu),
        ended_within_3_sigma: trials.iter().filter(|trial| ended_within_3_sigma(trial)).count(),
        map: MapCounts {
            answers: sum(|map| map.answers),
            used: sum(|map| map.used),
            wrong_places: sum(|map| map.wrong_places),
            wrong_places_used: sum(|map| map.wrong_places_used),
            jumps: sum(|map| map.jumps),
        },
    }
}

/// The mean NEES of a whole pose over the runs, at each time.
pub fn pose_nees_over_time(all: &VariantRuns, kind: StateKind, options: &ScoreOptions) -> Vec<TimePoint> {
    let series: Vec<NeesSeries> = all
        .trials
        .iter()
        .map(|trial| series(trial, scored(trial, kind, options), |nees| nees.pose))
        .collect();
    over_time(&series, 6, CONFIDENCE)
}

fn output_score(trials: &[Trial], kind: StateKind, options: &ScoreOptions) -> Option<OutputScore> {
    let samples: Vec<(&Trial, &[ErrorSample])> =
        trials.iter().map(|trial| (trial, scored(trial, kind, options))).collect();
    let nees_of = |degrees_of_freedom, part: fn(&Nees) -> f64| {
        let runs: Vec<NeesSeries> = samples
            .iter()
            .map(|(trial, samples)| {
                let judged = if kind == StateKind::GlobalFromLocal { last(samples) } else { samples };
                series(trial, judged, part)
            })
            .collect();
        EnsembleNees::of(&runs, degrees_of_freedom, CONFIDENCE)
    };
    let count: usize = samples.iter().map(|(_, samples)| samples.len()).sum();
    let rms = |begin: usize| {
        let squares: f64 = samples
            .iter()
            .flat_map(|(_, samples)| samples.iter())
            .map(|sample| sample.error.fixed_rows::<3>(begin).norm_squared())
            .sum();
        (squares / count as f64).sqrt()
    };
    Some(OutputScore {
        rmse_deg: rms(0).to_degrees(),
        rmse_m: rms(3),
        rotation: nees_of(3, |nees| nees.rotation)?,
        position: nees_of(3, |nees| nees.position)?,
        pose: nees_of(6, |nees| nees.pose)?,
    })
}

fn ended_within_3_sigma(trial: &Trial) -> bool {
    let last = trial.errors.as_ref().and_then(|errors| errors.pose.last());
    last.and_then(|sample| sample.nees.as_ref()).is_some_and(|nees| nees.pose * 6.0 <= THREE_SIGMA)
}

/// The samples of a run that are scored.
fn scored<'a>(trial: &'a Trial, kind: StateKind, options: &ScoreOptions) -> &'a [ErrorSample] {
    let Some(errors) = &trial.errors else { return &[] };
    let samples = errors.get(kind);
    let from_s = match (kind, trial.map_initialization_s) {
        (StateKind::LocalFromImu, _) => options.skip_s,
        (_, Some(initialization_s)) => initialization_s + options.skip_after_initialization_s,
        (_, None) => return &[],
    };
    let from_ns = trial.begin_ns + (from_s * 1e9) as i64;
    &samples[samples.partition_point(|sample| sample.stamp_ns < from_ns)..]
}

fn last(samples: &[ErrorSample]) -> &[ErrorSample] {
    &samples[samples.len().saturating_sub(1)..]
}

/// NEES over the time since the begin; not a number where the covariance is not positive definite.
fn series(trial: &Trial, samples: &[ErrorSample], part: fn(&Nees) -> f64) -> NeesSeries {
    let value = |sample: &ErrorSample| {
        (sample.stamp_ns - trial.begin_ns, sample.nees.as_ref().map_or(f64::NAN, part))
    };
    samples.iter().map(value).collect()
}
