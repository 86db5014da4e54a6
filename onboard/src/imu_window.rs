//! The newest IMU readings of a recording: those that are still needed, and no more.

use super::summary::ImuGapSummary;
use estimator::ImuSample;
use sensors::{Rows, SequenceError};

/// Readings are kept so long at most, nanoseconds. Only a filter that could not be believed for this long, and is then
/// given up, would look further back; the turns before are left out of its yaw.
const LONGEST_NS: i64 = 60_000_000_000;
/// Readings further apart than so many periods of the sensor have a gap between them: a packet was lost.
const GAP_PERIODS: f64 = 5.0;
/// Gaps that are warned about one by one; a sensor that is slower than it says would fill the log.
const MOST_WARNINGS: usize = 20;

/// A window on the readings of a recording.
pub struct ImuWindow<'a> {
    rows: Rows<'a, ImuSample>,
    readings: Vec<ImuSample>,
    /// How many of them were handed out.
    handed_out: usize,
    /// Distance between two readings that is a gap, nanoseconds.
    gap_ns: i64,
    gaps: ImuGapSummary,
}

impl<'a> ImuWindow<'a> {
    /// A window on rows in order of time.
    ///
    /// # Arguments
    /// * `rate_hz`: readings a second.
    pub fn new(rows: Rows<'a, ImuSample>, rate_hz: f64) -> Self {
        let gap_ns = (GAP_PERIODS * 1e9 / rate_hz) as i64;
        Self { rows, readings: Vec::new(), handed_out: 0, gap_ns, gaps: ImuGapSummary::default() }
    }

    /// Reads up to the first reading that is not before `stamp_ns`, if there is one.
    ///
    /// # Errors
    /// Those of the rows.
    pub fn read_to(&mut self, stamp_ns: i64) -> Result<(), SequenceError> {
        while self.readings.last().is_none_or(|last| last.stamp_ns < stamp_ns) {
            let Some(reading) = self.rows.next().transpose()? else { break };
            self.readings.push(reading);
        }
        Ok(())
    }

    /// What was read and is still kept.
    pub fn readings(&self) -> &[ImuSample] {
        &self.readings
    }

    /// Those of them that were handed out.
    pub fn handed_out(&self) -> &[ImuSample] {
        &self.readings[..self.handed_out]
    }

    /// The next reading, up to the first one that is not before `stamp_ns`. A gap before it is warned about.
    pub fn hand_out(&mut self, stamp_ns: i64) -> Option<ImuSample> {
        let before = self.handed_out().last().copied();
        if before.is_some_and(|before| before.stamp_ns >= stamp_ns) {
            return None;
        }
        let reading = *self.readings.get(self.handed_out)?;
        self.handed_out += 1;
        if let Some(before) = before {
            self.look_for_gap(before.stamp_ns, reading.stamp_ns);
        }
        Some(reading)
    }

    fn look_for_gap(&mut self, from_ns: i64, to_ns: i64) {
        if to_ns - from_ns <= self.gap_ns {
            return;
        }
        let seconds = (to_ns - from_ns) as f64 * 1e-9;
        self.gaps.count += 1;
        self.gaps.longest_s = self.gaps.longest_s.max(seconds);
        if self.gaps.count <= MOST_WARNINGS {
            tracing::warn!(
                from_ns,
                seconds,
                "a gap in the IMU's readings: the motion in between is interpolated"
            );
        }
        if self.gaps.count == MOST_WARNINGS {
            tracing::warn!(
                "further gaps in the IMU's readings are only counted; does sensor.yaml say the right rate_hz?"
            );
        }
    }

    /// The gaps between the readings that were handed out.
    pub fn gaps(&self) -> ImuGapSummary {
        self.gaps
    }

    /// Forgets readings that lie before the last one at or before `stamp_ns`, unless they are still to be handed out.
    pub fn forget_before(&mut self, stamp_ns: i64) {
        let newest_ns = self.readings.last().map_or(stamp_ns, |last| last.stamp_ns);
        let from_ns = stamp_ns.max(newest_ns - LONGEST_NS);
        let needed = self.readings.partition_point(|reading| reading.stamp_ns <= from_ns).saturating_sub(1);
        let old = needed.min(self.handed_out.saturating_sub(1));
        // Moving the rest to the front is worth it only once in a while.
        if old > self.readings.len() / 2 {
            self.readings.drain(..old);
            self.handed_out -= old;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    const PERIOD_NS: i64 = 5_000_000;

    fn window(stamps: impl Iterator<Item = i64> + 'static) -> ImuWindow<'static> {
        let reading =
            |stamp_ns| ImuSample { stamp_ns, gyroscope: Vector3::zeros(), accelerometer: Vector3::zeros() };
        ImuWindow::new(Box::new(stamps.map(move |stamp_ns| Ok(reading(stamp_ns)))), 200.0)
    }

    #[test]
    fn every_reading_is_handed_out_once_and_few_are_kept() {
        let mut window = window((0..200_000).map(|k| k * PERIOD_NS));
        let mut handed_out = Vec::new();
        for frame in 1..10_000 {
            let stamp_ns = frame * 100_000_000 - 1;
            window.read_to(stamp_ns).unwrap();
            handed_out
                .extend(std::iter::from_fn(|| window.hand_out(stamp_ns)).map(|reading| reading.stamp_ns));
            assert_eq!(
                handed_out.last(),
                Some(&(stamp_ns + 1)),
                "the first reading behind the frame is the last"
            );
            window.forget_before(stamp_ns - 200_000_000);
            assert!(window.readings().len() < 200);
            assert!(window.readings()[0].stamp_ns <= (stamp_ns - 200_000_000).max(0));
        }
        assert!(handed_out.iter().enumerate().all(|(k, stamp_ns)| *stamp_ns == k as i64 * PERIOD_NS));
        assert_eq!(window.gaps().count, 0);
    }

    #[test]
    fn what_is_needed_forever_is_forgotten_after_a_minute() {
        let mut window = window((0..60_000).map(|k| k * PERIOD_NS));
        window.read_to(i64::MAX).unwrap();
        while window.hand_out(i64::MAX).is_some() {}
        window.forget_before(0);
        let kept_ns = window.readings().last().unwrap().stamp_ns - window.readings()[0].stamp_ns;
        assert!((LONGEST_NS..LONGEST_NS + 2 * PERIOD_NS).contains(&kept_ns));
    }

    #[test]
    fn gaps_are_counted_and_jitter_is_not() {
        let mut window = window((0..4000_i64).filter(|k| !(1000..1100).contains(k) && *k != 3000).map(|k| {
            // Two readings in three are late.
            k * PERIOD_NS + (k % 3) * PERIOD_NS / 4
        }));
        window.read_to(i64::MAX).unwrap();
        while window.hand_out(i64::MAX).is_some() {}
        assert_eq!(window.gaps().count, 1);
        assert!((window.gaps().longest_s - 0.505).abs() < 0.01);
    }
}
