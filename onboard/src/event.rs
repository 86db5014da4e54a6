//! The end of a query, as it is written to `events.csv`.

use client::query_client::QueryResult;
use estimator::MapReport;
use protocol::MatchOutcome;
use serde::{Deserialize, Serialize};

/// One query, as a line of `events.csv`.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Event {
    /// Time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// The same, seconds.
    pub queried_at_s: f64,
    /// Time of the state when the answer was taken in, seconds.
    pub applied_at_s: f64,
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
    pub fn new(answered: &QueryResult, state_ns: i64) -> Self {
        Self {
            stamp_ns: answered.stamp_ns,
            queried_at_s: answered.stamp_ns as f64 * 1e-9,
            applied_at_s: state_ns as f64 * 1e-9,
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
        self.inliers = report.inliers;
        self.used = report.used;
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
