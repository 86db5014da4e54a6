//! Watches whether a stream comes, and at which rate.

use crate::push_newest;
use std::collections::VecDeque;
use std::time::Duration;

/// A stream is silent after so long without a message, or after [`SILENT_PERIODS`] where its rate is low.
pub(super) const SILENT: Duration = Duration::from_secs(1);
const SILENT_PERIODS: f64 = 5.0;
/// The rate is measured over about a second, from so many messages at least and at most.
const MESSAGES: std::ops::RangeInclusive<usize> = 20..=400;
/// Fewer intervals say nothing.
const MIN_INTERVALS: usize = 10;
/// A quarter of the intervals is left out at either end: pauses, pairs of messages with almost the same stamp, and what
/// is still on its way.
const TRIMMED: usize = 4;
/// A rate within this factor is as stated.
const RATE_FACTOR: f64 = 1.25;

/// Arrivals and stamps of a stream.
#[derive(Debug)]
pub(super) struct StreamWatch {
    silent: Duration,
    stated_hz: Option<f64>,
    last_arrival: Option<Duration>,
    /// The newest stamps, as they arrived.
    stamps: VecDeque<i64>,
    capacity: usize,
    /// Trimmed mean of the intervals, nanoseconds.
    measured_ns: Option<i64>,
}

impl StreamWatch {
    /// Nothing has come yet.
    ///
    /// # Arguments
    /// * `silent`: so long without a message is too long: [`SILENT`], unless a stream has a low rate by nature.
    pub(super) fn new(silent: Duration, stated_hz: Option<f64>) -> Self {
        let capacity = stated_hz.map_or(0, |rate| rate as usize).clamp(*MESSAGES.start(), *MESSAGES.end());
        let stamps = VecDeque::with_capacity(capacity);
        Self { silent, stated_hz, last_arrival: None, stamps, capacity, measured_ns: None }
    }

    /// A message has arrived, whatever it was.
    pub(super) fn arrived(&mut self, now: Duration) {
        self.last_arrival = Some(now);
    }

    /// A message was accepted.
    pub(super) fn accepted(&mut self, stamp_ns: i64) {
        push_newest(&mut self.stamps, stamp_ns, self.capacity);
        self.measured_ns = self.measure();
    }

    fn measure(&self) -> Option<i64> {
        if self.stamps.len() <= MIN_INTERVALS {
            return None;
        }
        let mut stamps: Vec<i64> = self.stamps.iter().copied().collect();
        stamps.sort_unstable();
        let mut intervals: Vec<i64> = stamps.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
        intervals.sort_unstable();
        let trimmed = intervals.len() / TRIMMED;
        let middle = &intervals[trimmed..intervals.len() - trimmed];
        let sum: i128 = middle.iter().map(|interval| i128::from(*interval)).sum();
        Some((sum / middle.len() as i128) as i64).filter(|period| *period > 0)
    }

    /// Time between two messages, nanoseconds: as measured or as stated, whichever is shorter.
    pub(super) fn period_ns(&self) -> Option<i64> {
        let stated_ns = self.stated_hz.map(|rate| (1e9 / rate) as i64);
        self.measured_ns.into_iter().chain(stated_ns).min()
    }

    /// Whether anything has come yet.
    pub(super) fn has_come(&self) -> bool {
        self.last_arrival.is_some()
    }

    /// How long nothing has come, since the last message or the start, where that is too long.
    pub(super) fn silence(&self, now: Duration) -> Option<Duration> {
        let silent = now.saturating_sub(self.last_arrival.unwrap_or_default());
        let periods = self.period_ns().map_or(0.0, |period| SILENT_PERIODS * period as f64 * 1e-9);
        (silent > self.silent.max(Duration::from_secs_f64(periods.min(10.0)))).then_some(silent)
    }

    /// Measured and stated rate (Hz), where they differ.
    pub(super) fn wrong_rate(&self) -> Option<(f64, f64)> {
        if self.stamps.len() < self.capacity / 2 {
            return None;
        }
        let measured = 1e9 / self.measured_ns? as f64;
        let stated = self.stated_hz?;
        (measured > stated * RATE_FACTOR || measured * RATE_FACTOR < stated).then_some((measured, stated))
    }
}
