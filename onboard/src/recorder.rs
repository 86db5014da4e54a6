//! Writes what a run puts out, and keeps of it what the summary needs.

use super::event::Event;
use super::output::OutputFiles;
use super::summary::{
    DivergenceSummary, ImuGapSummary, MapChangeSummary, QuerySummary, StartSummary, Summary, Timings,
    TrackSummary, Traffic,
};
use anyhow::Result;
use estimator::{Estimator, EstimatorError, InitMethod, Status, TrackReport};
use evaluation::trajectory::StateRow;
use std::path::Path;

/// The files of a run and its sums.
#[derive(Debug)]
pub struct Recorder {
    files: OutputFiles,
    /// The newest state; it may still be replaced, and is not written yet.
    newest: Option<StateRow>,
    /// Why the files are incomplete, if they are.
    broken: Option<anyhow::Error>,
    /// Time of the first state, nanoseconds.
    first_state_ns: Option<i64>,
    /// Time of the newest state, nanoseconds.
    last_state_ns: Option<i64>,
    /// Frames that were processed.
    pub frames: usize,
    /// Time by step.
    pub timings: Timings,
    /// Bytes over the wire.
    pub traffic: Traffic,
    /// Tracks.
    pub tracks: TrackSummary,
    /// Queries and what came of them.
    pub queries: QuerySummary,
    /// Changes of the map.
    pub map_changes: MapChangeSummary,
    /// Frames skipped for want of IMU readings.
    pub skipped_frames: usize,
    /// IMU readings that were dropped.
    pub dropped_imu: usize,
    /// Gaps between IMU readings.
    pub imu_gaps: ImuGapSummary,
    /// Time that the run took.
    pub wall_seconds: f64,
    /// Keyframes held at the end.
    pub keyframes_pulled: usize,
    /// Time of the first frame of the recording, nanoseconds.
    pub first_ns: i64,
    /// Starts of the filter.
    pub starts: Vec<StartSummary>,
    /// Divergences of the filter.
    pub divergences: Vec<DivergenceSummary>,
    /// Status at the end.
    pub final_status: Option<Status>,
}

impl Recorder {
    /// Makes the output folder and its files.
    ///
    /// # Errors
    /// A sentence that names the file.
    pub fn create(folder: &Path) -> Result<Self> {
        Ok(Self {
            files: OutputFiles::create(folder)?,
            newest: None,
            broken: None,
            first_state_ns: None,
            last_state_ns: None,
            frames: 0,
            timings: Timings::default(),
            traffic: Traffic::default(),
            tracks: TrackSummary::default(),
            queries: QuerySummary::default(),
            map_changes: MapChangeSummary::default(),
            skipped_frames: 0,
            dropped_imu: 0,
            imu_gaps: ImuGapSummary::default(),
            wall_seconds: 0.0,
            keyframes_pulled: 0,
            first_ns: 0,
            starts: Vec::new(),
            divergences: Vec::new(),
            final_status: None,
        })
    }

    /// Notes what became of a frame's tracks.
    pub fn note_tracks(&mut self, report: &TrackReport) {
        self.tracks.used += report.used;
        self.tracks.not_triangulated += report.not_triangulated;
        self.tracks.gated += report.gated;
        self.tracks.dropped_observations += report.dropped_observations;
    }

    /// Notes the state of a frame.
    pub fn note_state(&mut self, estimator: &Estimator) {
        self.write_newest();
        self.frames += 1;
        self.first_state_ns.get_or_insert(estimator.stamp_ns());
        self.note_state_again(estimator);
    }

    /// Notes the state of the last frame again, after what was learned since.
    pub fn note_state_again(&mut self, estimator: &Estimator) {
        self.last_state_ns = Some(estimator.stamp_ns());
        self.keyframes_pulled = estimator.held_keyframes().len();
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
            self.survive(written);
        }
    }

    /// A robot goes on when its disk is full, but says so, and in the end the run has failed.
    fn survive(&mut self, written: Result<()>) {
        if let (Err(error), None) = (written, &self.broken) {
            tracing::error!("the output will not be complete: {error:#}");
            self.broken = Some(error);
        }
    }

    /// Notes a start of the filter; a method that is not given is a state that was known.
    pub fn note_start(&mut self, stamp_ns: i64, method: Option<&InitMethod>) {
        let (method, sigma_scale) = match method {
            None => ("known", None),
            Some(InitMethod::Static) => ("rest", None),
            Some(InitMethod::Dynamic(init_quality)) => ("motion", Some(init_quality.sigma_scale)),
        };
        let seconds = (stamp_ns - self.first_ns) as f64 * 1e-9;
        self.starts.push(StartSummary { seconds, method, sigma_scale });
    }

    /// Notes that the filter was given up.
    pub fn note_divergence(&mut self, stamp_ns: i64, why: &EstimatorError) {
        let seconds = (stamp_ns - self.first_ns) as f64 * 1e-9;
        self.divergences.push(DivergenceSummary { seconds, reason: why.to_string() });
    }

    /// How many starts there were after the first.
    pub fn reinitializations(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Notes the end of a query.
    pub fn note_event(&mut self, event: &Event) {
        let count = |holds: bool| u64::from(holds);
        self.queries.answered += count(event.outcome != "failed");
        self.queries.matched += count(event.outcome == "matched");
        self.queries.accepted += count(event.accepted);
        self.queries.relinearized += count(event.accepted && event.relinearized);
        self.queries.failed += count(event.outcome == "failed");
        let written = self.files.append_event(event);
        self.survive(written);
    }

    /// Length of the recording that was played, seconds.
    pub fn seconds(&self) -> f64 {
        let (Some(first_ns), Some(last_ns)) = (self.first_state_ns, self.last_state_ns) else { return 0.0 };
        (last_ns - first_ns) as f64 * 1e-9
    }

    /// Writes what is left of the states and events.
    ///
    /// # Errors
    /// A sentence that names the file that could not be written, now or on the way.
    pub fn finish_states(&mut self) -> Result<()> {
        self.write_newest();
        self.broken.take().map_or_else(|| self.files.flush(), Err)
    }

    /// Writes the summary.
    ///
    /// # Errors
    /// A sentence that names the file.
    pub fn write_summary(&self, summary: &Summary) -> Result<()> {
        self.files.write_summary(summary)
    }
}
