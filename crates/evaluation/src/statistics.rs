//! Statistics of a list of errors.

use serde::Serialize;

/// Statistics of a list of errors, in the unit of the errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Statistics {
    /// Root of the mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// Smallest error.
    pub min: f64,
    /// Largest error.
    pub max: f64,
    /// Standard deviation about the mean, of the list itself (divided by n).
    pub std: f64,
    /// Number of errors.
    pub samples: usize,
}

impl Statistics {
    /// The statistics of a list; `None` when it is empty.
    pub fn of(errors: &[f64]) -> Option<Self> {
        let mut sorted = errors.to_vec();
        sorted.sort_unstable_by(f64::total_cmp);
        let (min, max) = (*sorted.first()?, *sorted.last()?);
        let count = sorted.len() as f64;
        let mean = sorted.iter().sum::<f64>() / count;
        let mean_square = sorted.iter().map(|error| error * error).sum::<f64>() / count;
        let variance = sorted.iter().map(|error| (error - mean).powi(2)).sum::<f64>() / count;
        let middle = sorted.len() / 2;
        let median = if sorted.len().is_multiple_of(2) {
            f64::midpoint(sorted[middle - 1], sorted[middle])
        } else {
            sorted[middle]
        };
        let (rmse, std) = (mean_square.sqrt(), variance.sqrt());
        Some(Self { rmse, mean, median, min, max, std, samples: sorted.len() })
    }
}

/// Errors that are stored for the median.
const KEPT: usize = 16_384;

/// [`Statistics`] of a list of any length, in memory that does not depend on it.
///
/// All of it is of the whole list but the median, which is that of every second error beyond 16384 of them, of every
/// fourth beyond twice as many, and so on.
#[derive(Clone, Debug)]
pub(super) struct RunningStatistics {
    mean: f64,
    /// Sum of the squared distances to the mean.
    squares: f64,
    min: f64,
    max: f64,
    samples: usize,
    kept: Vec<f64>,
    stride: usize,
}

impl Default for RunningStatistics {
    fn default() -> Self {
        let (min, max) = (f64::INFINITY, f64::NEG_INFINITY);
        Self { mean: 0.0, squares: 0.0, min, max, samples: 0, kept: Vec::new(), stride: 1 }
    }
}

impl RunningStatistics {
    /// Adds an error.
    pub(super) fn push(&mut self, error: f64) {
        if self.samples.is_multiple_of(self.stride) {
            if self.kept.len() == KEPT {
                let mut index = 0;
                self.kept.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
                self.stride *= 2;
            }
            self.kept.push(error);
        }
        // Welford's algorithm: no cancellation where the errors hardly differ.
        self.samples += 1;
        let before = error - self.mean;
        self.mean += before / self.samples as f64;
        self.squares += before * (error - self.mean);
        self.min = self.min.min(error);
        self.max = self.max.max(error);
    }

    /// The statistics; `None` without errors.
    pub(super) fn statistics(&self) -> Option<Statistics> {
        let median = Statistics::of(&self.kept)?.median;
        let (mean, variance) = (self.mean, self.squares / self.samples as f64);
        Some(Statistics {
            rmse: (mean * mean + variance).sqrt(),
            mean,
            median,
            min: self.min,
            max: self.max,
            std: variance.sqrt(),
            samples: self.samples,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn running_statistics_are_those_of_the_list() {
        let errors: Vec<f64> = (0..70_001).map(|k| (f64::from(k) * 0.7).sin().abs() + 3.0).collect();
        for count in [1, 2, 1000, KEPT, errors.len()] {
            let list = &errors[..count];
            let mut running = RunningStatistics::default();
            for error in list {
                running.push(*error);
            }
            assert!(running.kept.len() <= KEPT);
            let (found, expected) = (running.statistics().unwrap(), Statistics::of(list).unwrap());
            let close =
                |a: f64, b: f64, tolerance: f64| assert!((a - b).abs() < tolerance, "{count}: {a} {b}");
            close(found.rmse, expected.rmse, 1e-9);
            close(found.mean, expected.mean, 1e-9);
            close(found.std, expected.std, 1e-9);
            close(found.median, expected.median, if count <= KEPT { 1e-12 } else { 0.01 });
            assert_eq!((found.min, found.max, found.samples), (expected.min, expected.max, count));
        }
        assert!(RunningStatistics::default().statistics().is_none());
    }
}
