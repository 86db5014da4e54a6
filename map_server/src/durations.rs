//! How long queries take: counts in buckets, of which quantiles of any time span are read.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Upper bound of the first bucket, seconds.
const FIRST_S: f64 = 0.0005;
/// Buckets with an upper bound; each is wider than the one before by the square root of 2, the last ends at 8 s.
const BOUNDED: usize = 29;
/// And one for what takes longer.
const BUCKETS: usize = BOUNDED + 1;

/// Counts of durations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DurationCounts([u64; BUCKETS]);

/// Upper bound of a bucket, seconds.
fn bound_s(bucket: usize) -> f64 {
    FIRST_S * 2_f64.powf(bucket as f64 / 2.0)
}

impl DurationCounts {
    /// The durations that were counted after an earlier state of the same counts.
    #[must_use]
    pub fn since(&self, earlier: &Self) -> Self {
        Self(std::array::from_fn(|bucket| self.0[bucket].saturating_sub(earlier.0[bucket])))
    }

    /// Number of durations.
    pub fn total(&self) -> u64 {
        self.0.iter().sum()
    }

    /// A quantile, interpolated within its bucket; `None` where nothing was counted. What took more than 8 s counts as 8 s.
    ///
    /// # Arguments
    /// * `probability`: 0.5 for the median.
    pub fn quantile(&self, probability: f64) -> Option<Duration> {
        let rank = probability.clamp(0.0, 1.0) * self.total() as f64;
        let mut below = 0.0;
        for (bucket, &count) in self.0.iter().enumerate().filter(|(_, count)| **count > 0) {
            let count = count as f64;
            if below + count >= rank {
                let low = if bucket == 0 { 0.0 } else { bound_s(bucket - 1) };
                let high = bound_s(bucket.min(BOUNDED - 1)).max(low);
                let part = ((rank - below) / count).clamp(0.0, 1.0);
                return Some(Duration::from_secs_f64(low + part * (high - low)));
            }
            below += count;
        }
        None
    }
}

/// Counts durations from several threads.
#[derive(Debug, Default)]
pub(crate) struct DurationCounter([AtomicU64; BUCKETS]);

impl DurationCounter {
    pub(crate) fn observe(&self, duration: Duration) {
        let seconds = duration.as_secs_f64();
        let bucket = (0..BOUNDED).find(|&bucket| seconds <= bound_s(bucket)).unwrap_or(BOUNDED);
        self.0[bucket].fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn counts(&self) -> DurationCounts {
        DurationCounts(std::array::from_fn(|bucket| self.0[bucket].load(Ordering::Relaxed)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_durations_within_the_width_of_a_bucket() {
        let counter = DurationCounter::default();
        for ms in 1..=100 {
            counter.observe(Duration::from_millis(ms));
        }
        let counts = counter.counts();
        assert_eq!(counts.total(), 100);
        for (probability, expected_s) in [(0.5, 0.050), (0.9, 0.090), (0.99, 0.099)] {
            let quantile = counts.quantile(probability).unwrap().as_secs_f64();
            assert!((quantile / expected_s).log2().abs() <= 0.5, "{probability}: {quantile}");
        }
    }

    #[test]
    fn a_span_of_time_has_only_its_own_durations() {
        let counter = DurationCounter::default();
        counter.observe(Duration::from_secs(1));
        let earlier = counter.counts();
        assert_eq!(counter.counts().since(&earlier).quantile(0.5), None);
        counter.observe(Duration::from_millis(2));
        let span = counter.counts().since(&earlier);
        assert_eq!(span.total(), 1);
        assert!(span.quantile(0.99).unwrap() <= Duration::from_millis(2));
        counter.observe(Duration::from_hours(1));
        assert!(counter.counts().quantile(1.0).unwrap() <= Duration::from_secs_f64(8.2));
    }
}
