//! Changes of the state in the log of a robot, and one line a minute.

use super::status_word::status_word;
use estimator::Status;
use robot::counts::QuerySummary;
use robot::{Output, RunReport, StatusReport};
use std::time::{Duration, Instant};

/// Time between two lines.
const PERIOD: Duration = Duration::from_mins(1);

/// When the last line was written, and what it said.
#[derive(Debug)]
pub struct StatusLine {
    last: Instant,
    state: Option<&'static str>,
}

impl Default for StatusLine {
    /// The first line comes with the first status.
    fn default() -> Self {
        Self { last: Instant::now(), state: None }
    }
}

impl StatusLine {
    /// Writes the line if it is due.
    fn log(&mut self, status: &Status, frames: usize, queries: &QuerySummary) {
        let is_new = self.state != Some(status_word(status));
        if !is_new && self.last.elapsed() < PERIOD {
            return;
        }
        (self.last, self.state) = (Instant::now(), Some(status_word(status)));
        tracing::info!(
            state = status_word(status),
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

impl Output for StatusLine {
    fn status(&mut self, report: &StatusReport) {
        self.log(&report.status, report.frames, &report.queries);
    }

    fn end(&mut self, report: &RunReport) {
        if let Some(status) = &report.final_status {
            self.log(status, report.frames, &report.queries);
        }
    }
}
