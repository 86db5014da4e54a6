//! IMU samples, and the buffer that hands out the samples of an interval.

use crate::EstimatorError;
use nalgebra::Vector3;
use smallvec::SmallVec;
use std::collections::VecDeque;

/// One reading of the IMU, in the IMU frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// Angular velocity, rad/s.
    pub gyroscope: Vector3<f64>,
    /// Specific force, m/s^2 (at rest it points up).
    pub accelerometer: Vector3<f64>,
}

impl ImuSample {
    fn is_finite(&self) -> bool {
        self.gyroscope.iter().chain(self.accelerometer.iter()).all(|value| value.is_finite())
    }

    /// Linear interpolation between two readings.
    fn between(a: &Self, b: &Self, stamp_ns: i64) -> Self {
        let span = (b.stamp_ns - a.stamp_ns) as f64;
        let weight = if span > 0.0 { (stamp_ns - a.stamp_ns) as f64 / span } else { 0.0 };
        Self {
            stamp_ns,
            gyroscope: a.gyroscope.lerp(&b.gyroscope, weight),
            accelerometer: a.accelerometer.lerp(&b.accelerometer, weight),
        }
    }
}

/// The readings between two images. Those of 150 ms at 400 Hz need no memory from the heap.
pub type Readings = SmallVec<[ImuSample; 62]>;

/// Readings that the filter has not passed yet, and the last one that it has.
#[derive(Clone, Debug, Default)]
pub struct ImuBuffer {
    samples: VecDeque<ImuSample>,
}

impl ImuBuffer {
    /// Appends a reading.
    ///
    /// # Errors
    /// [`EstimatorError::BadImu`] for a reading that is not finite or not newer than the last one; it is dropped.
    pub fn push(&mut self, sample: ImuSample) -> Result<(), EstimatorError> {
        if !sample.is_finite() {
            return Err(EstimatorError::BadImu { stamp_ns: sample.stamp_ns, why: "a value is not finite" });
        }
        if self.samples.back().is_some_and(|last| last.stamp_ns >= sample.stamp_ns) {
            return Err(EstimatorError::BadImu {
                stamp_ns: sample.stamp_ns,
                why: "it is not newer than the one before",
            });
        }
        self.samples.push_back(sample);
        Ok(())
    }

    /// The newest reading.
    pub fn newest(&self) -> Option<ImuSample> {
        self.samples.back().copied()
    }

    /// All readings, oldest first.
    pub fn readings(&self) -> impl Iterator<Item = &ImuSample> {
        self.samples.iter()
    }

    /// The readings from `from_ns` to `to_ns`, with interpolated ones at both ends.
    ///
    /// Where the recording begins or ends within `slack_ns` of an end, the nearest reading is held.
    ///
    /// # Errors
    /// [`EstimatorError::NoImu`] when the interval is not covered.
    pub fn interval(&self, from_ns: i64, to_ns: i64, slack_ns: i64) -> Result<Readings, EstimatorError> {
        let missing = EstimatorError::NoImu { from_ns, to_ns };
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

    /// The reading at `stamp_ns`, which lies before sample `next`.
    fn at(&self, next: usize, stamp_ns: i64) -> ImuSample {
        let clamp = |index: usize| self.samples[index.min(self.samples.len() - 1)];
        if next == 0 || next >= self.samples.len() {
            return ImuSample { stamp_ns, ..clamp(next) };
        }
        ImuSample::between(&clamp(next - 1), &clamp(next), stamp_ns)
    }

    /// Forgets readings that lie before the one just before `stamp_ns`.
    pub fn forget_before(&mut self, stamp_ns: i64) {
        while self.samples.len() > 1 && self.samples[1].stamp_ns <= stamp_ns {
            self.samples.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(stamp_ns: i64) -> ImuSample {
        ImuSample { stamp_ns, gyroscope: Vector3::repeat(stamp_ns as f64), accelerometer: Vector3::zeros() }
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
        assert!(readings.iter().all(|reading| (reading.gyroscope.x - reading.stamp_ns as f64).abs() < 1e-12));
        buffer.forget_before(42);
        assert_eq!(buffer.interval(42, 55, 0).unwrap().len(), 3);
        assert!(buffer.interval(15, 42, 0).is_err(), "forgotten readings are missed, not invented");
        assert!(buffer.interval(80, 95, 0).is_err());
        assert_eq!(buffer.interval(80, 95, 10).unwrap().last().unwrap().stamp_ns, 95);
    }

    #[test]
    fn bad_readings_are_refused_and_the_rest_goes_on() {
        let mut buffer = ImuBuffer::default();
        buffer.push(sample(10)).unwrap();
        assert!(buffer.push(sample(10)).is_err());
        assert!(buffer.push(ImuSample { gyroscope: Vector3::repeat(f64::NAN), ..sample(20) }).is_err());
        buffer.push(sample(30)).unwrap();
        assert_eq!(buffer.newest(), Some(sample(30)));
    }
}
