//! The readings of an IMU between two times, step by step, for integrals by the trapezoidal rule.

use geometry::rotation::exp;
use nalgebra::UnitQuaternion;
use sensors::ImuSample;

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

/// The steps between two times (ns); `None` where readings, in order of time, do not cover them.
pub(super) fn steps(
    readings: &[ImuSample],
    from_ns: i64,
    to_ns: i64,
) -> Option<impl Iterator<Item = ReadingStep<'_>>> {
    let begin = readings.partition_point(|reading| reading.stamp_ns <= from_ns).checked_sub(1)?;
    let end = readings.partition_point(|reading| reading.stamp_ns < to_ns);
    readings.get(end)?;
    Some(readings[begin..=end].windows(2).map(move |pair| {
        let (start, stop) = (pair[0].stamp_ns.max(from_ns), pair[1].stamp_ns.min(to_ns));
        ReadingStep { first: &pair[0], second: &pair[1], seconds: (stop - start) as f64 * 1e-9 }
    }))
}
