//! How busy the server is, sampled for the page.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::time::{MissedTickBehavior, interval_at};
use viewer::{STATISTICS_PERIOD, ServerSample, Viewer};

use crate::metrics::{ServerMetrics, ServerStatistics};

/// Gives the page a sample of the server's metrics every [`STATISTICS_PERIOD`], until it is cancelled.
pub(crate) async fn show_statistics(viewer: Arc<Viewer>, metrics: Arc<ServerMetrics>) {
    let mut ticks = interval_at(tokio::time::Instant::now() + STATISTICS_PERIOD, STATISTICS_PERIOD);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (mut last, mut since) = (metrics.statistics(), Instant::now());
    loop {
        ticks.tick().await;
        let now = metrics.statistics();
        viewer.note_statistics(sample(&last, &now, since.elapsed()));
        (last, since) = (now, Instant::now());
    }
}

/// What a server did between two moments.
fn sample(earlier: &ServerStatistics, later: &ServerStatistics, elapsed: Duration) -> ServerSample {
    let per_s =
        |count: u64, before: u64| count.saturating_sub(before) as f64 / elapsed.as_secs_f64().max(1e-3);
    let durations = later.durations.since(&earlier.durations);
    let quantile_ms = |probability| Some(durations.quantile(probability)?.as_secs_f64() * 1e3);
    ServerSample {
        answered_per_s: per_s(later.answered, earlier.answered),
        failed_per_s: per_s(later.failed, earlier.failed),
        refused_per_s: per_s(later.refused, earlier.refused),
        waiting: later.waiting,
        p50_ms: quantile_ms(0.5),
        p99_ms: quantile_ms(0.99),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kind::Kind;

    #[test]
    fn a_sample_has_what_happened_in_its_period_only() {
        let metrics = ServerMetrics::default();
        let note = |ms, is_answered| {
            metrics.note_received();
            metrics.note_done("hall", Kind::Match.name(), Duration::from_millis(ms), is_answered);
        };
        note(4000, true);
        let earlier = metrics.statistics();
        (0..20).for_each(|_| note(10, true));
        note(10, false);
        metrics.note_received();
        metrics.note_refused();
        metrics.note_received();
        let sample = sample(&earlier, &metrics.statistics(), Duration::from_secs(10));
        assert_eq!((sample.answered_per_s, sample.failed_per_s, sample.refused_per_s), (2.0, 0.1, 0.1));
        assert_eq!(sample.waiting, 1);
        let p99_ms = sample.p99_ms.unwrap();
        assert!((7.0..15.0).contains(&p99_ms) && sample.p50_ms.unwrap() <= p99_ms, "{sample:?}");
    }
}
