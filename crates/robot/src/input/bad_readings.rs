//! IMU readings that were left out, and whether that is going on.

use estimator::BadImuSample;

/// So long after the last one they are no alarm any more, nanoseconds.
const GOES_ON_NS: i64 = 5_000_000_000;
/// Readings that are logged one by one.
const MOST_WARNINGS: usize = 20;

/// The readings of a run that were left out.
#[derive(Debug, Default)]
pub(crate) struct BadReadings {
    count: usize,
    /// Those since it began to go on.
    recent: usize,
    last: Option<(i64, BadImuSample)>,
    newest_ns: i64,
}

impl BadReadings {
    /// Takes in what became of a reading.
    pub(crate) fn note(&mut self, stamp_ns: i64, checked: Result<(), BadImuSample>) {
        self.newest_ns = self.newest_ns.max(stamp_ns);
        let Err(bad) = checked else { return };
        self.recent = if self.goes_on() { self.recent + 1 } else { 1 };
        // Not its own stamp, which may be what is wrong.
        self.last = Some((self.newest_ns, bad));
        self.count += 1;
        if self.count <= MOST_WARNINGS {
            tracing::warn!(%bad, "bad IMU reading");
        }
        if self.count == MOST_WARNINGS {
            tracing::warn!("further bad IMU readings are only counted");
        }
    }

    /// Number of readings that were left out.
    pub(crate) fn count(&self) -> usize {
        self.count
    }

    fn goes_on(&self) -> bool {
        self.last.is_some_and(|(last_ns, _)| self.newest_ns - last_ns <= GOES_ON_NS)
    }

    /// What is wrong with the readings of now.
    pub(crate) fn fault(&self) -> Option<String> {
        let (_, bad) = self.last.filter(|_| self.goes_on())?;
        let readings = if self.recent == 1 { "reading" } else { "readings" };
        Some(format!("bad readings of the IMU: {} {readings} left out, the last: {bad}", self.recent))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_readings_are_a_fault_until_there_were_none_for_seconds() {
        let mut readings = BadReadings::default();
        let bad = |stamp_ns| BadImuSample::NotFinite { stamp_ns };
        readings.note(0, Ok(()));
        assert_eq!(readings.fault(), None);
        readings.note(1_000_000, Err(bad(1_000_000)));
        readings.note(2_000_000, Err(bad(2_000_000)));
        assert!(readings.fault().unwrap().contains("2 readings"));
        readings.note(4_000_000_000, Ok(()));
        assert!(readings.fault().is_some());
        readings.note(6_000_000_000, Ok(()));
        assert_eq!((readings.fault(), readings.count()), (None, 2));
        readings.note(7_000_000_000, Err(bad(7_000_000_000)));
        assert!(readings.fault().unwrap().contains("1 reading left out"));
    }
}
