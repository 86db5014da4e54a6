//! A list of errors in a few numbers.

use serde::Serialize;

/// A list of errors in a few numbers, in the unit of the errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Statistics {
    /// Root of the mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// The middle one, or the mean of the two in the middle.
    pub median: f64,
    /// The smallest.
    pub min: f64,
    /// The largest.
    pub max: f64,
    /// Standard deviation about the mean, of the list itself (divided by n).
    pub std: f64,
    /// How many there are.
    pub samples: usize,
}

impl Statistics {
    /// Of a list, `None` when it is empty.
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
