//! Keeps what a run put out, and writes it to the output folder.
//!
//! | file | what |
//! |---|---|
//! | `pose.tum`, `odometry.tum`, `transform.tum` | I in G, I in L, `G_T_L` |
//! | `states.csv` | all three with their 6x6 covariances |
//! | `events.csv` | a line a query: when asked, answered, matches, inliers, accepted or why not |
//! | `summary.json` | errors where truth is known, times, bytes, counts |

use super::query_client::Answered;
use super::summary::{
    DivergenceSummary, QuerySummary, StartSummary, Summary, Timings, TrackSummary, Traffic,
};
use crate::estimator::{Estimator, EstimatorError, MapReport, StartMethod, Status, TrackReport};
use crate::trajectory::{StampedPose, StateKind, StateRow, states, tum};
use anyhow::{Context as _, Result};
use protocol::MatchOutcome;
use serde::Serialize;
use std::path::Path;

/// One query, as a line of `events.csv`.
#[derive(Clone, Debug, Serialize)]
pub struct Event {
    /// Time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// The same, seconds.
    pub asked_at_s: f64,
    /// Time of the state when the answer was taken in, seconds.
    pub answered_at_s: f64,
    /// `matched`, `no_match` and its kin, or `failed`.
    pub outcome: String,
    /// Keyframes in the answer.
    pub keyframes: usize,
    /// Landmarks in the answer.
    pub matches: usize,
    /// Landmarks that one camera pose explains.
    pub inliers: usize,
    /// Landmarks that corrected the state.
    pub used: usize,
    /// Mean reprojection error at the prediction, px.
    pub mean_reprojection_px: Option<f64>,
    /// Whether the linearization point was moved.
    pub relinearized: bool,
    /// Whether the state was corrected.
    pub accepted: bool,
    /// Why not.
    pub reason: String,
}

impl Event {
    /// An event whose outcome is still to be noted.
    pub fn new(answered: &Answered, state_ns: i64) -> Self {
        Self {
            stamp_ns: answered.stamp_ns,
            asked_at_s: answered.stamp_ns as f64 * 1e-9,
            answered_at_s: state_ns as f64 * 1e-9,
            outcome: String::new(),
            keyframes: 0,
            matches: 0,
            inliers: 0,
            used: 0,
            mean_reprojection_px: None,
            relinearized: false,
            accepted: false,
            reason: String::new(),
        }
    }

    /// The map knew the place.
    pub fn note_report(&mut self, report: &MapReport) {
        self.outcome = "matched".into();
        self.keyframes = report.keyframes;
        self.matches = report.matches;
        self.inliers = report.verified;
        self.used = report.accepted;
        self.mean_reprojection_px = report.mean_reprojection_px;
        self.relinearized = report.relinearized;
        self.accepted = report.rejection.is_none();
        self.reason = report.rejection.as_ref().map_or_else(String::new, ToString::to_string);
    }

    /// The map did not know the place.
    pub fn note_no_match(&mut self, outcome: MatchOutcome) {
        let (name, reason) = match outcome {
            MatchOutcome::Matched => ("matched", ""),
            MatchOutcome::NoMatch => ("no_match", "the map does not know the place"),
            MatchOutcome::NotVerified => ("not_verified", "no keyframe agrees in its geometry"),
            MatchOutcome::TooFewFeatures => ("too_few_features", "too few features to recognize a place by"),
            MatchOutcome::Ambiguous => ("ambiguous", "two places of the map look alike"),
            MatchOutcome::EmptyMap => ("empty_map", "the map holds no keyframe"),
        };
        self.outcome = name.into();
        self.reason = reason.into();
    }

    /// There was no answer.
    pub fn note_failure(&mut self, reason: &str) {
        self.outcome = "failed".into();
        self.reason = reason.into();
    }
}

/// What a run put out so far.
#[derive(Debug, Default)]
pub struct Recorder {
    /// A row a frame.
    pub states: Vec<StateRow>,
    /// A row a query.
    pub events: Vec<Event>,
    /// Time by step.
    pub timings: Timings,
    /// Bytes over the wire.
    pub traffic: Traffic,
    /// Tracks.
    pub tracks: TrackSummary,
    /// Queries sent.
    pub queries_sent: u64,
    /// Images that were not asked about because too many queries were on their way.
    pub queries_skipped: u64,
    /// Queries answered by the map.
    pub queries_answered: u64,
    /// Frames skipped for want of IMU readings.
    pub skipped_frames: usize,
    /// IMU readings that were dropped.
    pub dropped_imu: usize,
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
    /// Notes what became of a frame's tracks.
    pub fn note_tracks(&mut self, report: &TrackReport) {
        self.tracks.used += report.used;
        self.tracks.not_triangulated += report.not_triangulated;
        self.tracks.gated += report.gated;
        self.tracks.dropped_observations += report.dropped_observations;
    }

    /// Notes the state of a frame.
    pub fn note_state(&mut self, estimator: &Estimator) {
        self.keyframes_pulled = estimator.held_keyframes().len();
        self.states.push(StateRow {
            stamp_ns: estimator.stamp_ns(),
            local_from_imu: estimator.local_from_imu(),
            global_from_local: estimator.global_from_local(),
            global_from_imu: estimator.global_from_imu(),
        });
    }

    /// Notes the state of the last frame again, after what was learned since.
    pub fn note_state_again(&mut self, estimator: &Estimator) {
        self.states.pop();
        self.note_state(estimator);
    }

    /// Notes a start of the filter; a method that is not given is a state that was known.
    pub fn note_start(&mut self, stamp_ns: i64, method: Option<&StartMethod>) {
        let (method, scale_sigma) = match method {
            None => ("known", None),
            Some(StartMethod::Rest) => ("rest", None),
            Some(StartMethod::Motion(belief)) => ("motion", Some(belief.scale_sigma)),
        };
        let seconds = (stamp_ns - self.first_ns) as f64 * 1e-9;
        self.starts.push(StartSummary { seconds, method, scale_sigma });
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
    pub fn note_event(&mut self, event: Event) {
        if event.outcome != "failed" {
            self.queries_answered += 1;
        }
        self.events.push(event);
    }

    /// Counts of queries.
    pub fn query_summary(&self) -> QuerySummary {
        let count = |predicate: &dyn Fn(&Event) -> bool| {
            self.events.iter().filter(|event| predicate(event)).count() as u64
        };
        QuerySummary {
            sent: self.queries_sent,
            skipped: self.queries_skipped,
            answered: self.queries_answered,
            matched: count(&|event| event.outcome == "matched"),
            accepted: count(&|event| event.accepted),
            relinearized: count(&|event| event.accepted && event.relinearized),
            failed: count(&|event| event.outcome == "failed"),
        }
    }

    /// Length of the recording that was played, seconds.
    pub fn seconds(&self) -> f64 {
        match (self.states.first(), self.states.last()) {
            (Some(first), Some(last)) => (last.stamp_ns - first.stamp_ns) as f64 * 1e-9,
            _ => 0.0,
        }
    }

    /// Writes all files into `folder`, which is made if it is not there.
    ///
    /// # Errors
    /// A sentence that names the file.
    pub fn write(&self, folder: &Path, summary: &Summary) -> Result<()> {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make the folder {}", folder.display()))?;
        for (name, kind) in [
            ("pose.tum", StateKind::GlobalFromImu),
            ("odometry.tum", StateKind::LocalFromImu),
            ("transform.tum", StateKind::GlobalFromLocal),
        ] {
            let poses: Vec<StampedPose> = self
                .states
                .iter()
                .filter_map(|row| Some(StampedPose { stamp_ns: row.stamp_ns, pose: row.get(kind)?.pose }))
                .collect();
            tum::write(&folder.join(name), &poses)?;
        }
        states::write(&folder.join("states.csv"), &self.states)?;
        self.write_events(&folder.join("events.csv"))?;
        let path = folder.join("summary.json");
        let text =
            serde_json::to_string_pretty(summary).context("the summary holds a number that JSON cannot")?;
        std::fs::write(&path, text + "\n").with_context(|| format!("cannot write {}", path.display()))
    }

    fn write_events(&self, path: &Path) -> Result<()> {
        let failed = || format!("cannot write {}", path.display());
        let mut writer = csv::Writer::from_path(path).with_context(failed)?;
        for event in &self.events {
            writer.serialize(event).with_context(failed)?;
        }
        writer.flush().with_context(failed)
    }
}
