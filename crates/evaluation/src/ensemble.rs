//! Consistency over many runs: the NEES of an ensemble, with a verdict that holds despite correlation in time.
//!
//! Successive errors of one run are correlated over seconds to the whole run, so `runs x times` samples are far fewer
//! independent ones. Two statistics are valid:
//!
//! * **At each time** the runs are independent: their mean NEES lies in `chi2(N n) / (N n)` with the stated probability.
//!   The fraction of times inside is reported. Neighbouring times are correlated, so that the fraction itself varies a lot
//!   about 95 %.
//! * **Over all**, a run is one sample: its NEES averaged over time. The mean over runs has the expectation 1. A time
//!   average varies at most as much as the NEES of a single instant, so the interval `chi2(N n) / (N n)` of `N` single
//!   instants is never too narrow: a mean outside of it is inconsistent at the stated confidence, whatever the
//!   correlation. This is the [`Verdict`]. A confidence interval of the true mean (Student's t over runs) is reported
//!   beside it: where it excludes 1 and the verdict is `Inside`, the inconsistency is real, but small.
//!
//! Source: Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and Navigation*, 2001, section 5.4.2.

use super::nees_bounds;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::BTreeMap;

/// Mean NEES that passes even where the chi-square interval is narrower: smaller deviations have no practical effect.
const TOLERATED: (f64, f64) = (0.7, 1.4);

/// NEES per degree of freedom of one run: time since its begin (nanoseconds), value.
pub type NeesSeries = Vec<(i64, f64)>;

/// The mean over runs compared with its interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Within the chi-square interval.
    Inside,
    /// Outside of it, but between 0.7 and 1.4: with many runs even a harmless deviation is significant.
    Near,
    /// The covariance is too small.
    Overconfident,
    /// The covariance is too large.
    Conservative,
}

impl Verdict {
    /// Judges a mean NEES per degree of freedom.
    pub fn of(mean: f64, interval: (f64, f64)) -> Self {
        let within = |(low, high): (f64, f64)| (low..=high).contains(&mean);
        if within(interval) {
            Self::Inside
        } else if within(TOLERATED) {
            Self::Near
        } else if mean < interval.0 {
            Self::Conservative
        } else {
            // Not a number is not consistent either.
            Self::Overconfident
        }
    }

    /// Inside, or near enough.
    pub fn passes(self) -> bool {
        matches!(self, Self::Inside | Self::Near)
    }
}

/// The runs at one instant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TimePoint {
    /// Since the begin of the runs, seconds.
    pub seconds: f64,
    /// Mean NEES per degree of freedom over the runs that have one here.
    pub mean: f64,
    /// Interval of the mean of so many runs for a consistent estimator.
    pub interval: (f64, f64),
    /// Number of these runs.
    pub runs: usize,
}

/// The NEES of an ensemble, per degree of freedom.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EnsembleNees {
    /// Runs that have it.
    pub runs: usize,
    /// Mean over runs of each run's average over time.
    pub mean: f64,
    /// Interval of the mean of as many independent samples for a consistent estimator.
    pub interval: (f64, f64),
    /// Confidence interval of the true mean, from the variation of the runs' averages (Student's t). `None` for one run.
    pub mean_interval: Option<(f64, f64)>,
    /// Fraction of the instants at which the mean over runs is within its interval.
    pub times_inside: f64,
    /// The judgement.
    pub verdict: Verdict,
    /// Each run's average over time, in the order of the runs.
    pub averages: Vec<f64>,
}

impl EnsembleNees {
    /// Computes the NEES of an ensemble.
    ///
    /// # Arguments
    /// * `runs`: one series a run, with the same times in each where they have values; an empty one does not count.
    /// * `degrees_of_freedom`: of one sample, 3 or 6 here.
    /// * `confidence`: for example 0.95.
    ///
    /// # Returns
    /// `None` where every series is empty, or for a confidence outside of (0, 1).
    ///
    /// ```
    /// use evaluation::{EnsembleNees, Verdict};
    ///
    /// // Ten runs of a filter whose standard deviation is half of its true error: NEES 4.
    /// let runs: Vec<_> = (0..10).map(|_| (0..100).map(|k| (k * 100_000_000, 4.0)).collect()).collect();
    /// let ensemble = EnsembleNees::of(&runs, 3, 0.95).expect("there are runs");
    /// assert_eq!(ensemble.verdict, Verdict::Overconfident);
    /// ```
    pub fn of(runs: &[NeesSeries], degrees_of_freedom: usize, confidence: f64) -> Option<Self> {
        let averages: Vec<f64> = runs.iter().filter_map(average).collect();
        let interval = nees_bounds(degrees_of_freedom, averages.len(), confidence)?;
        let mean = averages.iter().sum::<f64>() / averages.len() as f64;
        let points = over_time(runs, degrees_of_freedom, confidence);
        let inside = points.iter().filter(|point| {
            let (low, high) = point.interval;
            (low..=high).contains(&point.mean)
        });
        Some(Self {
            runs: averages.len(),
            mean,
            interval,
            mean_interval: mean_interval(&averages, mean, confidence),
            times_inside: inside.count() as f64 / points.len() as f64,
            verdict: Verdict::of(mean, interval),
            averages,
        })
    }
}

/// The mean over runs at each time; see [`EnsembleNees::of`] for the arguments.
pub fn over_time(runs: &[NeesSeries], degrees_of_freedom: usize, confidence: f64) -> Vec<TimePoint> {
    let mut at: BTreeMap<i64, (f64, usize)> = BTreeMap::new();
    for (time_ns, nees) in runs.iter().flatten() {
        let (sum, count) = at.entry(*time_ns).or_default();
        *sum += nees;
        *count += 1;
    }
    let point = |(time_ns, (sum, runs)): (i64, (f64, usize))| {
        Some(TimePoint {
            seconds: time_ns as f64 * 1e-9,
            mean: sum / runs as f64,
            interval: nees_bounds(degrees_of_freedom, runs, confidence)?,
            runs,
        })
    };
    at.into_iter().filter_map(point).collect()
}

fn average(series: &NeesSeries) -> Option<f64> {
    let sum: f64 = series.iter().map(|(_, nees)| nees).sum();
    (!series.is_empty()).then(|| sum / series.len() as f64)
}

fn mean_interval(averages: &[f64], mean: f64, confidence: f64) -> Option<(f64, f64)> {
    let count = averages.len() as f64;
    let distribution = StudentsT::new(0.0, 1.0, count - 1.0).ok()?;
    let variance = averages.iter().map(|average| (average - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let half = distribution.inverse_cdf(f64::midpoint(1.0, confidence)) * (variance / count).sqrt();
    Some((mean - half, mean + half))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng, rngs::StdRng};

    /// Runs of a consistent estimator whose error keeps a share of itself from step to step.
    fn runs(count: usize, memory: f64, scale: f64, seed: u64) -> Vec<NeesSeries> {
        let mut rng = StdRng::seed_from_u64(seed);
        let mut normal = move || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let one = |_| {
            let mut error: [f64; 3] = std::array::from_fn(|_| normal());
            let step = |time| {
                error = error.map(|part| memory * part + (1.0 - memory * memory).sqrt() * normal());
                (time, scale * error.iter().map(|part| part * part).sum::<f64>() / 3.0)
            };
            (0..200).map(step).collect()
        };
        (0..count).map(one).collect()
    }

    fn share_that_passes(memory: f64, scale: f64) -> f64 {
        let trials = 200;
        let passed = (0..trials).filter(|&seed| {
            EnsembleNees::of(&runs(20, memory, scale, seed), 3, 0.95).unwrap().verdict == Verdict::Inside
        });
        passed.count() as f64 / trials as f64
    }

    #[test]
    fn a_consistent_estimator_passes_however_long_its_errors_last() {
        for memory in [0.0, 0.9, 0.999] {
            let share = share_that_passes(memory, 1.0);
            assert!(share > 0.9, "{share} of the trials pass at memory {memory}");
        }
    }

    #[test]
    fn a_covariance_that_is_off_by_half_does_not_pass() {
        for (memory, scale) in [(0.9, 1.6), (0.9, 0.5)] {
            let share = share_that_passes(memory, scale);
            assert!(share < 0.1, "{share} of the trials pass at {scale}");
        }
    }

    #[test]
    fn at_each_time_the_mean_is_inside_as_often_as_stated() {
        let inside: f64 = (0..40)
            .map(|seed| EnsembleNees::of(&runs(20, 0.9, 1.0, 900 + seed), 3, 0.95).unwrap().times_inside)
            .sum::<f64>()
            / 40.0;
        assert!((0.93..0.97).contains(&inside), "{inside}");
    }

    #[test]
    fn runs_that_end_early_leave_wider_bounds() {
        let mut all = runs(20, 0.5, 1.0, 1);
        all[3].truncate(50);
        all[4].clear();
        let points = over_time(&all, 3, 0.95);
        assert_eq!((points[0].runs, points[199].runs), (19, 18));
        assert!(points[199].interval.1 > points[0].interval.1);
        assert_eq!(EnsembleNees::of(&all, 3, 0.95).unwrap().runs, 19);
        assert!(EnsembleNees::of(&[Vec::new()], 3, 0.95).is_none());
    }

    #[test]
    fn what_is_no_number_is_not_consistent() {
        assert!(!Verdict::of(f64::NAN, (0.7, 1.3)).passes());
        assert_eq!(Verdict::of(1.35, (0.8, 1.2)), Verdict::Near);
        assert_eq!(Verdict::of(0.3, (0.8, 1.2)), Verdict::Conservative);
    }
}
