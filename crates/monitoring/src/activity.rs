//! What a connection did, for whoever must choose the one that gives way.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use tokio::time::Instant;

/// What a connection did.
#[derive(Debug)]
pub(crate) struct Activity {
    begin: Instant,
    /// Milliseconds from the begin to the last byte.
    last_ms: AtomicU64,
    was_answered: AtomicBool,
}

impl Activity {
    pub(crate) fn new() -> Self {
        Self { begin: Instant::now(), last_ms: AtomicU64::new(0), was_answered: AtomicBool::new(false) }
    }

    /// Bytes came or went.
    pub(crate) fn note(&self, now: Instant) {
        let elapsed = now.saturating_duration_since(self.begin).as_millis();
        self.last_ms.store(u64::try_from(elapsed).unwrap_or(u64::MAX), Ordering::Relaxed);
    }

    /// A request was answered.
    pub(crate) fn note_answer(&self) {
        self.was_answered.store(true, Ordering::Relaxed);
    }

    /// Whether a request was answered.
    pub(crate) fn was_answered(&self) -> bool {
        self.was_answered.load(Ordering::Relaxed)
    }

    /// When the last byte came or went.
    pub(crate) fn last(&self) -> Instant {
        self.begin + std::time::Duration::from_millis(self.last_ms.load(Ordering::Relaxed))
    }
}
