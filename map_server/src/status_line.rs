//! One line a minute in the log: how many queries, how long they took.

use std::time::Duration;

use map_server::{MapServer, ServerStatistics};
use tokio::time::{Interval, MissedTickBehavior, interval_at};

/// Time between two lines.
const PERIOD: Duration = Duration::from_mins(1);

/// Logs what happened since its last line.
pub struct StatusLine {
    interval: Interval,
    last: ServerStatistics,
}

impl StatusLine {
    /// The first line comes after a minute.
    pub fn new() -> Self {
        let mut interval = interval_at(tokio::time::Instant::now() + PERIOD, PERIOD);
        interval.set_missed_tick_behavior(MissedTickBehavior::Delay);
        Self { interval, last: ServerStatistics::default() }
    }

    /// Waits until the next line is due. May be cancelled.
    pub async fn is_due(&mut self) {
        self.interval.tick().await;
    }

    /// Logs the line.
    pub fn log(&mut self, server: &MapServer) {
        let now = server.statistics();
        let (answered, failed) = (now.answered - self.last.answered, now.failed - self.last.failed);
        let answer_time = now.answer_time.saturating_sub(self.last.answer_time);
        let mean_ms = answer_time.as_secs_f64() * 1e3 / (answered + failed).max(1) as f64;
        tracing::info!(
            answered,
            failed,
            refused = now.refused - self.last.refused,
            mean_ms = format!("{mean_ms:.1}"),
            "the last minute"
        );
        if now.cells > 0 {
            let cold_loads = now.cold_loads - self.last.cold_loads;
            let load_time = now.cold_load_time.saturating_sub(self.last.cold_load_time);
            let mean_ms = load_time.as_secs_f64() * 1e3 / cold_loads.max(1) as f64;
            tracing::info!(
                cells = now.cells,
                in_memory = now.cells_in_memory,
                megabytes = now.cell_bytes >> 20,
                cold_loads,
                cold_loads_failed = now.cold_loads_failed - self.last.cold_loads_failed,
                cold_load_mean_ms = format!("{mean_ms:.1}"),
                "cells"
            );
        }
        self.last = now;
    }
}
