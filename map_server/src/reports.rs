//! What became of each query, for whoever shows it.

use std::time::{Duration, Instant};

use nalgebra::Vector3;
use protocol::{ErrorReply, KeyframeId, LocalizedPose, MatchOutcome, PosePrior, keys};
use recognition::SearchReport;
use tokio::sync::broadcast;
use zenoh::query::Query;

use crate::kind::Kind;

/// Reports that wait for a receiver; one that is slower misses the oldest.
const WAITING: usize = 256;
/// Longest name of a client in a report, bytes; the id of a session has 32.
const MAX_CLIENT_BYTES: usize = 64;

/// What became of a query for a match or for a pose.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct QueryReport {
    /// Kind of the query: `match` or `localize`.
    pub kind: &'static str,
    /// Who asked, as the query's selector says: the id of its Zenoh session; empty for a client without a name. At most 64
    /// bytes.
    pub client: String,
    /// The map.
    pub map: String,
    /// From the receipt of the query to its last reply.
    pub duration: Duration,
    /// The answer, or why there is none: a refused query is [`protocol::ErrorCode::Busy`].
    pub result: Result<AnsweredQuery, ErrorReply>,
}

/// A query that was answered, "no match" included.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct AnsweredQuery {
    /// Result of the search.
    pub outcome: MatchOutcome,
    /// The keyframes of the answer; none for an image that was not recognized.
    pub keyframes: Vec<KeyframeId>,
    /// Version of the searched map.
    pub map_version: u64,
    /// Sensor time of the image, nanoseconds, where the query states it.
    pub stamp_ns: Option<i64>,
    /// Number of the image's features.
    pub features: usize,
    /// Position of the camera in G (m) that the query expects.
    pub prior_in_global: Option<Vector3<f64>>,
    /// The pose of the answer to a `localize` query; `None` for an image that was not recognized.
    pub fix: Option<LocalizedPose>,
    /// What the search found out.
    pub search: SearchReport,
}

/// Position of a prior in G (m).
pub(crate) fn position_of(prior: Option<&PosePrior>) -> Option<Vector3<f64>> {
    prior.map(|prior| prior.global_from_camera.pose.translation)
}

/// Tells of queries; without a receiver nothing is written down.
#[derive(Clone, Debug)]
pub(crate) struct ReportSender(broadcast::Sender<QueryReport>);

impl ReportSender {
    pub(crate) fn new() -> Self {
        Self(broadcast::Sender::new(WAITING))
    }

    pub(crate) fn subscribe(&self) -> broadcast::Receiver<QueryReport> {
        self.0.subscribe()
    }

    /// Tells of a query whose last reply was just sent.
    pub(crate) fn note(
        &self,
        query: &Query,
        kind: Kind,
        map: &str,
        received: Instant,
        result: impl FnOnce() -> Result<AnsweredQuery, ErrorReply>,
    ) {
        if self.0.receiver_count() == 0 || !matches!(kind, Kind::Match | Kind::Localize) {
            return;
        }
        let client = query.parameters().get(keys::CLIENT_PARAMETER).unwrap_or_default();
        let report = QueryReport {
            kind: kind.name(),
            client: client[..client.floor_char_boundary(MAX_CLIENT_BYTES)].to_owned(),
            map: map.to_owned(),
            duration: received.elapsed(),
            result: result(),
        };
        // The last receiver left meanwhile: nobody misses it.
        let _ = self.0.send(report);
    }
}
