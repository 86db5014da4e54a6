//! Writes the files of a run, and counts for its summary.

use super::event::Event;
use super::files::{OutputError, OutputFiles};
use super::publisher::QueryCounts;
use super::summary::{
    DivergenceSummary, ImuGapSummary, MapChangeSummary, PairSummary, QuerySummary, StartSummary, Summary,
    Timings, TrackSummary, Traffic,
};
use crate::alarms::Alarm;
use crate::map_conversion::map_identity;
use estimator::{
    Estimator, EstimatorError, InitMethod, LearnedNoise, MapReport, Rejection, Status, TrackReport,
};
use evaluation::trajectory::StateRow;
use protocol::MapIdentity;
use std::path::Path;

/// The files of a run and its sums.
#[derive(Debug)]
pub struct Recorder {
    files: OutputFiles,
    /// The newest state, not written yet: map updates after the frame replace it.
    newest: Option<StateRow>,
    /// The first error of writing; the files are incomplete then.
    error: Option<OutputError>,
    /// Time of the first state, nanoseconds.
    first_state_ns: Option<i64>,
    /// Time of the newest state, nanoseconds.
    last_state_ns: Option<i64>,
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
    /// Stereo pairs and images without a partner; `None` for one camera.
    pub stereo_pairs: Option<PairSummary>,
    /// Frames that a live source dropped because nobody read them in time, or because they had no readings.
    pub dropped_frames: u64,
    /// IMU readings that the estimator refused.
    pub dropped_imu: usize,
    /// Gaps between IMU readings.
    pub imu_gaps: ImuGapSummary,
    /// Duration of the run, seconds of wall time.
    pub wall_seconds: f64,
    /// Keyframes received in answers, repeated ones included.
    pub keyframes_pulled: usize,
    /// Keyframes held in the estimator at the newest state.
    pub keyframes_held: usize,
    /// Identity of the map that the robot was localized in last.
    pub map_identity: Option<MapIdentity>,
    /// Time of the first frame of the recording, nanoseconds.
    pub first_ns: i64,
    /// Initializations of the filter.
    pub starts: Vec<StartSummary>,
    /// Divergences of the filter.
    pub divergences: Vec<DivergenceSummary>,
    /// Alarms.
    pub alarms: Vec<Alarm>,
    /// Status at the end.
    pub final_status: Option<Status>,
    /// Noise levels learned at the end.
    pub learned_noise: Option<LearnedNoise>,
}

impl Recorder {
    /// Creates the output folder and its files.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub fn create(folder: &Path) -> Result<Self, OutputError> {
        Ok(Self {
            files: OutputFiles::create(folder)?,
            newest: None,
            error: None,
            first_state_ns: None,
            last_state_ns: None,
            frames: 0,
            timings: Timings::default(),
            traffic: Traffic::default(),
            tracks: TrackSummary::default(),
            queries: QuerySummary::default(),
            map_changes: MapChangeSummary::default(),
            skipped_frames: 0,
            stereo_pairs: None,
            dropped_frames: 0,
            dropped_imu: 0,
            imu_gaps: ImuGapSummary::default(),
            wall_seconds: 0.0,
            keyframes_pulled: 0,
            keyframes_held: 0,
            map_identity: None,
            first_ns: 0,
            starts: Vec::new(),
            divergences: Vec::new(),
            alarms: Vec::new(),
            final_status: None,
            learned_noise: None,
        })
    }

    /// Counts the results of a track update.
    pub fn note_tracks(&mut self, report: &TrackReport) {
        self.tracks.used += report.used;
        self.tracks.not_triangulated += report.not_triangulated;
        self.tracks.gated += report.gated;
        self.tracks.dropped_observations += report.dropped_observations;
    }

    /// Records the state of a frame.
    pub fn note_state(&mut self, estimator: &Estimator) {
        self.write_newest();
        self.frames += 1;
        self.first_state_ns.get_or_insert(estimator.stamp_ns());
        self.note_state_again(estimator);
    }

    /// Replaces the state of the last frame, after map updates.
    pub fn note_state_again(&mut self, estimator: &Estimator) {
        self.last_state_ns = Some(estimator.stamp_ns());
        self.keyframes_held = estimator.held_keyframes().len();
        self.map_identity = estimator.map_identity().map(map_identity).or(self.map_identity);
        self.newest = Some(StateRow {
            stamp_ns: estimator.stamp_ns(),
            local_from_imu: estimator.local_from_imu(),
            global_from_local: estimator.global_from_local(),
            global_from_imu: estimator.global_from_imu(),
        });
    }

    fn write_newest(&mut self) {
        if let Some(row) = self.newest.take() {
            let written = self.files.append_state(&row);
            self.keep_first_error(written);
        }
    }

    /// A run continues when its disk is full: the first error is logged, and reported at the end.
    fn keep_first_error(&mut self, written: Result<(), OutputError>) {
        if let (Err(error), None) = (written, &self.error) {
            tracing::error!(%error, "the output files will be incomplete; the run continues");
            self.error = Some(error);
        }
    }

    /// Records an initialization of the filter; without a method the initial state was given.
    pub fn note_start(&mut self, stamp_ns: i64, method: Option<&InitMethod>) {
        let (method, sigma_scale) = match method {
            None => ("known", None),
            Some(InitMethod::Static) => ("rest", None),
            Some(InitMethod::Dynamic(init_quality)) => ("motion", Some(init_quality.sigma_scale)),
        };
        let seconds = (stamp_ns - self.first_ns) as f64 * 1e-9;
        self.starts.push(StartSummary { seconds, method, sigma_scale });
    }

    /// Records a divergence of the filter.
    pub fn note_divergence(&mut self, stamp_ns: i64, why: &EstimatorError) {
        let seconds = (stamp_ns - self.first_ns) as f64 * 1e-9;
        self.divergences.push(DivergenceSummary { seconds, reason: why.to_string() });
    }

    /// Number of initializations after the first.
    pub fn reinitializations(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Records the result of a query.
    pub fn note_event(&mut self, event: &Event) {
        let count = |holds: bool| u64::from(holds);
        self.queries.answered += count(event.outcome != "failed");
        self.queries.matched += count(event.outcome == "matched");
        self.queries.accepted += count(event.accepted);
        self.queries.relinearized += count(event.accepted && event.relinearized);
        self.queries.failed += count(event.outcome == "failed");
        let written = self.files.append_event(event);
        self.keep_first_error(written);
    }

    /// Counts what an answer did to the hypotheses about the first pose in the map.
    pub fn note_first_fix(&mut self, report: &MapReport) {
        let waits = matches!(report.rejection, Some(Rejection::NotDistinctive(_)));
        self.queries.kept_waiting += u64::from(waits);
        self.queries.hypotheses_dropped += report.hypotheses_dropped as u64;
    }

    /// Time from the first to the last state, seconds.
    pub fn seconds(&self) -> f64 {
        let (Some(first_ns), Some(last_ns)) = (self.first_state_ns, self.last_state_ns) else { return 0.0 };
        (last_ns - first_ns) as f64 * 1e-9
    }

    /// Counts of queries for status messages.
    pub(crate) fn query_counts(&self) -> QueryCounts {
        QueryCounts { sent: self.queries.sent, answered: self.queries.answered }
    }

    /// Writes the last state and flushes the files.
    ///
    /// # Errors
    /// The first [`OutputError`] of the run.
    pub fn finish_states(&mut self) -> Result<(), OutputError> {
        self.write_newest();
        self.error.take().map_or_else(|| self.files.flush(), Err)
    }

    /// Writes the summary.
    ///
    /// # Errors
    /// [`OutputError`] with the file.
    pub fn write_summary(&self, summary: &Summary) -> Result<(), OutputError> {
        self.files.write_summary(summary)
    }
}
