//! What a run leaves: its counts, its alarms, and how it ended.

use super::alarms::Alarm;
use super::counts::{
    ClockShiftSummary, DivergenceSummary, ImuGapSummary, MapChangeSummary, PairSummary, QuerySummary,
    StartSummary, Timings, TrackSummary, Traffic,
};
use super::error::RunError;
use super::event::Event;
use super::map_conversion::map_identity;
use estimator::{
    Estimated, Estimator, EstimatorError, GnssCounts, InitMethod, LearnedNoise, MapReport, Rejection, Status,
    TrackReport, WheelReport,
};
use protocol::MapIdentity;

/// What a run did, up to now or to its end.
#[derive(Debug, Default)]
#[non_exhaustive]
pub struct RunReport {
    /// Time of the first frame, nanoseconds.
    pub first_ns: i64,
    /// Time of the first state, nanoseconds.
    pub first_state_ns: Option<i64>,
    /// Time of the newest state, nanoseconds.
    pub last_state_ns: Option<i64>,
    /// Frames that were processed.
    pub frames: usize,
    /// Computing time by step.
    pub timings: Timings,
    /// Payload bytes of queries and answers.
    pub traffic: Traffic,
    /// Tracks.
    pub tracks: TrackSummary,
    /// Queries and their results.
    pub queries: QuerySummary,
    /// Changes of the map.
    pub map_changes: MapChangeSummary,
    /// Frames skipped: no IMU readings, an unusable image.
    pub skipped_frames: usize,
    /// Stereo pairs and images without a partner; `None` without a stereo pair, and before the end.
    pub stereo_pairs: Option<PairSummary>,
    /// Frames that a live source dropped because nobody read them in time, or because they had no readings.
    pub dropped_frames: u64,
    /// IMU readings that were left out; counted at the end.
    pub dropped_imu: usize,
    /// Gaps between IMU readings; counted at the end.
    pub imu_gaps: ImuGapSummary,
    /// Duration of the run, seconds of wall time; known once all outputs have ended.
    pub wall_seconds: f64,
    /// Keyframes received in answers, repeated ones included.
    pub keyframes_pulled: usize,
    /// Keyframes held in the estimator at the newest state.
    pub keyframes_held: usize,
    /// Identity of the map that the robot was localized in last.
    pub map_identity: Option<MapIdentity>,
    /// Initializations of the filter.
    pub starts: Vec<StartSummary>,
    /// Divergences of the filter.
    pub divergences: Vec<DivergenceSummary>,
    /// Jumps of the clock of the sensors.
    pub clock_shifts: Vec<ClockShiftSummary>,
    /// Alarms; listed at the end.
    pub alarms: Vec<Alarm>,
    /// Status at the end.
    pub final_status: Option<Status>,
    /// Noise levels learned at the end.
    pub learned_noise: Option<LearnedNoise>,
    /// Readout time of each camera's rolling shutter at the end, seconds; `None` where all shutters are global ones.
    pub readout_times_s: Option<Vec<Estimated>>,
    /// What the wheels did, and their calibration at the end; `None` without them.
    pub wheels: Option<WheelReport>,
    /// What GNSS did; `None` without it.
    pub gnss: Option<GnssCounts>,
    /// Why the run ended before its source did.
    pub ended_early: Option<RunError>,
}

impl RunReport {
    /// Number of initializations after the first.
    pub fn reinitializations(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Time from the first to the last state, seconds.
    pub fn seconds(&self) -> f64 {
        let (Some(first_ns), Some(last_ns)) = (self.first_state_ns, self.last_state_ns) else { return 0.0 };
        (last_ns - first_ns) as f64 * 1e-9
    }

    /// Time of a stamp since the first frame, seconds.
    pub(crate) fn seconds_at(&self, stamp_ns: i64) -> f64 {
        (stamp_ns - self.first_ns) as f64 * 1e-9
    }

    /// Counts the results of a track update.
    pub(crate) fn note_tracks(&mut self, report: &TrackReport) {
        self.tracks.used += report.used;
        self.tracks.not_triangulated += report.not_triangulated;
        self.tracks.gated += report.gated;
        self.tracks.dropped_observations += report.dropped_observations;
    }

    /// Counts the state of a frame.
    pub(crate) fn note_state(&mut self, estimator: &Estimator, timings: &Timings) {
        self.frames += 1;
        self.timings.add(timings);
        self.first_state_ns.get_or_insert(estimator.stamp_ns());
        self.note_state_again(estimator);
    }

    /// Takes in the state of the last frame again, after map updates.
    pub(crate) fn note_state_again(&mut self, estimator: &Estimator) {
        self.last_state_ns = Some(estimator.stamp_ns());
        self.keyframes_held = estimator.held_keyframes().len();
        self.map_identity = estimator.map_identity().map(map_identity).or(self.map_identity);
    }

    /// Keeps an initialization of the filter; without a method the initial state was given.
    pub(crate) fn note_start(&mut self, stamp_ns: i64, method: Option<&InitMethod>) {
        let (method, sigma_scale) = match method {
            None => ("known", None),
            Some(InitMethod::Static) => ("rest", None),
            Some(InitMethod::Dynamic(init_quality)) => ("motion", Some(init_quality.sigma_scale)),
        };
        self.starts.push(StartSummary { seconds: self.seconds_at(stamp_ns), method, sigma_scale });
    }

    /// Keeps a divergence of the filter.
    pub(crate) fn note_divergence(&mut self, stamp_ns: i64, why: &EstimatorError) {
        let seconds = self.seconds_at(stamp_ns);
        self.divergences.push(DivergenceSummary { seconds, reason: why.to_string() });
    }

    /// Counts the result of a query.
    pub(crate) fn note_event(&mut self, event: &Event) {
        let count = |holds: bool| u64::from(holds);
        self.queries.answered += count(event.outcome != "failed");
        self.queries.matched += count(event.outcome == "matched");
        self.queries.accepted += count(event.accepted);
        self.queries.relinearized += count(event.accepted && event.relinearized);
        self.queries.failed += count(event.outcome == "failed");
    }

    /// Counts what an answer did to the hypotheses about the first pose in the map.
    pub(crate) fn note_map_initialization(&mut self, report: &MapReport) {
        let waits = matches!(report.rejection, Some(Rejection::NotDistinctive(_)));
        self.queries.kept_waiting += u64::from(waits);
        self.queries.hypotheses_dropped += report.hypotheses_dropped as u64;
    }
}
