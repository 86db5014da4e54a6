//! The newest IMU readings: those that are still needed, and no more.

use crate::counts::ImuGapSummary;
use estimator::{BadImuSample, ImuSample, ReadingCheck};

/// Readings are kept so long at most, nanoseconds. Only a filter that diverges after it was not trusted for this long
/// would need older ones; the rotation before is then missing from the yaw of its successor.
const LONGEST_NS: i64 = 60_000_000_000;
/// At most so many readings are read ahead while the next frame is searched: 20 minutes at 200 Hz, 15 MB. Where no frame comes
/// for longer (the images ended, and the IMU did not), the oldest ones are dropped.
pub(crate) const MAX_AHEAD: usize = 1 << 18;
/// Readings further apart than so many periods of the sensor have a gap between them: a packet was lost.
const GAP_PERIODS: f64 = 5.0;
/// Gaps that are logged one by one; a sensor that is slower than its calibration states would fill the log.
const MOST_WARNINGS: usize = 20;

/// A reading, and why it cannot be used where it was left out.
pub(crate) type Checked = (ImuSample, Result<(), BadImuSample>);

/// The one buffer of IMU readings between the source and the estimator. From its front to its back: readings that were
/// handed out, readings that were accepted, readings that were read ahead.
pub(crate) struct ImuWindow {
    check: ReadingCheck,
    readings: Vec<ImuSample>,
    /// How many were handed out.
    handed_out: usize,
    /// How many were accepted, those that were handed out included.
    accepted: usize,
    /// Index of the first reading that was read ahead. Those between it and the accepted ones are left out.
    ahead: usize,
    /// Distance between two readings that is a gap, nanoseconds.
    gap_ns: i64,
    gaps: ImuGapSummary,
}

impl ImuWindow {
    /// An empty window.
    ///
    /// # Arguments
    /// * `rate_hz`: readings a second, by the calibration of the sensor.
    pub(crate) fn new(rate_hz: f64) -> Self {
        let gap_ns = (GAP_PERIODS * 1e9 / rate_hz) as i64;
        Self {
            check: ReadingCheck::default(),
            readings: Vec::new(),
            handed_out: 0,
            accepted: 0,
            ahead: 0,
            gap_ns,
            gaps: ImuGapSummary::default(),
        }
    }

    /// Appends a reading that the source gave. Where too many were read ahead, the oldest of them is dropped.
    pub(crate) fn read_ahead(&mut self, reading: ImuSample) {
        if self.ahead().len() == MAX_AHEAD {
            self.leave_out();
        }
        self.readings.push(reading);
    }

    /// The readings that were read ahead.
    pub(crate) fn ahead(&self) -> &[ImuSample] {
        &self.readings[self.ahead..]
    }

    /// Accepts the oldest reading that was read ahead, or leaves it out.
    ///
    /// # Returns
    /// `None` where none was read ahead.
    pub(crate) fn accept(&mut self) -> Option<Checked> {
        let reading = *self.readings.get(self.ahead)?;
        let checked = self.check.check(&reading);
        if checked.is_ok() {
            self.readings[self.accepted] = reading;
            self.accepted += 1;
            self.ahead += 1;
        } else {
            self.leave_out();
        }
        Some((reading, checked))
    }

    /// Leaves out the oldest reading that was read ahead. Closing the hole is done only once in a while where it costs time.
    fn leave_out(&mut self) {
        self.ahead += 1;
        let hole = self.ahead - self.accepted;
        if self.ahead().is_empty() || hole > self.readings.len() / 2 {
            self.readings.drain(self.accepted..self.ahead);
            self.ahead = self.accepted;
        }
    }

    /// Whether the newest accepted reading is before `stamp_ns`: the motion up to there is not known yet.
    pub(crate) fn ends_before(&self, stamp_ns: i64) -> bool {
        self.accepted().last().is_none_or(|last| last.stamp_ns < stamp_ns)
    }

    /// All accepted readings that are kept.
    pub(crate) fn accepted(&self) -> &[ImuSample] {
        &self.readings[..self.accepted]
    }

    /// Those of them that were handed out.
    pub(crate) fn handed_out(&self) -> &[ImuSample] {
        &self.readings[..self.handed_out]
    }

    /// The next reading, up to the first one that is not before `stamp_ns`. A gap before it is counted and logged.
    pub(crate) fn hand_out(&mut self, stamp_ns: i64) -> Option<ImuSample> {
        let before = self.handed_out().last().copied();
        if before.is_some_and(|before| before.stamp_ns >= stamp_ns) {
            return None;
        }
        let reading = *self.accepted().get(self.handed_out)?;
        self.handed_out += 1;
        if let Some(before) = before {
            self.check_gap(before.stamp_ns, reading.stamp_ns);
        }
        Some(reading)
    }

    fn check_gap(&mut self, from_ns: i64, to_ns: i64) {
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
                "a gap in the IMU's readings: the motion in between is interpolated; check the sensor's connection"
            );
        }
        if self.gaps.count == MOST_WARNINGS {
            tracing::warn!(
                "further gaps in the IMU's readings are only counted; check rate_hz in the IMU's sensor.yaml"
            );
        }
    }

    /// The gaps between the readings that were handed out.
    pub(crate) fn gaps(&self) -> ImuGapSummary {
        self.gaps
    }

    /// Drops accepted readings before the last one at or before `stamp_ns`, unless they are still to be handed out.
    pub(crate) fn drop_before(&mut self, stamp_ns: i64) {
        let newest_ns = self.accepted().last().map_or(stamp_ns, |last| last.stamp_ns);
        let from_ns = stamp_ns.max(newest_ns - LONGEST_NS);
        let needed = self.accepted().partition_point(|reading| reading.stamp_ns <= from_ns).saturating_sub(1);
        let old = needed.min(self.handed_out.saturating_sub(1));
        // Moving the rest to the front is done only once in a while: it costs time.
        if old > self.accepted / 2 {
            self.readings.drain(..old);
            self.handed_out -= old;
            self.accepted -= old;
            self.ahead -= old;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    const PERIOD_NS: i64 = 5_000_000;

    fn reading(stamp_ns: i64) -> ImuSample {
        ImuSample { stamp_ns, gyroscope: Vector3::zeros(), accelerometer: Vector3::zeros() }
    }

    /// Reads a reading and accepts it.
    fn push(window: &mut ImuWindow, reading: ImuSample) -> Result<(), BadImuSample> {
        window.read_ahead(reading);
        window.accept().unwrap().1
    }

    /// A window that holds readings of all of these times.
    fn window(stamps: impl Iterator<Item = i64>) -> ImuWindow {
        let mut window = ImuWindow::new(200.0);
        stamps.for_each(|stamp_ns| push(&mut window, reading(stamp_ns)).unwrap());
        window
    }

    #[test]
    fn every_reading_is_handed_out_once_and_few_are_kept() {
        let mut window = ImuWindow::new(200.0);
        let mut stamps = (0..200_000).map(|k| k * PERIOD_NS);
        let mut handed_out = Vec::new();
        for frame in 1..10_000 {
            let stamp_ns = frame * 100_000_000 - 1;
            while window.ends_before(stamp_ns) {
                push(&mut window, reading(stamps.next().unwrap())).unwrap();
            }
            handed_out
                .extend(std::iter::from_fn(|| window.hand_out(stamp_ns)).map(|reading| reading.stamp_ns));
            assert_eq!(
                handed_out.last(),
                Some(&(stamp_ns + 1)),
                "the first reading behind the frame is the last"
            );
            window.drop_before(stamp_ns - 200_000_000);
            assert!(window.accepted().len() < 200);
            assert!(window.accepted()[0].stamp_ns <= (stamp_ns - 200_000_000).max(0));
        }
        assert!(handed_out.iter().enumerate().all(|(k, stamp_ns)| *stamp_ns == k as i64 * PERIOD_NS));
        assert_eq!(window.gaps().count, 0);
    }

    #[test]
    fn bad_readings_are_left_out_and_the_others_keep_their_order_however_far_is_read_ahead() {
        let is_bad = |k: i64| k % 3 == 1 || (500..700).contains(&k);
        let mut window = ImuWindow::new(200.0);
        let (mut read, mut accepted) = (0, Vec::new());
        for round in 0..100 {
            for _ in 0..(round * 7) % 31 {
                let mut next = reading(read * PERIOD_NS);
                if is_bad(read) {
                    next.gyroscope.x = f64::NAN;
                }
                window.read_ahead(next);
                read += 1;
            }
            for _ in 0..(round * 5) % 29 {
                let Some((taken, checked)) = window.accept() else { break };
                assert_eq!(checked.is_err(), is_bad(taken.stamp_ns / PERIOD_NS));
                accepted.extend(checked.is_ok().then_some(taken.stamp_ns));
            }
            let kept: Vec<i64> = window.accepted().iter().map(|reading| reading.stamp_ns).collect();
            assert!(accepted.ends_with(&kept), "{kept:?} of {accepted:?}");
            while window.hand_out(i64::MAX).is_some() {}
            window.drop_before(accepted.last().map_or(0, |last_ns| last_ns - 20 * PERIOD_NS));
            assert!(window.readings.len() <= 200 + 2 * window.ahead().len(), "{}", window.readings.len());
        }
        assert!(accepted.len() > 500);
    }

    #[test]
    fn readings_are_dropped_after_a_minute_even_where_they_are_still_needed() {
        let mut window = window((0..60_000).map(|k| k * PERIOD_NS));
        while window.hand_out(i64::MAX).is_some() {}
        window.drop_before(0);
        let kept_ns = window.accepted().last().unwrap().stamp_ns - window.accepted()[0].stamp_ns;
        assert!((LONGEST_NS..LONGEST_NS + 2 * PERIOD_NS).contains(&kept_ns));
    }

    #[test]
    fn gaps_are_counted_and_jitter_is_not() {
        let mut window = window((0..4000_i64).filter(|k| !(1000..1100).contains(k) && *k != 3000).map(|k| {
            // Two readings in three come late.
            k * PERIOD_NS + (k % 3) * PERIOD_NS / 4
        }));
        while window.hand_out(i64::MAX).is_some() {}
        assert_eq!(window.gaps().count, 1);
        assert!((window.gaps().longest_s - 0.505).abs() < 0.01);
    }
}
