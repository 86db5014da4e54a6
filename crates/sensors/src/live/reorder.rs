//! Sorts messages that arrive out of order, without holding back those that arrive in order.
//!
//! A message that follows the last one at the usual distance is handed on at once. Behind a gap it waits for what may
//! be missing. Where messages are lost and not late, waiting is of no use: the wait becomes shorter with each gap that stays.

use crate::pairing;
use std::collections::BTreeMap;
use std::time::Duration;

/// Longest wait for a message that may be late.
pub(super) const LONGEST_WAIT: Duration = Duration::from_millis(200);
/// Shortest wait.
const SHORTEST_WAIT: Duration = Duration::from_millis(10);
/// More messages do not wait, whatever is missing.
const MAX_WAITING: usize = 512;
/// A message is missing where two are further apart than so many periods.
const GAP_PERIODS: f64 = 1.5;

/// Messages that wait for those before them.
#[derive(Debug)]
pub(super) struct Reorder<T> {
    waiting: BTreeMap<i64, (Duration, T)>,
    released_ns: Option<i64>,
    wait: Duration,
}

impl<T> Reorder<T> {
    pub(super) fn new() -> Self {
        Self { waiting: BTreeMap::new(), released_ns: None, wait: LONGEST_WAIT }
    }

    /// Takes a message in; `false` where one at or after its time was handed on already.
    pub(super) fn push(&mut self, stamp_ns: i64, arrival: Duration, item: T) -> bool {
        let newest = self.waiting.last_key_value().map(|(newest_ns, _)| *newest_ns).or(self.released_ns);
        if newest.is_some_and(|newest_ns| stamp_ns < newest_ns) {
            self.wait = LONGEST_WAIT;
        }
        if self.released_ns.is_some_and(|released_ns| stamp_ns <= released_ns) {
            return false;
        }
        self.waiting.insert(stamp_ns, (arrival, item));
        true
    }

    /// The stamp of the waiting message that is nearest within `tolerance_ns`, of those that fit.
    pub(super) fn nearest(&self, stamp_ns: i64, tolerance_ns: i64, fits: impl Fn(&T) -> bool) -> Option<i64> {
        let range = stamp_ns.saturating_sub(tolerance_ns)..=stamp_ns.saturating_add(tolerance_ns);
        let waiting = self.waiting.range(range).filter(|(_, (_, item))| fits(item));
        pairing::nearest(stamp_ns, waiting.map(|(at_ns, _)| *at_ns), tolerance_ns)
    }

    /// Takes a waiting message out, with its arrival.
    pub(super) fn remove(&mut self, stamp_ns: i64) -> Option<(Duration, T)> {
        self.waiting.remove(&stamp_ns)
    }

    /// The next message in order, if it need not wait any longer.
    ///
    /// # Arguments
    /// * `period_ns`: usual distance of two messages; without one every message is in order.
    /// * `is_complete`: whether nothing is missing from the message itself, by its stamp.
    pub(super) fn pop(
        &mut self,
        now: Duration,
        period_ns: Option<i64>,
        is_complete: impl FnOnce(i64, &T) -> bool,
    ) -> Option<(i64, T)> {
        let (&stamp_ns, (arrival, item)) = self.waiting.first_key_value()?;
        let waited = now.saturating_sub(*arrival);
        // What comes first at all may have been overtaken, too.
        let follows = self.released_ns.is_some_and(|released_ns| {
            let follows = |period_ns| stamp_ns - released_ns <= (GAP_PERIODS * period_ns as f64) as i64;
            period_ns.is_none_or(follows)
        });
        let wait = if follows { LONGEST_WAIT } else { self.wait };
        let is_over = waited >= wait || self.waiting.len() > MAX_WAITING;
        let is_ready = follows && is_complete(stamp_ns, item);
        if !is_over && !is_ready {
            return None;
        }
        if !follows && self.released_ns.is_some() {
            self.wait = (self.wait / 2).max(SHORTEST_WAIT);
        }
        self.released_ns = Some(stamp_ns);
        self.waiting.pop_first().map(|(_, (_, item))| (stamp_ns, item))
    }
}
