//! Metrics of a server, for Prometheus.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Registry, Unit};

use crate::durations::{DurationCounter, DurationCounts};

/// Label of what one map has.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct MapLabel {
    map: String,
}

/// Labels of what the queries of one kind about one map have.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct QueryLabels {
    map: String,
    kind: &'static str,
}

/// Counters of a server since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct ServerStatistics {
    /// Queries answered, "no match" included.
    pub answered: u64,
    /// Queries answered with an error, refused ones excluded.
    pub failed: u64,
    /// Queries refused because the queue was full.
    pub refused: u64,
    /// Queries received and not answered yet, at this moment.
    pub waiting: u64,
    /// Time from the receipt of a query to its last reply, summed over answered and failed queries.
    pub answer_time: Duration,
    /// The same, counted in buckets.
    pub durations: DurationCounts,
    /// Whether answering any query panicked: a bug, please report it.
    pub panicked: bool,
    /// Cells of maps that are served by cells, at this moment.
    pub cells: u64,
    /// Those of them that are in memory.
    pub cells_in_memory: u64,
    /// Bytes that these take.
    pub cell_bytes: u64,
    /// Cells that were loaded from disk because they were asked for.
    pub cold_loads: u64,
    /// Times that this failed.
    pub cold_loads_failed: u64,
    /// Time that it took, summed over those that were loaded.
    pub cold_load_time: Duration,
}

/// What a server counts.
pub(crate) struct ServerMetrics {
    answered: Counter,
    failed: Counter,
    refused: Counter,
    waiting: Gauge,
    durations: Family<QueryLabels, Histogram>,
    keyframes: Family<MapLabel, Gauge>,
    versions: Family<MapLabel, Gauge<u64, AtomicU64>>,
    cells: Gauge,
    cells_in_memory: Gauge,
    cell_bytes: Gauge,
    cold_loads_failed: Counter,
    cold_load_duration: Histogram,
    cold_loads: AtomicU64,
    cold_load_us: AtomicU64,
    answer_us: AtomicU64,
    counts: DurationCounter,
    panicked: AtomicBool,
}

/// From half a millisecond to 8 s.
fn duration_histogram() -> Histogram {
    Histogram::new(exponential_buckets(0.0005, 2.0, 15))
}

impl Default for ServerMetrics {
    fn default() -> Self {
        Self {
            answered: Counter::default(),
            failed: Counter::default(),
            refused: Counter::default(),
            waiting: Gauge::default(),
            durations: Family::new_with_constructor(duration_histogram),
            keyframes: Family::default(),
            versions: Family::default(),
            cells: Gauge::default(),
            cells_in_memory: Gauge::default(),
            cell_bytes: Gauge::default(),
            cold_loads_failed: Counter::default(),
            cold_load_duration: duration_histogram(),
            cold_loads: AtomicU64::new(0),
            cold_load_us: AtomicU64::new(0),
            answer_us: AtomicU64::new(0),
            counts: DurationCounter::default(),
            panicked: AtomicBool::new(false),
        }
    }
}

impl ServerMetrics {
    /// Registers all metrics under the prefix `map_server`.
    pub(crate) fn register(&self, registry: &mut Registry) {
        let registry = registry.sub_registry_with_prefix("map_server");
        registry.register("queries_answered", "Queries answered, no match included", self.answered.clone());
        registry.register("queries_failed", "Queries answered with an error", self.failed.clone());
        registry.register("queries_refused", "Queries refused as busy", self.refused.clone());
        registry.register("queries_waiting", "Queries received and not answered yet", self.waiting.clone());
        registry.register_with_unit(
            "query_duration",
            "Time from the receipt of a query to its last reply",
            Unit::Seconds,
            self.durations.clone(),
        );
        registry.register("map_keyframes", "Keyframes of a served map", self.keyframes.clone());
        registry.register("map_version", "Version of a served map", self.versions.clone());
        registry.register("cells", "Cells of maps that are served by cells", self.cells.clone());
        registry.register("cells_in_memory", "Cells that are in memory", self.cells_in_memory.clone());
        registry.register_with_unit(
            "cells_memory",
            "Memory that cells take",
            Unit::Bytes,
            self.cell_bytes.clone(),
        );
        registry.register_with_unit(
            "cold_load_duration",
            "Time to load a cell that was asked for and not in memory",
            Unit::Seconds,
            self.cold_load_duration.clone(),
        );
        registry.register(
            "cold_loads_failed",
            "Cells that were asked for and could not be loaded",
            self.cold_loads_failed.clone(),
        );
    }

    /// A query waits.
    pub(crate) fn note_received(&self) {
        self.waiting.inc();
    }

    /// A query that was received was refused because the queue was full.
    pub(crate) fn note_refused(&self) {
        self.waiting.dec();
        self.refused.inc();
    }

    /// A query that waited was answered, or failed.
    pub(crate) fn note_done(&self, map: &str, kind: &'static str, duration: Duration, is_answered: bool) {
        self.waiting.dec();
        if is_answered {
            self.answered.inc()
        } else {
            self.failed.inc()
        };
        let micros = u64::try_from(duration.as_micros()).unwrap_or(u64::MAX);
        self.answer_us.fetch_add(micros, Ordering::Relaxed);
        self.counts.observe(duration);
        let labels = QueryLabels { map: map.to_owned(), kind };
        self.durations.get_or_create(&labels).observe(duration.as_secs_f64());
    }

    /// Answering a query panicked.
    pub(crate) fn note_panic(&self) {
        self.panicked.store(true, Ordering::Relaxed);
    }

    /// A map is served from now on.
    pub(crate) fn note_map(&self, name: &str, keyframes: usize, version: u64) {
        let label = MapLabel { map: name.to_owned() };
        self.keyframes.get_or_create(&label).set(keyframes as i64);
        self.versions.get_or_create(&label).set(version);
    }

    /// The cells of this server, those in memory, and their bytes.
    pub(crate) fn note_cells(&self, all: usize, in_memory: usize, bytes: usize) {
        self.cells.set(all as i64);
        self.cells_in_memory.set(in_memory as i64);
        self.cell_bytes.set(i64::try_from(bytes).unwrap_or(i64::MAX));
    }

    /// A cell that was not in memory was loaded.
    pub(crate) fn note_cold_load(&self, duration: Duration) {
        self.cold_load_duration.observe(duration.as_secs_f64());
        self.cold_loads.fetch_add(1, Ordering::Relaxed);
        let micros = u64::try_from(duration.as_micros()).unwrap_or(u64::MAX);
        self.cold_load_us.fetch_add(micros, Ordering::Relaxed);
    }

    /// A cell could not be loaded.
    pub(crate) fn note_failed_cold_load(&self) {
        self.cold_loads_failed.inc();
    }

    pub(crate) fn statistics(&self) -> ServerStatistics {
        ServerStatistics {
            answered: self.answered.get(),
            failed: self.failed.get(),
            refused: self.refused.get(),
            waiting: u64::try_from(self.waiting.get()).unwrap_or(0),
            durations: self.counts.counts(),
            answer_time: Duration::from_micros(self.answer_us.load(Ordering::Relaxed)),
            panicked: self.panicked.load(Ordering::Relaxed),
            cells: u64::try_from(self.cells.get()).unwrap_or(0),
            cells_in_memory: u64::try_from(self.cells_in_memory.get()).unwrap_or(0),
            cell_bytes: u64::try_from(self.cell_bytes.get()).unwrap_or(0),
            cold_loads: self.cold_loads.load(Ordering::Relaxed),
            cold_loads_failed: self.cold_loads_failed.get(),
            cold_load_time: Duration::from_micros(self.cold_load_us.load(Ordering::Relaxed)),
        }
    }
}
