//! Changes of the state in the log of a robot, and one line a minute.

use super::summary::QuerySummary;
use estimator::{Localization, Status};
use std::time::{Duration, Instant};

/// Time between two lines.
const PERIOD: Duration = Duration::from_mins(1);

/// When the last line was written, and what it said.
#[derive(Debug)]
pub struct StatusLine {
    last: Instant,
    localization: Option<Localization>,
}

impl Default for StatusLine {
    /// The first line comes with the first status.
    fn default() -> Self {
        Self { last: Instant::now(), localization: None }
    }
}

impl StatusLine {
    /// Writes the line if it is due.
    pub fn log(&mut self, status: &Status, frames: usize, queries: &QuerySummary) {
        let is_new = self.localization != Some(status.localization);
        if !is_new && self.last.elapsed() < PERIOD {
            return;
        }
        (self.last, self.localization) = (Instant::now(), Some(status.localization));
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
