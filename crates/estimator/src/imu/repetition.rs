//! Readings that repeat: a driver that hands out its last reading again and again.
//!
//! White noise makes two readings of six axes differ. A sensor that shows noise and then repeats itself exactly for longer than it
//! ever did (some drivers publish faster than the sensor measures) is not measuring: what moves meanwhile is not in its readings.
//! The filter then takes them for a guess of the motion, as in a gap, and says so. A simulator without noise repeats itself at
//! rest; its readings show no noise before, and nothing is made of it.

use types::ImuSample;

/// Fewest repetitions that do not come about by chance, and the least time in which the motion changes, nanoseconds.
const MIN_COUNT: usize = 4;
const MIN_NS: i64 = 20_000_000;
/// Time after which they are a fault, nanoseconds.
const FAULT_NS: i64 = 100_000_000;
/// How much longer than any before.
const LONGER: usize = 4;

/// What is wrong with the readings of the IMU.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ImuFault {
    /// The last reading comes again and again.
    #[error(
        "the IMU repeats one reading for {seconds:.1} s: the motion is known by the cameras only; check the driver and the cable of the IMU"
    )]
    Repeats {
        /// For how long, seconds.
        seconds: f64,
    },
}

/// The watch over the readings of one IMU.
#[derive(Clone, Debug, Default)]
pub(crate) struct Repetition {
    newest: Option<ImuSample>,
    begin_ns: i64,
    count: usize,
    /// Most repetitions that ended before they were a fault.
    usual: usize,
    /// Whether the readings showed noise when the present ones began to repeat.
    is_noisy: bool,
    /// Time of the newest reading that was no measurement, nanoseconds.
    guess_until_ns: Option<i64>,
}

impl Repetition {
    /// Takes in a reading.
    ///
    /// # Arguments
    /// * `is_noisy`: whether the readings before show white noise; asked where a row of repetitions begins.
    pub(crate) fn note(&mut self, reading: &ImuSample, is_noisy: impl FnOnce() -> bool) {
        let repeats = self.newest.is_some_and(|newest| {
            newest.gyroscope == reading.gyroscope && newest.accelerometer == reading.accelerometer
        });
        if repeats {
            self.count += 1;
            if self.count == 1 {
                self.is_noisy = is_noisy();
            }
        } else {
            if !self.is_fault() {
                self.usual = self.usual.max(self.count);
            }
            (self.count, self.begin_ns) = (0, reading.stamp_ns);
        }
        self.newest = Some(*reading);
        if self.is_guess() {
            self.guess_until_ns = Some(reading.stamp_ns);
        }
    }

    /// Whether readings after a time are no measurements.
    pub(crate) fn is_guess_after(&self, stamp_ns: i64) -> bool {
        self.guess_until_ns.is_some_and(|until_ns| until_ns > stamp_ns)
    }

    /// Whether the newest readings are no measurements.
    fn is_guess(&self) -> bool {
        let enough = MIN_COUNT.max(LONGER * self.usual);
        self.is_noisy && self.count >= enough && self.elapsed_ns() >= MIN_NS
    }

    /// Whether they have been none for so long that somebody must be told.
    pub(crate) fn is_fault(&self) -> bool {
        self.is_guess() && self.elapsed_ns() >= FAULT_NS
    }

    /// Whether the newest reading is one of a row that may become a fault: it shows no noise.
    pub(crate) fn repeats(&self) -> bool {
        self.is_noisy && self.count > self.usual
    }

    pub(crate) fn fault(&self) -> Option<ImuFault> {
        self.is_fault().then(|| ImuFault::Repeats { seconds: self.elapsed_ns() as f64 * 1e-9 })
    }

    fn elapsed_ns(&self) -> i64 {
        self.newest.map_or(0, |newest| newest.stamp_ns - self.begin_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// The `k`th reading at 200 Hz, with values of the `of`th.
    fn reading(k: i64, of: i64) -> ImuSample {
        let value = (of as f64 * 0.7).sin();
        ImuSample {
            stamp_ns: k * 5_000_000,
            gyroscope: Vector3::new(value, 0.1, 0.0),
            accelerometer: Vector3::new(0.0, value, 9.8),
        }
    }

    /// For how long the readings repeat at the end, milliseconds, where `of` gives whose values the `k`th has.
    fn fault(is_noisy: bool, of: impl Fn(i64) -> i64) -> Option<i64> {
        let mut repetition = Repetition::default();
        (0..400).for_each(|k| repetition.note(&reading(k, of(k)), || is_noisy));
        repetition.fault().map(|ImuFault::Repeats { seconds }| (seconds * 1e3).round() as i64)
    }

    #[test]
    fn a_reading_that_repeats_is_a_fault_where_the_others_show_noise() {
        assert_eq!(fault(true, |k| k), None);
        assert_eq!(fault(true, |k| k.min(385)), None, "70 ms");
        assert_eq!(fault(true, |k| k.min(300)), Some(495));
        assert_eq!(fault(false, |k| k.min(300)), None, "a simulator without noise");
    }

    #[test]
    fn a_driver_that_is_faster_than_its_sensor_is_none() {
        assert_eq!(fault(true, |k| k / 10), None);
        assert_eq!(fault(true, |k| k.min(370) / 10), None, "four times as long as usual");
        assert_eq!(fault(true, |k| k.min(300) / 10), Some(495));
    }

    #[test]
    fn another_reading_ends_it_and_it_does_not_become_usual() {
        let mut repetition = Repetition::default();
        (0..100).for_each(|k| repetition.note(&reading(k, k.min(50)), || true));
        assert!(repetition.is_fault() && repetition.repeats());
        repetition.note(&reading(100, 100), || true);
        assert!(!repetition.is_guess() && repetition.is_guess_after(490_000_000));
        assert!(!repetition.is_guess_after(495_000_000), "the last one that repeats");
        (101..140).for_each(|k| repetition.note(&reading(k, 100), || true));
        assert!(repetition.is_fault());
    }
}
