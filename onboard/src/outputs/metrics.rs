//! Metrics and health of a robot, for Prometheus and for whatever restarts programs.

use estimator::{Localization, Status};
use monitoring::Health;
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeLabelSet, EncodeMetric as _};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::{ConstGauge, Gauge};
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Registry, Unit};
use robot::counts::QuerySummary;
use robot::{Estimate, Output, RunReport, StatusReport};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Label of a localization state.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct StateLabel {
    state: &'static str,
}

/// The states and their labels, as in published status messages.
const STATES: [(Localization, &str); 4] = [
    (Localization::OdometryOnly, "odometry_only"),
    (Localization::Localized, "localized"),
    (Localization::Lost, "lost"),
    (Localization::Starting, "starting"),
];

/// A status comes with each image, and every 200 ms without any: an older one says that the estimator waits for something.
const STALE: Duration = Duration::from_secs(5);

/// What a run counts while it goes on. Clones share the counters.
///
/// ```
/// use onboard::RobotMetrics;
/// use prometheus_client::registry::Registry;
///
/// let metrics = RobotMetrics::default();
/// let mut registry = Registry::default();
/// metrics.register(&mut registry);
/// assert!(!metrics.health().is_well, "no frame yet");
/// ```
#[derive(Clone, Debug)]
pub struct RobotMetrics {
    frames: Counter,
    frame_duration: Histogram,
    queries_sent: Counter,
    queries_answered: Counter,
    answers_accepted: Counter,
    localization: Family<StateLabel, Gauge>,
    held_keyframes: Gauge,
    /// That of the last status, and when it came.
    health: Arc<Mutex<(Health, Option<Instant>)>>,
}

impl Default for RobotMetrics {
    fn default() -> Self {
        Self {
            frames: Counter::default(),
            // From a quarter of a millisecond to 4 s.
            frame_duration: Histogram::new(exponential_buckets(0.000_25, 2.0, 15)),
            queries_sent: Counter::default(),
            queries_answered: Counter::default(),
            answers_accepted: Counter::default(),
            localization: Family::default(),
            held_keyframes: Gauge::default(),
            health: Arc::new(Mutex::new((Health::unwell("no image yet"), None))),
        }
    }
}

impl RobotMetrics {
    /// Registers all metrics under the prefix `robot`.
    pub fn register(&self, registry: &mut Registry) {
        let registry = registry.sub_registry_with_prefix("robot");
        registry.register("frames", "Images processed", self.frames.clone());
        registry.register_with_unit(
            "frame_duration",
            "Computing time of an image, map updates included",
            Unit::Seconds,
            self.frame_duration.clone(),
        );
        registry.register("queries_sent", "Map queries sent", self.queries_sent.clone());
        registry.register(
            "queries_answered",
            "Map queries answered, no match included",
            self.queries_answered.clone(),
        );
        registry.register(
            "answers_accepted",
            "Answers that corrected the pose",
            self.answers_accepted.clone(),
        );
        registry.register("localization", "1 for the present state, else 0", self.localization.clone());
        registry.register_collector(Box::new(HealthGauge(self.clone())));
        registry.register("held_keyframes", "Keyframes held in the estimator", self.held_keyframes.clone());
    }

    /// Whether the robot has a pose that can be trusted: in the map, or by odometry before the first match.
    pub fn health(&self) -> Health {
        self.health_at(Instant::now())
    }

    fn health_at(&self, now: Instant) -> Health {
        let (health, noted) = self.health.lock().unwrap_or_else(PoisonError::into_inner).clone();
        match noted {
            Some(noted) if now.duration_since(noted) > STALE => Health::unwell(format!(
                "the estimator has not said anything for more than {} s; before: {}",
                STALE.as_secs(),
                health.reason
            )),
            _ => health,
        }
    }

    /// Takes the status and the number of queries of now.
    fn note_status(&self, status: &Status, queries: &QuerySummary) {
        for (state, name) in STATES {
            let label = StateLabel { state: name };
            self.localization.get_or_create(&label).set(i64::from(status.localization == state));
        }
        self.held_keyframes.set(status.held_keyframes as i64);
        raise(&self.queries_sent, queries.sent);
        raise(&self.queries_answered, queries.answered);
        raise(&self.answers_accepted, queries.accepted);
        let is_well = status.localization.is_usable();
        let health = Health { is_well, reason: status.reason.clone() };
        *self.health.lock().unwrap_or_else(PoisonError::into_inner) = (health, Some(Instant::now()));
    }
}

/// The health of the time at which metrics are asked for: an estimator that hangs sets nothing.
#[derive(Debug)]
struct HealthGauge(RobotMetrics);

impl Collector for HealthGauge {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> std::fmt::Result {
        let gauge = ConstGauge::new(i64::from(self.0.health().is_well));
        let help = "1 where /health answers that the robot is well, else 0";
        let encoder = encoder.encode_descriptor("healthy", help, None, gauge.metric_type())?;
        gauge.encode(encoder)
    }
}

impl Output for RobotMetrics {
    fn estimate(&mut self, estimate: &Estimate) {
        self.frames.inc();
        self.frame_duration.observe(estimate.computing_time.as_secs_f64());
    }

    fn status(&mut self, report: &StatusReport) {
        self.note_status(&report.status, &report.queries);
    }

    fn end(&mut self, report: &RunReport) {
        if let Some(status) = &report.final_status {
            self.note_status(status, &report.queries);
        }
    }
}

/// Raises a counter to a total that was counted elsewhere.
fn raise(counter: &Counter, total: u64) {
    counter.inc_by(total.saturating_sub(counter.get()));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_old_status_is_no_sign_of_health() {
        let metrics = RobotMetrics::default();
        let mut registry = Registry::default();
        metrics.register(&mut registry);
        let is_shown = |value: u8| {
            let mut text = String::new();
            prometheus_client::encoding::text::encode(&mut text, &registry).unwrap();
            assert!(text.contains(&format!("\nrobot_healthy {value}\n")), "{text}");
        };
        is_shown(0);
        let (localization, reason) = (Localization::Localized, "fine".to_owned());
        let status = Status { localization, reason, last_map_update_ns: None, held_keyframes: 0 };
        metrics.note_status(&status, &QuerySummary::default());
        let now = Instant::now();
        assert!(metrics.health_at(now).is_well);
        is_shown(1);
        let later = metrics.health_at(now + STALE + Duration::from_secs(1));
        assert!(!later.is_well && later.reason.contains("5 s"), "{later:?}");
    }
}
