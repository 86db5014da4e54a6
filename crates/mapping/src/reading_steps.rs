//! The readings of an IMU between two times, step by step, for integrals by the trapezoidal rule.

use geometry::rotation::exp;
use nalgebra::UnitQuaternion;
use sensors::ImuSample;

/// Readings that are further apart than this (ns) leave a hole: nothing is known of what was between them.
const MAX_STEP_NS: i64 = 100_000_000;

/// Two readings, and the time between them.
pub(super) struct ReadingStep<'a> {
    pub(super) first: &'a ImuSample,
    pub(super) second: &'a ImuSample,
    /// Of it what lies between the two times.
    pub(super) seconds: f64,
}

impl ReadingStep<'_> {
    /// How the gyroscope turned.
    pub(super) fn turn(&self) -> UnitQuaternion<f64> {
        exp(&((self.first.gyroscope + self.second.gyroscope) * (0.5 * self.seconds)))
    }
}

/// The steps between two times (ns); `None` where readings, in order of time, do not cover them, or leave a hole of more than 0.1 s.
pub(super) fn steps(
    readings: &[ImuSample],
    from_ns: i64,
    to_ns: i64,
) -> Option<impl Iterator<Item = ReadingStep<'_>>> {
    let begin = readings.partition_point(|reading| reading.stamp_ns <= from_ns).checked_sub(1)?;
    let end = readings.partition_point(|reading| reading.stamp_ns < to_ns);
    let covering = readings.get(begin..=end)?;
    if covering.windows(2).any(|pair| pair[1].stamp_ns - pair[0].stamp_ns > MAX_STEP_NS) {
        return None;
    }
    Some(covering.windows(2).map(move |pair| {
        let (start, stop) = (pair[0].stamp_ns.max(from_ns), pair[1].stamp_ns.min(to_ns));
        ReadingStep { first: &pair[0], second: &pair[1], seconds: (stop - start) as f64 * 1e-9 }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn steps_cover_a_time_without_a_hole_and_none_with_one() {
        let reading = |index: i64| ImuSample {
            stamp_ns: index * 10_000_000,
            gyroscope: Vector3::z(),
            accelerometer: Vector3::zeros(),
        };
        let mut readings: Vec<ImuSample> = (0..200).map(reading).collect();
        let seconds = |readings: &[ImuSample], from_ns: i64, to_ns: i64| {
            Some(steps(readings, from_ns, to_ns)?.map(|step| step.seconds).sum::<f64>())
        };
        assert!((seconds(&readings, 5_000_000, 1_495_000_000).unwrap() - 1.49).abs() < 1e-9);
        assert_eq!(seconds(&readings, 5_000_000, 2_100_000_000), None, "beyond the last one");
        // A hole of 0.1 s is none, one of 0.11 s is.
        readings.retain(|reading| !(501_000_000..599_000_000).contains(&reading.stamp_ns));
        assert!(seconds(&readings, 0, 1_000_000_000).is_some());
        readings.retain(|reading| reading.stamp_ns != 600_000_000);
        assert_eq!(seconds(&readings, 0, 1_000_000_000), None);
        assert_eq!(seconds(&readings, 550_000_000, 560_000_000), None, "within the hole");
        assert!(seconds(&readings, 610_000_000, 1_000_000_000).is_some());
    }
}
