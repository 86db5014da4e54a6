//! IMU samples and the buffer that returns those of an interval.

pub mod plausibility;
pub(crate) mod repetition;

use plausibility::ReadingCheck;
use smallvec::SmallVec;
use std::collections::VecDeque;
use types::ImuSample;

/// Why an IMU sample was dropped.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BadImuSample {
    /// A value is NaN or infinite.
    #[error("IMU sample at {stamp_ns} ns dropped: a value is not finite")]
    NotFinite {
        /// Time of the sample, nanoseconds.
        stamp_ns: i64,
    },
    /// The sample is not newer than the one before.
    #[error("IMU sample at {stamp_ns} ns dropped: it is not newer than the one before, at {previous_ns} ns")]
    NotNewer {
        /// Time of the sample, nanoseconds.
        stamp_ns: i64,
        /// Time of the sample before, nanoseconds.
        previous_ns: i64,
    },
    /// No motion explains it, see [`plausibility`].
    #[error(
        "IMU sample at {stamp_ns} ns dropped: up to {gyroscope:.3} rad/s and {accelerometer:.3} m/s^2 after what came before is no \
         motion; check the IMU's cable, driver and range"
    )]
    Implausible {
        /// Time of the sample, nanoseconds.
        stamp_ns: i64,
        /// Largest magnitude of an axis, rad/s.
        gyroscope: f64,
        /// Largest magnitude of an axis, m/s^2.
        accelerometer: f64,
    },
}

/// An interval that the IMU samples do not cover.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no IMU samples from {from_ns} to {to_ns} ns; check the recording for a gap")]
pub struct ImuGap {
    /// Begin, nanoseconds.
    pub from_ns: i64,
    /// End, nanoseconds.
    pub to_ns: i64,
}

/// The samples between two images. Those of 150 ms at 400 Hz are stored without heap allocation.
pub type Readings = SmallVec<[ImuSample; 62]>;

/// Samples newer than the state, and the last one before it.
#[derive(Clone, Debug, Default)]
pub struct ImuBuffer {
    samples: VecDeque<ImuSample>,
    check: ReadingCheck,
}

impl ImuBuffer {
    /// Appends a sample.
    ///
    /// # Errors
    /// [`BadImuSample`] for a sample that is not finite, not newer than the last one, or that no motion explains; it is dropped.
    pub fn push(&mut self, sample: ImuSample) -> Result<(), BadImuSample> {
        self.check.check(&sample)?;
        self.samples.push_back(sample);
        Ok(())
    }

    /// A check of the samples after the oldest one.
    pub(crate) fn check_from_oldest(&self) -> ReadingCheck {
        self.check.starting_after(self.samples.front())
    }

    /// The newest sample.
    pub fn newest(&self) -> Option<ImuSample> {
        self.samples.back().copied()
    }

    /// All samples, oldest first.
    pub fn readings(&self) -> impl Iterator<Item = &ImuSample> {
        self.samples.iter()
    }

    /// The samples from `from_ns` to `to_ns`, interpolated at both ends.
    ///
    /// Where the samples begin or end within `slack_ns` of an end, the nearest one is extrapolated as constant.
    ///
    /// # Errors
    /// [`ImuGap`] when the interval is not covered.
    pub fn interval(&self, from_ns: i64, to_ns: i64, slack_ns: i64) -> Result<Readings, ImuGap> {
        let missing = ImuGap { from_ns, to_ns };
        let (Some(first), Some(last)) = (self.samples.front(), self.samples.back()) else {
            return Err(missing);
        };
        if first.stamp_ns > from_ns + slack_ns || last.stamp_ns < to_ns - slack_ns || to_ns <= from_ns {
            return Err(missing);
        }
        let begin = self.samples.partition_point(|sample| sample.stamp_ns <= from_ns);
        let end = self.samples.partition_point(|sample| sample.stamp_ns < to_ns);
        let mut readings = Readings::new();
        readings.push(self.at(begin, from_ns));
        readings.extend(self.samples.range(begin.min(end)..end).copied());
        readings.push(self.at(end, to_ns));
        Ok(readings)
    }

    /// The longest time between two successive samples that an interval is interpolated from, nanoseconds.
    pub fn longest_gap_ns(&self, from_ns: i64, to_ns: i64) -> i64 {
        let begin = self.samples.partition_point(|sample| sample.stamp_ns <= from_ns).saturating_sub(1);
        let end =
            (self.samples.partition_point(|sample| sample.stamp_ns < to_ns) + 1).min(self.samples.len());
        let stamps = self.samples.range(begin.min(end)..end).map(|sample| sample.stamp_ns);
        stamps.clone().zip(stamps.skip(1)).map(|(one, next)| next - one).max().unwrap_or(0)
    }

    /// The value at `stamp_ns`, which lies before sample `next`.
    fn at(&self, next: usize, stamp_ns: i64) -> ImuSample {
        let clamp = |index: usize| self.samples[index.min(self.samples.len() - 1)];
        if next == 0 || next >= self.samples.len() {
            return ImuSample { stamp_ns, ..clamp(next) };
        }
        ImuSample::between(&clamp(next - 1), &clamp(next), stamp_ns)
    }

    /// Removes all samples older than the last one at or before `stamp_ns`.
    pub fn remove_before(&mut self, stamp_ns: i64) {
        while self.samples.len() > 1 && self.samples[1].stamp_ns <= stamp_ns {
            self.samples.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn sample(stamp_ns: i64) -> ImuSample {
        ImuSample {
            stamp_ns,
            gyroscope: Vector3::repeat(stamp_ns as f64 * 1e-2),
            accelerometer: Vector3::zeros(),
        }
    }

    #[test]
    fn the_longest_gap_is_that_of_the_samples_also_where_an_interval_lies_within_it() {
        let mut buffer = ImuBuffer::default();
        for stamp_ns in [0, 5, 10, 40, 45, 50] {
            buffer.push(sample(stamp_ns)).unwrap();
        }
        for (from_ns, to_ns, expected) in [(0, 10, 5), (0, 50, 30), (15, 25, 30), (40, 50, 5), (7, 12, 30)] {
            assert_eq!(buffer.longest_gap_ns(from_ns, to_ns), expected, "{from_ns} to {to_ns}");
        }
        assert_eq!(ImuBuffer::default().longest_gap_ns(0, 10), 0);
    }

    #[test]
    fn an_interval_begins_and_ends_on_time_with_interpolated_readings() {
        let mut buffer = ImuBuffer::default();
        for k in 0..10 {
            buffer.push(sample(k * 10)).unwrap();
        }
        let readings = buffer.interval(15, 42, 0).unwrap();
        let stamps: Vec<i64> = readings.iter().map(|reading| reading.stamp_ns).collect();
        assert_eq!(stamps, [15, 20, 30, 40, 42]);
        assert!(
            readings
                .iter()
                .all(|reading| (reading.gyroscope.x - reading.stamp_ns as f64 * 1e-2).abs() < 1e-12)
        );
        buffer.remove_before(42);
        assert_eq!(buffer.interval(42, 55, 0).unwrap().len(), 3);
        assert!(buffer.interval(15, 42, 0).is_err(), "removed samples are missing, not extrapolated");
        assert!(buffer.interval(80, 95, 0).is_err());
        assert_eq!(buffer.interval(80, 95, 10).unwrap().last().unwrap().stamp_ns, 95);
    }

    #[test]
    fn invalid_samples_are_dropped_and_later_ones_accepted() {
        let mut buffer = ImuBuffer::default();
        buffer.push(sample(10)).unwrap();
        assert!(buffer.push(sample(10)).is_err());
        assert!(buffer.push(ImuSample { gyroscope: Vector3::repeat(f64::NAN), ..sample(20) }).is_err());
        buffer.push(sample(30)).unwrap();
        assert_eq!(buffer.newest(), Some(sample(30)));
    }
}
