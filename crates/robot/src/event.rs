//! The result of a query, as it is written to `events.csv`.

use super::query_cameras::QueryImage;
use client::QueryResult;
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
    /// Time of the newest state when the answer was applied, seconds.
    pub applied_at_s: f64,
    /// `matched`, `no_match`, `not_verified`, `too_few_features`, `ambiguous`, `empty_map` or `failed`.
    pub outcome: String,
    /// Keyframes in the answer.
    pub keyframes: usize,
    /// Landmarks in the answer.
    pub matches: usize,
    /// Landmarks that agree with one camera pose.
    pub inliers: usize,
    /// Landmarks used in the update.
    pub used: usize,
    /// Mean reprojection error at the predicted pose, px.
    pub mean_reprojection_px: Option<f64>,
    /// Whether the update was re-linearized at the PnP solution.
    pub relinearized: bool,
    /// Whether the state was updated.
    pub accepted: bool,
    /// Why it was not; empty where it was.
    pub reason: String,
    /// Normalized innovation squared of the update, whether it was accepted or not; `None` where none was computed.
    #[serde(default)]
    pub nis: Option<f64>,
    /// Its degrees of freedom.
    #[serde(default)]
    pub nis_degrees: Option<usize>,
}

impl Event {
    /// An event whose outcome is still to be recorded.
    pub fn new(result: &QueryResult<QueryImage>, state_ns: i64) -> Self {
        let stamp_ns = result.request.stamp_ns;
        Self {
            stamp_ns,
            queried_at_s: stamp_ns as f64 * 1e-9,
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
            nis: None,
            nis_degrees: None,
        }
    }

    /// Records the report of the map update.
    pub fn note_report(&mut self, report: &MapReport) {
        self.outcome = "matched".into();
        self.keyframes = report.keyframes;
        self.matches = report.matches;
        self.inliers = report.inliers;
        self.used = report.used;
        self.mean_reprojection_px = report.mean_reprojection_px;
        self.relinearized = report.relinearized;
        (self.nis, self.nis_degrees) = report.nis.unzip();
        self.accepted = report.rejection.is_none();
        self.reason = report.rejection.as_ref().map_or_else(String::new, ToString::to_string);
    }

    /// Records an answer without a match.
    pub fn note_no_match(&mut self, outcome: MatchOutcome) {
        let (name, reason) = match outcome {
            MatchOutcome::Matched => ("matched", ""),
            MatchOutcome::NoMatch => ("no_match", "no keyframe of the map is similar to the image"),
            MatchOutcome::NotVerified => {
                ("not_verified", "no pose agrees with the matches of the similar keyframes")
            }
            MatchOutcome::TooFewFeatures => {
                ("too_few_features", "the image has too few features for place recognition")
            }
            MatchOutcome::Ambiguous => (
                "ambiguous",
                "the image fits several places of the map, or no better than a picture that repeats",
            ),
            MatchOutcome::EmptyMap => ("empty_map", "the map has no keyframes"),
        };
        self.outcome = name.into();
        self.reason = reason.into();
    }

    /// Records that there was no answer.
    pub fn note_failure(&mut self, reason: &str) {
        self.outcome = "failed".into();
        self.reason = reason.into();
    }
}
