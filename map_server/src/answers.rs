//! Which keyframes queries matched, for whoever shows it.

use protocol::{KeyframeId, MatchReply, keys};
use tokio::sync::broadcast;
use zenoh::query::Query;

/// Answers that wait for a receiver; one that is slower misses the oldest.
const WAITING: usize = 256;

/// The answer to a match query.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct MatchAnswer {
    /// Who asked, as the query's selector says: the id of its Zenoh session; empty for a client without a name.
    pub client: String,
    /// The map.
    pub map: String,
    /// The keyframes that matched; none for an image that was not recognized.
    pub keyframes: Vec<KeyframeId>,
}

/// Tells of answers; without a receiver nothing is written down.
#[derive(Clone, Debug)]
pub(crate) struct AnswerSender(broadcast::Sender<MatchAnswer>);

impl AnswerSender {
    pub(crate) fn new() -> Self {
        Self(broadcast::Sender::new(WAITING))
    }

    pub(crate) fn subscribe(&self) -> broadcast::Receiver<MatchAnswer> {
        self.0.subscribe()
    }

    pub(crate) fn note(&self, query: &Query, map: &str, replies: &[MatchReply]) {
        if self.0.receiver_count() == 0 {
            return;
        }
        let client = query.parameters().get(keys::CLIENT_PARAMETER).unwrap_or_default().to_owned();
        let matched = |reply: &MatchReply| match reply {
            MatchReply::Keyframe(keyframe) => Some(keyframe.keyframe.id),
            MatchReply::Done(_) => None,
        };
        let keyframes = replies.iter().filter_map(matched).collect();
        // The last receiver left meanwhile: nobody misses it.
        let _ = self.0.send(MatchAnswer { client, map: map.to_owned(), keyframes });
    }
}
