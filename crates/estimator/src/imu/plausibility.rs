//! Readings that no motion explains.
//!
//! A loose cable, a driver that loses bytes, or a saturated sensor gives numbers that are finite and far from the motion: one
//! reading of 35 rad/s turns the estimate by 10 degrees, and no later image shows that it was the yaw. Two bounds tell them:
//! the range that no inertial sensor exceeds, and the change from one reading to the next. A body accelerates by a torque, so
//! its rate of rotation changes gradually; the specific force jumps with impacts and vibration, by what the readings before
//! have shown and a bound for a single impact.
//!
//! Where readings keep to a new level for a while they are the motion after all, or nothing that this check could tell, and
//! are taken again.

use super::BadImuSample;
use types::ImuSample;

/// No inertial sensor of a robot measures more, rad/s and m/s^2.
pub const RANGE: [f64; 2] = [100.0, 2000.0];
/// Change that one reading may show whatever its rate: impacts, and the noise of a bad sensor, rad/s and m/s^2.
const MAX_JUMP: [f64; 2] = [2.0, 60.0];
/// Change a second on top: a racing drone's rate of rotation changes by 200 to 300 rad/s^2; specific force as fast as a stop from
/// 3 g within 10 ms.
const MAX_CHANGE: [f64; 2] = [500.0, 3000.0];
/// Change in units of the root mean square of those before: vibration.
const VIBRATION: f64 = 6.0;
/// Readings over which that is averaged.
const AVERAGED: f64 = 400.0;
/// A level that lasts for so long is taken for the motion, nanoseconds.
const LASTING_NS: i64 = 100_000_000;
/// The largest time between two readings in which the change is bounded, nanoseconds; after a longer one nothing is known.
const LONGEST_NS: i64 = 100_000_000;
/// The change is bounded as that of this time where more has passed since the last accepted reading, seconds.
const LONGEST_CHANGE_S: f64 = 0.01;

/// Checks the readings of one IMU in the order of time.
#[derive(Clone, Debug, Default)]
pub struct ReadingCheck {
    /// The newest reading that was accepted.
    accepted: Option<ImuSample>,
    /// The newest one that was refused for its change, and when such readings began, nanoseconds.
    refused: Option<(i64, ImuSample)>,
    /// When the newest reading came, nanoseconds, whatever became of it.
    newest_ns: i64,
    /// Mean squared change between accepted readings, of the gyroscope and the accelerometer.
    squared_changes: [f64; 2],
}

impl ReadingCheck {
    /// Whether a reading can be used.
    ///
    /// # Errors
    /// [`BadImuSample`]: it is to be left out.
    pub fn check(&mut self, reading: &ImuSample) -> Result<(), BadImuSample> {
        let stamp_ns = reading.stamp_ns;
        if !reading.is_finite() {
            return Err(BadImuSample::NotFinite { stamp_ns });
        }
        if let Some(previous) = self.accepted.filter(|previous| previous.stamp_ns >= stamp_ns) {
            return Err(BadImuSample::NotNewer { stamp_ns, previous_ns: previous.stamp_ns });
        }
        let elapsed_ns = stamp_ns - self.newest_ns;
        self.newest_ns = stamp_ns;
        let implausible = BadImuSample::Implausible {
            stamp_ns,
            gyroscope: reading.gyroscope.amax(),
            accelerometer: reading.accelerometer.amax(),
        };
        if reading.gyroscope.amax() > RANGE[0] || reading.accelerometer.amax() > RANGE[1] {
            return Err(implausible);
        }
        let Some(accepted) = self.accepted.filter(|_| elapsed_ns <= LONGEST_NS) else {
            self.accept(reading);
            return Ok(());
        };
        if self.is_gradual(&accepted, reading) {
            self.note_change(&accepted, reading);
            self.accept(reading);
            return Ok(());
        }
        let begin_ns = match &self.refused {
            Some((begin_ns, before)) if self.is_gradual(before, reading) => *begin_ns,
            _ => stamp_ns,
        };
        if stamp_ns - begin_ns >= LASTING_NS {
            self.accept(reading);
            return Ok(());
        }
        self.refused = Some((begin_ns, *reading));
        Err(implausible)
    }

    /// The newest reading that can be used.
    pub(crate) fn newest(&self) -> Option<ImuSample> {
        self.accepted
    }

    /// The same check, as it would be after a reading.
    pub(crate) fn starting_after(&self, reading: Option<&ImuSample>) -> Self {
        let newest_ns = reading.map_or(0, |reading| reading.stamp_ns);
        Self { accepted: reading.copied(), refused: None, newest_ns, squared_changes: self.squared_changes }
    }

    fn accept(&mut self, reading: &ImuSample) {
        (self.accepted, self.refused) = (Some(*reading), None);
    }

    fn note_change(&mut self, before: &ImuSample, reading: &ImuSample) {
        for (mean, change) in self.squared_changes.iter_mut().zip(change(before, reading)) {
            *mean += (change * change - *mean) / AVERAGED;
        }
    }

    fn is_gradual(&self, before: &ImuSample, reading: &ImuSample) -> bool {
        let seconds = ((reading.stamp_ns - before.stamp_ns) as f64 * 1e-9).min(LONGEST_CHANGE_S);
        let bound =
            |k: usize| MAX_JUMP[k] + MAX_CHANGE[k] * seconds + VIBRATION * self.squared_changes[k].sqrt();
        change(before, reading).iter().enumerate().all(|(k, change)| *change <= bound(k))
    }
}

/// Magnitude of the change of the gyroscope and the accelerometer.
fn change(before: &ImuSample, reading: &ImuSample) -> [f64; 2] {
    [(reading.gyroscope - before.gyroscope).norm(), (reading.accelerometer - before.accelerometer).norm()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    const PERIOD_NS: i64 = 5_000_000;

    /// A walk with steps that shake the accelerometer.
    fn reading(k: i64) -> ImuSample {
        let t = k as f64 * 5e-3;
        let shaken = 12.0 * (7.0 * t).sin().powi(31) * (300.0 * t).cos();
        ImuSample {
            stamp_ns: k * PERIOD_NS,
            gyroscope: Vector3::new((9.0 * t).sin(), 2.0 * (5.0 * t).cos(), 1.0),
            accelerometer: Vector3::new(shaken, t.sin(), 9.81 + shaken),
        }
    }

    /// Which of the readings are refused, by index, where `faulty` changes some of them.
    fn refused(faulty: impl Fn(i64, &mut ImuSample)) -> Vec<i64> {
        let mut check = ReadingCheck::default();
        let is_refused = |k: &i64| {
            let mut reading = reading(*k);
            faulty(*k, &mut reading);
            check.check(&reading).is_err()
        };
        (0..1000).filter(is_refused).collect()
    }

    #[test]
    fn a_motion_with_impacts_is_plausible() {
        assert!(refused(|_, _| {}).is_empty());
    }

    #[test]
    fn readings_far_from_their_neighbours_are_refused_and_nothing_else() {
        for count in [1, 2, 10] {
            let at: Vec<i64> = (500..500 + count).collect();
            for value in [35.0, -35.0, 1e5, 1e300] {
                let rate = |k: i64, reading: &mut ImuSample| {
                    if at.contains(&k) {
                        reading.gyroscope.y = value;
                    }
                };
                assert_eq!(refused(rate), at, "{value} rad/s");
            }
            for value in [157.0, -157.0, 1e5, 1e300] {
                let force = |k: i64, reading: &mut ImuSample| {
                    if at.contains(&k) {
                        reading.accelerometer.x = value;
                    }
                };
                assert_eq!(refused(force), at, "{value} m/s^2");
            }
        }
    }

    #[test]
    fn numbers_beyond_the_range_are_refused_however_long_they_last() {
        let at: Vec<i64> = (300..900).collect();
        let beyond = |k: i64, reading: &mut ImuSample| {
            if at.contains(&k) {
                reading.gyroscope.z = 1e5;
            }
        };
        assert_eq!(refused(beyond), at);
    }

    #[test]
    fn a_level_that_lasts_is_taken_for_the_motion() {
        let thrown = |k: i64, reading: &mut ImuSample| {
            if k >= 500 {
                reading.gyroscope.z += 30.0;
            }
        };
        assert_eq!(refused(thrown), (500..520).collect::<Vec<_>>());
    }

    #[test]
    fn the_first_reading_may_be_the_faulty_one() {
        let first = |k: i64, reading: &mut ImuSample| {
            if k == 0 {
                reading.gyroscope.z = 35.0;
            }
        };
        assert_eq!(refused(first), (1..21).collect::<Vec<_>>());
    }
}
