//! How many bytes a session may take.

/// Seconds whose bytes may be taken at once.
const SAVED_SECONDS: f64 = 20.0;

/// Bytes that come with time and are taken by what is recorded.
#[derive(Debug)]
pub(super) struct Budget {
    bytes_per_second: f64,
    saved: f64,
    last_ns: Option<i64>,
}

impl Budget {
    pub(super) fn new(bytes_per_minute: f64) -> Self {
        Self { bytes_per_second: bytes_per_minute / 60.0, saved: 0.0, last_ns: None }
    }

    /// Time goes on.
    pub(super) fn advance(&mut self, now_ns: i64) {
        let last_ns = self.last_ns.replace(now_ns).unwrap_or(now_ns);
        let seconds = ((now_ns - last_ns) as f64 * 1e-9).max(0.0);
        let most = self.bytes_per_second * SAVED_SECONDS;
        self.saved = (self.saved + seconds * self.bytes_per_second).min(most);
    }

    /// The clock was set by so many nanoseconds.
    pub(super) fn shift_clock(&mut self, by_ns: i64) {
        self.last_ns = self.last_ns.map(|last_ns| last_ns.saturating_add(by_ns));
    }

    /// Takes what must be taken.
    pub(super) fn take(&mut self, bytes: f64) {
        self.saved -= bytes;
    }

    /// Takes what may be left out.
    ///
    /// # Arguments
    /// * `left`: bytes that must be left for others.
    ///
    /// # Returns
    /// Whether there was enough.
    pub(super) fn try_take(&mut self, bytes: f64, left: f64) -> bool {
        let is_enough = self.saved >= bytes + left;
        if is_enough {
            self.saved -= bytes;
        }
        is_enough
    }
}
