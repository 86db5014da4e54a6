//! The server's time.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// The clock of the system was set where it differs by more than this, milliseconds; below, times that were given stay as they are.
const SET_MS: u64 = 1000;

/// Orders what happens by a clock that is never set, and tells times by the system's, also where that was set after the start.
#[derive(Debug)]
pub(crate) struct Clock {
    started: Instant,
    /// When it was started, milliseconds since 1970 by the system's clock as it is now.
    started_ms: AtomicU64,
}

impl Default for Clock {
    fn default() -> Self {
        Self { started: Instant::now(), started_ms: AtomicU64::new(system_ms()) }
    }
}

impl Clock {
    /// Milliseconds since the start; never runs backwards.
    pub(crate) fn steady_ms(&self) -> u64 {
        self.started.elapsed().as_millis() as u64
    }

    /// Milliseconds since 1970.
    pub(crate) fn now_ms(&self) -> u64 {
        self.started_ms() + self.steady_ms()
    }

    /// When it was started, milliseconds since 1970 by the system's clock: what is added to times since the start.
    pub(crate) fn started_ms(&self) -> u64 {
        self.started_ms_by(system_ms(), self.steady_ms())
    }

    fn started_ms_by(&self, system_ms: u64, steady_ms: u64) -> u64 {
        let (known, found) = (self.started_ms.load(Ordering::Relaxed), system_ms.saturating_sub(steady_ms));
        if found.abs_diff(known) <= SET_MS {
            return known;
        }
        self.started_ms.store(found, Ordering::Relaxed);
        found
    }
}

/// A clock before 1970 gives 0.
fn system_ms() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_millis() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_follow_the_clock_of_the_system_where_it_is_set_and_stay_where_it_only_drifts() {
        let clock = Clock { started: Instant::now(), started_ms: AtomicU64::new(5000) };
        assert_eq!(clock.started_ms_by(5000 + 20_000 + 900, 20_000), 5000, "it drifts");
        assert_eq!(clock.started_ms_by(1_700_000_000_000, 30_000), 1_699_999_970_000, "it is set");
        assert_eq!(clock.started_ms_by(1_700_000_001_000, 31_000), 1_699_999_970_000);
        assert_eq!(clock.started_ms_by(6000, 40_000), 0, "it is before the start");
    }
}
