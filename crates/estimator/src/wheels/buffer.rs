//! Readings of the wheels that wait for the images before and after them.

use std::collections::VecDeque;
use types::{WheelReading, push_newest};

/// Longest time between two readings that is interpolated, nanoseconds.
const MAX_GAP_NS: i64 = 250_000_000;
/// Speed beyond which a reading is nonsense, rad/s: a wheel of 10 cm at 50 m/s.
const MAX_SPEED: f64 = 500.0;
/// Most readings that are kept.
const MAX_READINGS: usize = 10_000;

/// Why a reading of the wheels was dropped.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BadWheelReading {
    /// A speed is NaN or infinite.
    #[error("wheel reading at {stamp_ns} ns dropped: a speed is not finite")]
    NotFinite {
        /// Time of the reading, nanoseconds.
        stamp_ns: i64,
    },
    /// The reading is not newer than the one before.
    #[error(
        "wheel reading at {stamp_ns} ns dropped: it is not newer than the one before, at {previous_ns} ns"
    )]
    NotNewer {
        /// Time of the reading, nanoseconds.
        stamp_ns: i64,
        /// Time of the reading before, nanoseconds.
        previous_ns: i64,
    },
    /// No wheel turns so fast.
    #[error(
        "wheel reading at {stamp_ns} ns dropped: {speed:.0} rad/s is no speed of a wheel; check its unit"
    )]
    Implausible {
        /// Time of the reading, nanoseconds.
        stamp_ns: i64,
        /// The faster wheel, rad/s.
        speed: f64,
    },
}

/// Readings of an interval.
#[derive(Clone, Debug, PartialEq)]
pub struct WheelInterval {
    /// In order of time; the first and the last one are interpolated at its ends.
    pub readings: Vec<WheelReading>,
    /// Time between two readings before that, seconds.
    pub period_s: f64,
}

/// What is known of an interval.
#[derive(Clone, Debug, PartialEq)]
pub enum Interval {
    /// All of it.
    Covered(WheelInterval),
    /// It ends after the newest reading.
    NotYet,
    /// It begins before the oldest reading, or there is a gap in it.
    Missing,
}

/// The readings since the oldest image that waits for them.
#[derive(Clone, Debug, Default)]
pub struct WheelBuffer {
    readings: VecDeque<WheelReading>,
}

impl WheelBuffer {
    /// Appends a reading.
    ///
    /// # Errors
    /// [`BadWheelReading`]: it is dropped.
    pub fn push(&mut self, reading: WheelReading) -> Result<(), BadWheelReading> {
        let stamp_ns = reading.stamp_ns;
        if !reading.is_finite() {
            return Err(BadWheelReading::NotFinite { stamp_ns });
        }
        let speed = reading.values.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        if speed > MAX_SPEED {
            return Err(BadWheelReading::Implausible { stamp_ns, speed });
        }
        if let Some(previous) = self.readings.back().filter(|previous| previous.stamp_ns >= stamp_ns) {
            return Err(BadWheelReading::NotNewer { stamp_ns, previous_ns: previous.stamp_ns });
        }
        push_newest(&mut self.readings, reading, MAX_READINGS);
        Ok(())
    }

    /// Time of the newest reading, nanoseconds.
    pub fn newest_ns(&self) -> Option<i64> {
        self.readings.back().map(|reading| reading.stamp_ns)
    }

    /// The readings from `from_ns` to `to_ns` by the clock of the wheels, interpolated at both ends.
    pub fn interval(&self, from_ns: i64, to_ns: i64) -> Interval {
        let (Some(oldest), Some(newest)) = (self.readings.front(), self.readings.back()) else {
            return Interval::NotYet;
        };
        if newest.stamp_ns < to_ns {
            return Interval::NotYet;
        }
        if oldest.stamp_ns > from_ns || to_ns <= from_ns {
            return Interval::Missing;
        }
        // The first reading after the begin, and the first one not before the end.
        let begin = self.readings.partition_point(|reading| reading.stamp_ns <= from_ns);
        let end = self.readings.partition_point(|reading| reading.stamp_ns < to_ns);
        let around = self.readings.range(begin.saturating_sub(1)..=end);
        let steps = around.clone().zip(around.skip(1)).map(|(one, next)| next.stamp_ns - one.stamp_ns);
        if steps.clone().any(|step_ns| step_ns > MAX_GAP_NS) {
            return Interval::Missing;
        }
        let period_s = steps.clone().sum::<i64>() as f64 * 1e-9 / steps.count().max(1) as f64;
        let at = |index: usize, stamp_ns: i64| {
            let after = self.readings[index.min(self.readings.len() - 1)];
            match index.checked_sub(1).map(|before| self.readings[before]) {
                Some(before) => WheelReading::between(&before, &after, stamp_ns),
                None => WheelReading { stamp_ns, ..after },
            }
        };
        let mut readings = Vec::with_capacity(end - begin + 2);
        readings.push(at(begin, from_ns));
        readings.extend(self.readings.range(begin..end.max(begin)).copied());
        readings.push(at(end, to_ns));
        Interval::Covered(WheelInterval { readings, period_s })
    }

    /// Drops the readings that only intervals before `stamp_ns` need.
    pub fn remove_before(&mut self, stamp_ns: i64) {
        while self.readings.get(1).is_some_and(|second| second.stamp_ns <= stamp_ns) {
            self.readings.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(stamp_ns: i64) -> WheelReading {
        WheelReading::new(stamp_ns, [stamp_ns as f64 * 1e-8, 1.0])
    }

    #[test]
    fn an_interval_is_interpolated_at_its_ends() {
        let mut buffer = WheelBuffer::default();
        assert_eq!(buffer.interval(0, 1), Interval::NotYet);
        (1..10).for_each(|k| buffer.push(reading(k * 20_000_000)).unwrap());
        let Interval::Covered(interval) = buffer.interval(25_000_000, 75_000_000) else { panic!() };
        let WheelInterval { readings, period_s } = interval;
        assert!((period_s - 0.02).abs() < 1e-12);
        let stamps: Vec<i64> = readings.iter().map(|reading| reading.stamp_ns / 1_000_000).collect();
        assert_eq!(stamps, [25, 40, 60, 75]);
        assert!(
            readings.iter().all(|reading| (reading.values[0] - reading.stamp_ns as f64 * 1e-8).abs() < 1e-12)
        );
        assert_eq!(buffer.interval(10_000_000, 75_000_000), Interval::Missing);
        assert_eq!(buffer.interval(30_000_000, 190_000_000), Interval::NotYet);
        assert!(matches!(buffer.interval(40_000_000, 180_000_000), Interval::Covered(_)));
        buffer.remove_before(75_000_000);
        assert!(matches!(buffer.interval(75_000_000, 100_000_000), Interval::Covered(_)));
        assert_eq!(buffer.interval(25_000_000, 75_000_000), Interval::Missing);
        buffer.push(reading(800_000_000)).unwrap();
        assert_eq!(buffer.interval(100_000_000, 300_000_000), Interval::Missing, "a gap of 0.6 s");
    }

    #[test]
    fn nonsense_is_dropped_and_later_readings_accepted() {
        let mut buffer = WheelBuffer::default();
        buffer.push(reading(10)).unwrap();
        let refused = |bad: WheelReading| buffer.clone().push(bad).unwrap_err();
        assert!(matches!(refused(reading(10)), BadWheelReading::NotNewer { .. }));
        let not_a_number = WheelReading::new(20, [f64::NAN]);
        assert!(matches!(refused(not_a_number), BadWheelReading::NotFinite { .. }));
        let fast = WheelReading::new(20, [0.0, -1e4]);
        assert!(matches!(refused(fast), BadWheelReading::Implausible { .. }));
        buffer.push(reading(30)).unwrap();
        assert_eq!(buffer.newest_ns(), Some(30));
    }
}
