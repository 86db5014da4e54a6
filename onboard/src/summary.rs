//! What a run comes to: `summary.json`.

use estimator::{EstimatorConfig, Status};
use evaluation::RunScore;
use serde::Serialize;
use std::time::Duration;

/// Time spent in the steps of frames.
#[derive(Clone, Copy, Debug, Default)]
pub struct Timings {
    /// Reading images and following points in them.
    pub front_end: Duration,
    /// IMU propagation and cloning.
    pub propagation: Duration,
    /// The update from tracks.
    pub tracks: Duration,
    /// Updates from the map, waiting excluded.
    pub map: Duration,
    /// Frames that were added.
    pub frames: usize,
}

impl Timings {
    /// Adds a frame.
    pub fn add(&mut self, frame: &Self) {
        self.front_end += frame.front_end;
        self.propagation += frame.propagation;
        self.tracks += frame.tracks;
        self.map += frame.map;
        self.frames += 1;
    }

    /// Milliseconds a frame.
    pub fn mean(&self) -> MillisecondsPerFrame {
        let mean = |total: Duration| total.as_secs_f64() * 1e3 / self.frames.max(1) as f64;
        MillisecondsPerFrame {
            front_end: mean(self.front_end),
            propagation: mean(self.propagation),
            tracks: mean(self.tracks),
            map: mean(self.map),
            total: mean(self.front_end + self.propagation + self.tracks + self.map),
        }
    }
}

/// Mean time a frame by step, wall clock of the estimator's thread.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct MillisecondsPerFrame {
    /// Reading images and following points in them; 0 for a recording that has tracks.
    pub front_end: f64,
    /// IMU propagation and cloning.
    pub propagation: f64,
    /// The update from tracks.
    pub tracks: f64,
    /// Updates from the map, waiting excluded.
    pub map: f64,
    /// All of them.
    pub total: f64,
}

/// Payload bytes over the wire.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Traffic {
    /// From the robot to the map server.
    pub sent: usize,
    /// From the map server to the robot.
    pub received: usize,
}

impl Traffic {
    /// Adds a query's.
    pub fn add(&mut self, other: &Self) {
        self.sent += other.sent;
        self.received += other.received;
    }
}

/// Counts of queries and what came of them.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct QuerySummary {
    /// Sent.
    pub sent: u64,
    /// Images that were not asked about because too many queries were on their way.
    pub skipped: u64,
    /// QueryResult by the map, with or without a match.
    pub answered: u64,
    /// QueryResult with a match.
    pub matched: u64,
    /// Corrected the state.
    pub accepted: u64,
    /// Of these, after moving the linearization point.
    pub relinearized: u64,
    /// Never answered.
    pub failed: u64,
}

/// Counts of the map's changes that the robot heard of.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct MapChangeSummary {
    /// The pose in the map was carried over.
    pub carried_over: u64,
    /// The place in the map was to be found anew.
    pub found_anew: u64,
}

/// Counts of tracks.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct TrackSummary {
    /// Corrected the state.
    pub used: usize,
    /// Could not be triangulated.
    pub not_triangulated: usize,
    /// Rejected by the gate.
    pub gated: usize,
    /// Single outlying observations that were dropped.
    pub dropped_observations: usize,
}

/// Gaps between IMU readings, over which the motion is interpolated.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct ImuGapSummary {
    /// How many.
    pub count: usize,
    /// The longest, seconds.
    pub longest_s: f64,
}

/// A start of the filter.
#[derive(Clone, Debug, Serialize)]
pub struct StartSummary {
    /// Time since the first frame, seconds.
    pub seconds: f64,
    /// `known`, `rest` or `motion`.
    pub method: &'static str,
    /// In motion: standard deviation of the scale, as a part of it.
    pub sigma_scale: Option<f64>,
}

/// A divergence of the filter.
#[derive(Clone, Debug, Serialize)]
pub struct DivergenceSummary {
    /// Time since the first frame, seconds.
    pub seconds: f64,
    /// What was wrong.
    pub reason: String,
}

/// The summary of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The recording.
    pub sequence: String,
    /// Name of the map; none with odometry only.
    pub map: Option<String>,
    /// Cameras used.
    pub cameras: usize,
    /// Frames that were processed.
    pub frames: usize,
    /// Frames that were skipped for want of IMU readings.
    pub skipped_frames: usize,
    /// IMU readings that were dropped.
    pub dropped_imu: usize,
    /// Gaps between IMU readings.
    pub imu_gaps: ImuGapSummary,
    /// Length of the recording that was played, seconds.
    pub seconds: f64,
    /// Time that it took, seconds.
    pub wall_seconds: f64,
    /// How many times faster than real time.
    pub realtime_factor: f64,
    /// Time a frame.
    pub milliseconds_per_frame: MillisecondsPerFrame,
    /// Errors and consistency, where truth is known.
    pub score: Option<RunScore>,
    /// Why there is no score.
    pub no_score: Option<String>,
    /// Queries.
    pub queries: QuerySummary,
    /// Changes of the map.
    pub map_changes: MapChangeSummary,
    /// Keyframes that were pulled from the map.
    pub keyframes_pulled: usize,
    /// Bytes over the wire.
    pub wire_bytes: Traffic,
    /// Tracks.
    pub tracks: TrackSummary,
    /// Starts after the first.
    pub reinitializations: usize,
    /// All starts.
    pub starts: Vec<StartSummary>,
    /// Why the filter was started again, and when it was given up.
    pub divergences: Vec<DivergenceSummary>,
    /// State at the end.
    pub final_status: Option<Status>,
    /// Whether the run was stopped from outside (Ctrl-C).
    pub interrupted: bool,
    /// Why the run ended early, if it did.
    pub ended_early: Option<String>,
    /// Settings of the estimator.
    pub settings: EstimatorConfig,
}
