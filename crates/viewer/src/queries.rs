//! The last queries: what was asked, what was found, and why it was refused.

use crate::fair_log::FairLog;
use crate::viewed_map::{position_covariance, rotation_wxyz};
use protocol::{ErrorCode, KeyframeId, LocalizedPose, MatchOutcome};
use serde::Serialize;
use std::sync::Arc;

/// Queries that are kept, of all robots together; where there are more, the robot with most of them loses its oldest.
/// About 2 KB each at most.
pub const MAX_QUERIES: usize = 512;
/// Candidates of a query that are kept.
const MAX_CANDIDATES: usize = 32;
/// Keyframes of an answer that are kept.
const MAX_KEYFRAMES: usize = 32;
/// Longest text of an error and name that is kept, bytes.
const MAX_TEXT_BYTES: usize = 256;

/// A query and what became of it, without its features.
#[derive(Clone, Debug, Serialize)]
pub struct ViewedQuery {
    /// Its kind: `match`, `localize`, or `image` for one that was given to the page.
    pub kind: &'static str,
    /// The map that was asked.
    pub map: String,
    /// From its receipt to the last reply, milliseconds.
    pub duration_ms: f64,
    /// What became of it.
    #[serde(flatten)]
    pub result: ViewedResult,
}

/// What became of a query.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum ViewedResult {
    /// It was answered, "no match" included.
    Answered(Box<ViewedAnswer>),
    /// It was not.
    Failed {
        /// Kind of failure.
        error: ErrorCode,
        /// What happened.
        message: String,
    },
}

/// The answer to a query, and how it was found.
#[derive(Clone, Debug, Serialize)]
pub struct ViewedAnswer {
    /// Result of the search.
    pub outcome: MatchOutcome,
    /// Version of the searched map.
    pub map_version: u64,
    /// Sensor time of the image, nanoseconds, where the query states it.
    pub stamp_ns: Option<i64>,
    /// Number of the image's features.
    pub features: usize,
    /// The keyframes that were sent; none for an image that was not recognized.
    pub keyframes: Vec<KeyframeId>,
    /// Where the query expected the camera, in G, metres.
    pub prior_in_global: Option<[f64; 3]>,
    /// Where the camera was found, in G, metres.
    pub camera_in_global: Option<[f64; 3]>,
    /// The pose that was estimated; `None` where none was, and of a match, which leaves that to the robot.
    pub fix: Option<ViewedFix>,
    /// The keyframes that most features voted for.
    pub candidates: Vec<ViewedCandidate>,
}

/// The pose of a camera that was estimated from one image, in G.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ViewedFix {
    /// Position of the camera, metres.
    pub position: [f64; 3],
    /// Rotation from the camera frame (x right, y down, z forward) to G.
    pub rotation_wxyz: [f64; 4],
    /// Covariance of the position with that of the map, m^2, by rows.
    pub position_covariance: [[f64; 3]; 3],
    /// Standard deviation of the rotation, root mean square of the axes, radians.
    pub sigma_theta_rad: f64,
    /// Features that matched a landmark.
    pub matched_features: u32,
    /// Those of them that agree with the pose.
    pub inliers: u32,
    /// Mean reprojection error of the inliers, pixels.
    pub mean_error_px: f64,
}

impl ViewedFix {
    /// The pose of an answer.
    pub fn of(pose: &LocalizedPose) -> Self {
        let global_from_camera = &pose.global_from_camera;
        Self {
            position: global_from_camera.pose.translation.into(),
            rotation_wxyz: rotation_wxyz(&global_from_camera.pose),
            position_covariance: position_covariance(global_from_camera),
            sigma_theta_rad: global_from_camera.sigma_theta_rad(),
            matched_features: pose.matched_features,
            inliers: pose.inliers,
            mean_error_px: pose.mean_error_px,
        }
    }
}

/// One of the keyframes that most features of a query voted for.
#[derive(Clone, Debug, Serialize)]
pub struct ViewedCandidate {
    /// The keyframe.
    pub keyframe: KeyframeId,
    /// Whether it was searched because it is near the prior.
    pub near_prior: bool,
    /// Features that voted for it.
    pub votes: u32,
    /// Descriptor matches.
    pub matches: u32,
    /// Matches that agree with the pose that was found.
    pub inliers: u32,
    /// Mean reprojection error of the inliers, pixels.
    pub mean_error_px: Option<f64>,
    /// Result of the comparison.
    pub verdict: CandidateVerdict,
}

/// Result of the comparison of a query with a candidate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CandidateVerdict {
    /// Not compared, since enough better candidates agreed.
    NotCompared,
    /// Fewer matches than a verification needs.
    TooFewMatches,
    /// No camera pose explains enough of the matches.
    NoPose,
    /// A pose explains enough of them, but they do not constrain it.
    PoseUncertain,
    /// A pose was found, but the answer is of another place, or of none.
    Verified,
    /// It is part of the answer.
    InAnswer,
}

/// A query that is kept.
#[derive(Debug, Serialize)]
pub(crate) struct KeptQuery {
    /// Grows with each query.
    number: u64,
    /// When its last reply was sent, milliseconds since the start of the server.
    #[serde(skip)]
    steady_ms: u64,
    /// Who asked, where it is a followed robot.
    robot: Option<String>,
    /// Who asked, by the id of its session.
    client: String,
    #[serde(flatten)]
    query: ViewedQuery,
}

impl KeptQuery {
    /// The query with its time since 1970.
    ///
    /// # Arguments
    /// * `started_ms`: the start of the server.
    pub(crate) fn since_1970(&self, started_ms: u64) -> DatedQuery<'_> {
        DatedQuery { time_ms: self.steady_ms + started_ms, query: self }
    }
}

/// A query as it is answered.
#[derive(Debug, Serialize)]
pub(crate) struct DatedQuery<'a> {
    /// When its last reply was sent, milliseconds since 1970.
    time_ms: u64,
    #[serde(flatten)]
    query: &'a KeptQuery,
}

/// The last queries.
#[derive(Debug)]
pub(crate) struct QueryLog(FairLog<Arc<KeptQuery>>);

impl Default for QueryLog {
    fn default() -> Self {
        Self(FairLog::new(MAX_QUERIES))
    }
}

impl QueryLog {
    /// Keeps a query.
    ///
    /// # Arguments
    /// * `steady_ms`: when its last reply was sent, milliseconds since the start of the server.
    pub(crate) fn add(
        &mut self,
        steady_ms: u64,
        robot: Option<&str>,
        client: &str,
        mut query: ViewedQuery,
    ) -> Arc<KeptQuery> {
        cut(&mut query.map);
        match &mut query.result {
            ViewedResult::Answered(answer) => {
                answer.candidates.truncate(MAX_CANDIDATES);
                answer.keyframes.truncate(MAX_KEYFRAMES);
            }
            ViewedResult::Failed { message, .. } => cut(message),
        }
        let mut client = client.to_owned();
        cut(&mut client);
        let number = self.0.next_number();
        let owner = robot.unwrap_or(&client).to_owned();
        let robot = robot.map(str::to_owned);
        let kept = Arc::new(KeptQuery { number, steady_ms, robot, client, query });
        self.0.add(&owner, Arc::clone(&kept));
        kept
    }

    /// The newest queries, newest first.
    ///
    /// # Arguments
    /// * `of`: a robot, or the session of another client; `None` for all.
    /// * `after`: only those with larger numbers.
    pub(crate) fn newest(&self, of: Option<&str>, after: u64, limit: usize) -> Vec<Arc<KeptQuery>> {
        let is_newer = |(number, query): &(u64, Arc<KeptQuery>)| (*number > after).then(|| Arc::clone(query));
        let mut newest: Vec<_> = match of {
            Some(owner) => self.0.of(owner).filter_map(is_newer).collect(),
            None => self.0.all().filter_map(is_newer).collect(),
        };
        newest.sort_by_key(|query| std::cmp::Reverse(query.number));
        newest.truncate(limit);
        newest
    }
}

fn cut(text: &mut String) {
    if text.len() > MAX_TEXT_BYTES {
        text.truncate(text.floor_char_boundary(MAX_TEXT_BYTES));
        text.shrink_to_fit();
    }
}
