//! What a run counts.

use sensors::PairCounts;
use serde::Serialize;
use std::time::Duration;

/// Computing time of the processing steps, summed over frames.
#[derive(Clone, Copy, Debug, Default)]
pub struct Timings {
    /// Reading images and tracking points in them.
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

    /// Computing time of all steps.
    pub fn total(&self) -> Duration {
        self.front_end + self.propagation + self.tracks + self.map
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
    /// Reading images and tracking points in them; 0 where the source has tracks.
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
    /// Adds the bytes of a query.
    pub fn add(&mut self, other: &Self) {
        self.sent += other.sent;
        self.received += other.received;
    }
}

/// Counts of queries and their results.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct QuerySummary {
    /// Sent.
    pub sent: u64,
    /// Images without a query because too many were pending.
    pub skipped: u64,
    /// Answered by the map, with or without a match.
    pub answered: u64,
    /// Answered with a match.
    pub matched: u64,
    /// Corrected the state.
    pub accepted: u64,
    /// Of these, after re-linearization at the PnP solution.
    pub relinearized: u64,
    /// Kept as evidence for a first pose in the map, which was not enough yet.
    pub kept_waiting: u64,
    /// Hypotheses about the first pose in the map that were dropped: another one had more evidence.
    pub hypotheses_dropped: u64,
    /// Without an answer: no server, deadline passed, refused.
    pub failed: u64,
}

/// Counts of changes of the map that were received.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct MapChangeSummary {
    /// The pose in the map was carried over to the new version.
    pub carried_over: u64,
    /// The pose in the map was dropped and had to be initialized again.
    pub found_anew: u64,
}

/// Stereo pairs and images without a partner, of all stereo pairs of the cameras: of a recording all, of live sensors those until the end.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct PairSummary {
    /// Frames with an image of both cameras.
    pub pairs: usize,
    /// Images of camera 0 without a partner: used as those of one camera.
    pub lone_first: usize,
    /// Images of camera 1 without a partner: left out.
    pub lone_second: usize,
    /// Largest difference between the stamps of a pair, milliseconds.
    pub largest_difference_ms: f64,
}

impl From<PairCounts> for PairSummary {
    fn from(counts: PairCounts) -> Self {
        let PairCounts { pairs, lone_first, lone_second, .. } = counts;
        let largest_difference_ms = counts.largest_difference_ns as f64 * 1e-6;
        Self { pairs, lone_first, lone_second, largest_difference_ms }
    }
}

/// Counts of tracks.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct TrackSummary {
    /// Corrected the state.
    pub used: usize,
    /// Could not be triangulated.
    pub not_triangulated: usize,
    /// Rejected by the chi-square gate.
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

/// An initialization of the filter.
#[derive(Clone, Debug, Serialize)]
pub struct StartSummary {
    /// Time since the first frame, seconds.
    pub seconds: f64,
    /// `known` (the initial state was given), `rest` or `motion`.
    pub method: &'static str,
    /// In motion: standard deviation of the scale, relative.
    pub sigma_scale: Option<f64>,
}

/// A jump of the clock of the sensors, which the clock of the estimator does not follow.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ClockShiftSummary {
    /// Time since the first frame on the clock of the estimator, seconds.
    pub seconds: f64,
    /// What the clock of the sensors is ahead of that of the estimator from then on, seconds.
    pub shift_s: f64,
}

/// A divergence of the filter.
#[derive(Clone, Debug, Serialize)]
pub struct DivergenceSummary {
    /// Time since the first frame, seconds.
    pub seconds: f64,
    /// Why it was detected.
    pub reason: String,
}
