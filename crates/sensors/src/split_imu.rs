//! Gyroscope and accelerometer that come for themselves: the specific force is interpolated to the times of the gyroscope.

use crate::ImuSample;
use nalgebra::Vector3;
use std::collections::VecDeque;

/// Over longer gaps of the accelerometer the specific force is not known, nanoseconds.
const MAX_GAP_NS: i64 = 100_000_000;
/// A stamp that is so much older than the newest one is of a clock that went back, nanoseconds.
const BACKWARD_NS: i64 = 300_000_000;
/// So many values of one sensor wait for the other, ten seconds at 1 kHz; beyond, the oldest are left out.
const MAX_WAITING: usize = 10_000;

/// Unites the values of a gyroscope and an accelerometer to readings of an IMU at the times of the gyroscope.
///
/// Values of one sensor come in order of time; one that does not is left out. Readings before the first and after the last
/// specific force, and those within its gaps of more than 0.1 s, are left out.
///
/// ```
/// use nalgebra::Vector3;
///
/// let mut imu = sensors::SplitImu::default();
/// imu.add_accelerometer(0, Vector3::z() * 9.0);
/// imu.add_gyroscope(1_000_000, Vector3::x());
/// assert!(imu.pop().is_none());
/// imu.add_accelerometer(4_000_000, Vector3::z() * 10.0);
/// assert_eq!(imu.pop().unwrap().accelerometer.z, 9.25);
/// ```
#[derive(Clone, Debug, Default)]
pub struct SplitImu {
    /// Angular velocities (rad/s) of the next readings.
    gyroscope: Waiting,
    /// Specific forces (m/s^2), from the newest one up to the next reading on.
    accelerometer: Waiting,
    in_gaps: usize,
}

impl SplitImu {
    /// Takes an angular velocity, rad/s.
    pub fn add_gyroscope(&mut self, stamp_ns: i64, angular_velocity: Vector3<f64>) {
        self.gyroscope.add(stamp_ns, angular_velocity);
    }

    /// Takes a specific force, m/s^2.
    pub fn add_accelerometer(&mut self, stamp_ns: i64, specific_force: Vector3<f64>) {
        self.accelerometer.add(stamp_ns, specific_force);
    }

    /// The next reading; `None` until there is more of the accelerometer, or of both.
    pub fn pop(&mut self) -> Option<ImuSample> {
        let (gyroscopes, forces) = (&mut self.gyroscope.values, &mut self.accelerometer.values);
        loop {
            let &(stamp_ns, gyroscope) = gyroscopes.front()?;
            while forces.get(1).is_some_and(|(next_ns, _)| *next_ns <= stamp_ns) {
                forces.pop_front();
            }
            let &(from_ns, from) = forces.front()?;
            let force = if from_ns >= stamp_ns {
                (from_ns == stamp_ns).then_some(from)
            } else {
                let &(to_ns, to) = forces.get(1)?;
                let part = (stamp_ns - from_ns) as f64 / (to_ns - from_ns) as f64;
                let is_gap = to_ns.saturating_sub(from_ns) > MAX_GAP_NS;
                self.in_gaps += usize::from(is_gap);
                (!is_gap).then(|| from.lerp(&to, part))
            };
            gyroscopes.pop_front();
            if let Some(accelerometer) = force {
                return Some(ImuSample { stamp_ns, gyroscope, accelerometer });
            }
        }
    }

    /// Whether angular velocities wait for a later specific force.
    pub fn is_waiting(&self) -> bool {
        !self.gyroscope.values.is_empty()
    }

    /// Readings that were left out because they are within gaps of the accelerometer.
    pub fn in_gaps(&self) -> usize {
        self.in_gaps
    }

    /// How long the oldest angular velocity waits for the accelerometer already, nanoseconds of the gyroscope's time.
    pub fn waiting_ns(&self) -> i64 {
        match (self.gyroscope.values.front(), self.gyroscope.values.back()) {
            (Some((first_ns, _)), Some((last_ns, _))) => last_ns - first_ns,
            _ => 0,
        }
    }
}

/// The values of one sensor that are still needed.
#[derive(Clone, Debug, Default)]
struct Waiting {
    values: VecDeque<(i64, Vector3<f64>)>,
    newest_ns: Option<i64>,
}

impl Waiting {
    /// Takes a value that is newer than those before; behind a clock that went back, those are forgotten.
    fn add(&mut self, stamp_ns: i64, value: Vector3<f64>) {
        if let Some(newest_ns) = self.newest_ns.filter(|newest_ns| stamp_ns <= *newest_ns) {
            if newest_ns.saturating_sub(stamp_ns) < BACKWARD_NS {
                return;
            }
            self.values.clear();
        }
        self.newest_ns = Some(stamp_ns);
        self.values.push_back((stamp_ns, value));
        if self.values.len() > MAX_WAITING {
            self.values.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn force(milliseconds: i64) -> Vector3<f64> {
        Vector3::new(milliseconds as f64, 0.0, 9.81)
    }

    fn popped(imu: &mut SplitImu) -> Vec<(i64, f64)> {
        std::iter::from_fn(|| imu.pop())
            .map(|reading| (reading.stamp_ns / 1_000_000, reading.accelerometer.x))
            .collect()
    }

    #[test]
    fn every_angular_velocity_between_two_specific_forces_is_a_reading() {
        let mut imu = SplitImu::default();
        let mut readings = Vec::new();
        for milliseconds in 0..100 {
            if milliseconds % 5 == 0 {
                imu.add_gyroscope(milliseconds * 1_000_000, Vector3::zeros());
            }
            if milliseconds % 10 == 3 {
                imu.add_accelerometer(milliseconds * 1_000_000, force(milliseconds));
            }
            readings.extend(popped(&mut imu));
        }
        // The first two are before the first specific force, the last one waits for the next.
        let expected: Vec<(i64, f64)> = (1..19).map(|number| (5 * number, 5.0 * number as f64)).collect();
        assert_eq!(readings.len(), expected.len());
        for ((stamp, value), (expected_stamp, expected)) in readings.iter().zip(expected) {
            assert!(*stamp == expected_stamp && (value - expected).abs() < 1e-9, "{stamp}: {value}");
        }
        assert!(imu.is_waiting() && imu.waiting_ns() == 0);
    }

    #[test]
    fn gaps_are_left_out_and_a_clock_that_went_back_goes_on() {
        let mut imu = SplitImu::default();
        imu.add_accelerometer(0, force(0));
        imu.add_gyroscope(50_000_000, Vector3::zeros());
        imu.add_accelerometer(200_000_000, force(200));
        imu.add_gyroscope(200_000_000, Vector3::zeros());
        assert_eq!(popped(&mut imu), [(200, 200.0)]);
        assert_eq!(imu.in_gaps(), 1);
        imu.add_accelerometer(190_000_000, force(7));
        imu.add_accelerometer(2_000_000_000, force(2000));
        imu.add_gyroscope(1_900_000_000, Vector3::zeros());
        imu.add_gyroscope(2_000_000, Vector3::zeros());
        imu.add_accelerometer(1_000_000, force(1));
        imu.add_accelerometer(3_000_000, force(3));
        assert_eq!(popped(&mut imu), [(2, 2.0)]);
    }
}
