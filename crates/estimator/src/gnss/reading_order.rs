//! The order of readings by their time stamps, where one may be wrong.
//!
//! Readings come in order, and what is not newer than the one before it is refused. A single stamp from the future would have all that
//! follow it refused: once several of these are in order among themselves, it was that one.

use super::BadGnssReading;

/// Refused readings in a row, each newer than the one before, after which the clock has gone back.
const ACCEPTED_AFTER: usize = 5;
/// What is late by less is late, nanoseconds: a burst of readings behind one that overtook them.
const LEAST_STEP_NS: i64 = 2_000_000_000;

/// See the module's documentation.
#[derive(Clone, Debug, Default)]
pub(crate) struct ReadingOrder {
    newest_ns: Option<i64>,
    /// The newest of the refused readings that are in order, and how many.
    refused: Option<(i64, usize)>,
    went_back: bool,
}

impl ReadingOrder {
    /// Checks the stamp of the next reading, nanoseconds.
    ///
    /// # Errors
    /// [`BadGnssReading::NotNewer`]: the reading is to be left out.
    pub(crate) fn check(&mut self, stamp_ns: i64) -> Result<(), BadGnssReading> {
        self.went_back = false;
        if let Some(previous_ns) = self.newest_ns.filter(|previous_ns| *previous_ns >= stamp_ns) {
            let in_order = match self.refused {
                Some((refused_ns, count)) if stamp_ns > refused_ns => count + 1,
                _ => 1,
            };
            if in_order <= ACCEPTED_AFTER || previous_ns.saturating_sub(stamp_ns) < LEAST_STEP_NS {
                self.refused = Some((stamp_ns, in_order));
                return Err(BadGnssReading::NotNewer { stamp_ns, previous_ns });
            }
            self.went_back = true;
        }
        (self.newest_ns, self.refused) = (Some(stamp_ns), None);
        Ok(())
    }

    /// Whether the reading that was checked last is older than one before it, which had a wrong stamp.
    pub(crate) fn went_back(&self) -> bool {
        self.went_back
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn accepted(stamps: &[i64]) -> Vec<bool> {
        let mut order = ReadingOrder::default();
        stamps.iter().map(|stamp_ns| order.check(*stamp_ns).is_ok()).collect()
    }

    #[test]
    fn a_stamp_from_the_future_costs_some_readings_and_not_all() {
        let mut stamps = vec![1, 2, 3_000_000_000];
        stamps.extend(3..20);
        let accepted = accepted(&stamps);
        assert!(accepted[..3].iter().all(|accepted| *accepted));
        assert!(!accepted[3..8].iter().any(|accepted| *accepted));
        assert!(accepted[8..].iter().all(|accepted| *accepted));
    }

    #[test]
    fn what_comes_twice_or_late_is_left_out() {
        assert_eq!(accepted(&[1, 2, 2, 2, 2, 2, 2, 2, 2, 3]).iter().filter(|accepted| **accepted).count(), 3);
        assert_eq!(accepted(&[10, 20, 15, 25, 21, 30, 28]), [true, true, false, true, false, true, false]);
        // One that overtook seven others.
        let overtaken: Vec<i64> =
            std::iter::once(800_000_000).chain((1..8).map(|k| k * 100_000_000)).collect();
        assert_eq!(accepted(&overtaken).iter().filter(|accepted| **accepted).count(), 1);
    }
}
