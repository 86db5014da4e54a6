//! One line a minute in the log of a robot that runs in real time.

use super::summary::QuerySummary;
use estimator::Status;
use std::time::{Duration, Instant};

/// Time between two lines.
const PERIOD: Duration = Duration::from_mins(1);

/// When the last line was written.
#[derive(Debug)]
pub struct StatusLine {
    last: Instant,
}

impl Default for StatusLine {
    /// The first line comes after a minute.
    fn default() -> Self {
        Self { last: Instant::now() }
    }
}

impl StatusLine {
    /// Writes the line if it is due.
    pub fn log(&mut self, status: &Status, frames: usize, queries: &QuerySummary) {
        if self.last.elapsed() < PERIOD {
            return;
        }
        self.last = Instant::now();
        tracing::info!(
            state = ?status.localization,
            reason = status.reason,
            frames,
            queries = queries.sent,
            answered = queries.answered,
            accepted = queries.accepted,
            held_keyframes = status.held_keyframes,
            "status"
        );
    }
}
