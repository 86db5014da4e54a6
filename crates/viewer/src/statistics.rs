//! How busy the map server was over the last hour.

use serde::Serialize;
use std::collections::VecDeque;
use std::time::Duration;

/// Time that one sample stands for.
pub const STATISTICS_PERIOD: Duration = Duration::from_secs(5);
/// Samples that are kept: those of an hour.
const MAX_SAMPLES: usize = 720;

/// What a map server did in one period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ServerSample {
    /// Queries answered per second, "no match" included.
    pub answered_per_s: f64,
    /// Queries answered with an error per second.
    pub failed_per_s: f64,
    /// Queries refused per second because too many were waiting.
    pub refused_per_s: f64,
    /// Queries waiting at the end of the period.
    pub waiting: u64,
    /// Median of the time from the receipt of a query to its last reply, milliseconds; `None` without queries.
    pub p50_ms: Option<f64>,
    /// The time that 99 % of the queries do not exceed, milliseconds.
    pub p99_ms: Option<f64>,
}

/// A sample and when its period ended, milliseconds.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct TimedSample {
    t_ms: u64,
    #[serde(flatten)]
    sample: ServerSample,
}

/// The samples of the last hour.
#[derive(Debug, Default)]
pub(crate) struct StatisticsLog(VecDeque<TimedSample>);

impl StatisticsLog {
    pub(crate) fn add(&mut self, t_ms: u64, sample: ServerSample) {
        if self.0.len() == MAX_SAMPLES {
            self.0.pop_front();
        }
        self.0.push_back(TimedSample { t_ms, sample });
    }

    /// All of them, with times since 1970.
    ///
    /// # Arguments
    /// * `started_ms`: the start of the server.
    pub(crate) fn since_1970(&self, started_ms: u64) -> Vec<TimedSample> {
        let dated = |of: &TimedSample| TimedSample { t_ms: of.t_ms + started_ms, ..*of };
        self.0.iter().map(dated).collect()
    }
}
