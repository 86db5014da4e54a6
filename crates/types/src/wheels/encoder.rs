//! Encoders: angles of wheels as speeds.

use super::{MAX_WHEELS, WheelReading};
use std::f64::consts::TAU;

/// A difference is doubled back by the range of the counter where that is nearer to the last one.
const HALF: f64 = 0.5;

/// Why the numbers of an encoder cannot be those of one.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EncoderError {
    /// The counts of a revolution are not positive.
    #[error(
        "{0} counts per revolution: state how far the counter goes in one revolution of the wheel, with its gear"
    )]
    Resolution(f64),
    /// The counter is longer than a number holds.
    #[error("a counter of {0} bits: 8 to 53 are possible")]
    Bits(u32),
}

/// An encoder on each wheel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encoder {
    /// Counts of a revolution of the wheel.
    counts_per_revolution: f64,
    /// Counts after which the counter is where it was; infinite where it never is.
    range: f64,
    /// Whether the counts are angles, which wrap to one revolution or not at all.
    is_angle: bool,
}

impl Encoder {
    /// A counter.
    ///
    /// # Arguments
    /// * `counts_per_revolution`: of the wheel, not of the motor: all edges, with the gear.
    /// * `bits`: of the counter, which wraps around there.
    ///
    /// # Errors
    /// [`EncoderError`].
    pub fn new(counts_per_revolution: f64, bits: u32) -> Result<Self, EncoderError> {
        if !(counts_per_revolution.is_finite() && counts_per_revolution > 0.0) {
            return Err(EncoderError::Resolution(counts_per_revolution));
        }
        if !(8..=53).contains(&bits) {
            return Err(EncoderError::Bits(bits));
        }
        Ok(Self { counts_per_revolution, range: 2.0_f64.powi(bits as i32), is_angle: false })
    }

    /// Angles in rad, which may wrap around after a revolution.
    pub fn of_angles() -> Self {
        Self { counts_per_revolution: TAU, range: TAU, is_angle: true }
    }

    /// Counts of a revolution.
    pub fn counts_per_revolution(&self) -> f64 {
        self.counts_per_revolution
    }

    /// Standard deviation of the angle of a wheel, rad, by the steps of the counter; zero of angles.
    pub fn sigma_angle_rad(&self) -> f64 {
        if self.is_angle { 0.0 } else { TAU / self.counts_per_revolution / 12.0_f64.sqrt() }
    }

    /// Counts between two values of the counter.
    ///
    /// # Arguments
    /// * `expected`: what the wheel turned before, in the same time.
    fn difference(&self, from: f64, to: f64, expected: f64) -> f64 {
        let plain = to - from;
        if self.is_angle {
            // An angle that does not wrap may change by more than half of a revolution.
            let wrapped = [plain, plain - self.range, plain + self.range];
            let distance = |value: &f64| (value - expected).abs();
            return wrapped.into_iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(plain);
        }
        plain - self.range * (plain / self.range + HALF).floor()
    }
}

/// Turns the counters of the wheels into their speeds.
///
/// The speed between two readings is the mean one, and has the time in the middle of both: its integral is what the counter counted, so that its steps
/// do not add up.
///
/// ```
/// use types::{Encoder, EncoderCounts};
/// let mut counts = EncoderCounts::new(Encoder::new(1000.0, 16)?, 2);
/// assert!(counts.reading(0, &[65_530.0, 10.0]).is_none());
/// let reading = counts.reading(100_000_000, &[4.0, 0.0]).unwrap(); // wrapped around; backwards
/// assert_eq!(reading.stamp_ns, 50_000_000);
/// let per_count = std::f64::consts::TAU / 1000.0 / 0.1;
/// assert!((reading.values[0] - 10.0 * per_count).abs() < 1e-9);
/// assert!((reading.values[1] + 10.0 * per_count).abs() < 1e-9);
/// # Ok::<(), types::EncoderError>(())
/// ```
#[derive(Clone, Debug)]
pub struct EncoderCounts {
    encoder: Encoder,
    /// The first ones are counters, the others (a steering angle) are read as they are.
    counters: usize,
    before: Option<WheelReading>,
    /// Counts a second.
    speeds: [f64; MAX_WHEELS],
}

impl EncoderCounts {
    /// Nothing was read yet.
    ///
    /// # Arguments
    /// * `counters`: so many of the first numbers are counters.
    pub fn new(encoder: Encoder, counters: usize) -> Self {
        Self { encoder, counters: counters.min(MAX_WHEELS), before: None, speeds: [0.0; MAX_WHEELS] }
    }

    /// The speeds since the last values.
    ///
    /// # Returns
    /// `None` of the first values, of those that are not newer, and of those that are not finite.
    pub fn reading(&mut self, stamp_ns: i64, values: &[f64]) -> Option<WheelReading> {
        let now = WheelReading::of_slice(stamp_ns, values);
        if !now.is_finite() || self.before.is_some_and(|before| before.stamp_ns >= stamp_ns) {
            return None;
        }
        let before = self.before.replace(now)?;
        let seconds = (stamp_ns - before.stamp_ns) as f64 * 1e-9;
        let middle_ns = before.stamp_ns + (stamp_ns - before.stamp_ns) / 2;
        let mut middle = WheelReading::between(&before, &now, middle_ns);
        for wheel in 0..self.counters {
            let (from, to) = (before.values[wheel], now.values[wheel]);
            let turned = self.encoder.difference(from, to, self.speeds[wheel] * seconds);
            self.speeds[wheel] = turned / seconds;
            middle.values[wheel] = self.speeds[wheel] * TAU / self.encoder.counts_per_revolution;
        }
        Some(middle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wheel that speeds up, stops and turns back, as counters of any width and as angles see it.
    fn angle(seconds: f64) -> f64 {
        9.0 * seconds - 1.5 * seconds * seconds
    }

    fn worst(encoder: Encoder, count: impl Fn(f64) -> f64) -> f64 {
        let mut counts = EncoderCounts::new(encoder, 1);
        let (mut sum, mut worst, mut before) = (0.0, 0.0_f64, None);
        for k in 0..400_i32 {
            let seconds = f64::from(k) * 0.02;
            if let Some(reading) = counts.reading(i64::from(k) * 20_000_000, &[count(angle(seconds)), 0.3]) {
                assert!((reading.values[1] - 0.3).abs() < 1e-12, "an angle of the steering is no counter");
                sum += reading.values[0] * 0.02;
                worst = worst.max((sum - angle(seconds) + angle(before.unwrap())).abs());
            }
            before.get_or_insert(seconds);
        }
        worst
    }

    #[test]
    fn what_the_wheels_turned_is_what_the_counters_counted_however_often_they_wrap() {
        for (counts, bits) in [(4096.0, 53), (1024.0, 16), (96.0, 8)] {
            let range = 2.0_f64.powi(bits as i32);
            let count = |angle: f64| (angle / TAU * counts).floor().rem_euclid(range);
            let off = worst(Encoder::new(counts, bits).unwrap(), count);
            assert!(off <= TAU / counts * 1.0001, "{bits} bits: {off}");
        }
        let unwrapped = worst(Encoder::of_angles(), |angle| angle);
        let wrapped = worst(Encoder::of_angles(), |angle| (angle + 3.0).rem_euclid(TAU) - 3.0);
        assert!(unwrapped < 1e-9 && wrapped < 1e-9, "{unwrapped} {wrapped}");
    }

    #[test]
    fn fast_angles_that_do_not_wrap_are_not_wrapped() {
        let mut counts = EncoderCounts::new(Encoder::of_angles(), 1);
        let mut angle = 0.0;
        for k in 0..100_i32 {
            let speed = f64::from(k);
            angle += speed * 0.1;
            if let Some(reading) = counts.reading(i64::from(k) * 100_000_000, &[angle]) {
                assert!((reading.values[0] - speed).abs() < 1e-6, "{} {speed}", reading.values[0]);
            }
        }
    }

    #[test]
    fn values_that_are_none_give_no_speed() {
        let mut counts = EncoderCounts::new(Encoder::new(100.0, 16).unwrap(), 1);
        assert!(counts.reading(10, &[1.0]).is_none());
        assert!(counts.reading(10, &[2.0]).is_none() && counts.reading(20, &[f64::NAN]).is_none());
        assert!(counts.reading(30, &[2.0]).is_some());
        assert!(Encoder::new(0.0, 16).is_err() && Encoder::new(1.0, 64).is_err());
    }
}
