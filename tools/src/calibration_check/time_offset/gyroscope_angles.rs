//! The gyroscope's mean rate between any two times.

use nalgebra::Vector3;
use sensors::ImuSample;

/// Readings further apart are a gap.
const MAX_GAP_NS: i64 = 50_000_000;

/// The integral of the gyroscope's rate since its first reading, by component: between two images rotations are small.
pub(super) struct GyroscopeAngles {
    /// Of the readings.
    stamps_ns: Vec<i64>,
    /// In the IMU frame, rad.
    angles: Vec<Vector3<f64>>,
}

impl GyroscopeAngles {
    /// # Arguments
    /// * `readings`: in order of time.
    pub(super) fn new(readings: &[ImuSample]) -> Self {
        let mut angle = Vector3::zeros();
        let mut angles: Vec<Vector3<f64>> = Vec::with_capacity(readings.len());
        for (index, reading) in readings.iter().enumerate() {
            if let Some(before) = index.checked_sub(1).map(|before| &readings[before]) {
                let seconds = (reading.stamp_ns - before.stamp_ns) as f64 * 1e-9;
                angle += 0.5 * (before.gyroscope + reading.gyroscope) * seconds;
            }
            angles.push(angle);
        }
        Self { stamps_ns: readings.iter().map(|reading| reading.stamp_ns).collect(), angles }
    }

    /// The mean rate between two times of the IMU's clock, in the IMU frame, rad/s; `None` where one of them is not between two
    /// readings that follow each other.
    pub(super) fn mean_rate(&self, from_ns: i64, to_ns: i64) -> Option<Vector3<f64>> {
        Some((self.at(to_ns)? - self.at(from_ns)?) / ((to_ns - from_ns) as f64 * 1e-9))
    }

    fn at(&self, stamp_ns: i64) -> Option<Vector3<f64>> {
        let after = self.stamps_ns.partition_point(|reading_ns| *reading_ns <= stamp_ns);
        let before = after.checked_sub(1)?;
        let (from_ns, to_ns) = (self.stamps_ns[before], *self.stamps_ns.get(after)?);
        let part = (stamp_ns - from_ns) as f64 / (to_ns - from_ns) as f64;
        (to_ns - from_ns <= MAX_GAP_NS).then(|| self.angles[before].lerp(&self.angles[after], part))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_that_grows_steadily_has_the_mean_of_its_ends() {
        let reading = |k: i64| ImuSample {
            stamp_ns: k * 5_000_000,
            gyroscope: Vector3::new(0.0, 1.0, k as f64 * 5e-3),
            accelerometer: Vector3::zeros(),
        };
        let mut readings: Vec<ImuSample> = (0..400).map(reading).collect();
        let rate = GyroscopeAngles::new(&readings).mean_rate(1_000_000_000, 1_050_000_000).unwrap();
        assert!((rate - Vector3::new(0.0, 1.0, 1.025)).norm() < 1e-9, "{rate}");
        // Neither beyond the readings nor in a gap.
        readings.retain(|reading| !(1_000_000_000..1_100_000_000).contains(&reading.stamp_ns));
        let angles = GyroscopeAngles::new(&readings);
        assert!(angles.mean_rate(900_000_000, 1_050_000_000).is_none());
        assert!(angles.mean_rate(-1, 50_000_000).is_none());
        assert!(angles.mean_rate(1_900_000_000, 2_000_000_000).is_none());
    }
}
