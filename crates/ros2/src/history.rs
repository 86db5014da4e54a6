//! Transient local topics: what was published before, for subscribers that come later.
//!
//! As zenoh-ext's advanced publisher, which `rmw_zenoh` uses: a publisher answers queries of `<key>/@adv/pub/<session>/<entity>/_`
//! with its last messages, and a token of that name tells subscribers that were there before it. Messages that are lost on
//! the way are not asked for again: links are reliable.

use super::attachment::{ATTACHMENT_BYTES, Attachment};
use super::error::RosError;
use super::liveliness::GID_BYTES;
use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{ConsolidationMode, Query, QueryTarget, Queryable, Reply};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Wait, pubsub};

/// Between the key of a topic and the name of a publisher's history.
const ADVANCED: &str = "@adv";
/// Replies may be about other keys than the one that was asked for.
const ANY_KEY: &str = "_anyke";
/// The largest number of messages that a subscriber asks for.
const MAX: &str = "_max";
/// A publisher that does not answer is given up.
const TIMEOUT: Duration = Duration::from_secs(10);

type Kept = Arc<Mutex<VecDeque<(Vec<u8>, [u8; ATTACHMENT_BYTES])>>>;

/// The last messages of a publisher.
#[derive(Debug)]
pub(crate) struct PublishedHistory {
    kept: Kept,
    depth: usize,
    _answers: Queryable<()>,
    _token: LivelinessToken,
}

impl PublishedHistory {
    /// # Arguments
    /// * `key`: of the messages.
    /// * `entity`: number of the publisher in its session.
    pub(crate) async fn declare(
        session: &Session,
        key: &str,
        entity: u64,
        depth: usize,
    ) -> Result<Self, RosError> {
        let name = format!("{key}/{ADVANCED}/pub/{}/{entity}/_", session.zid());
        let kept = Kept::default();
        let answer = {
            let (kept, key) = (Arc::clone(&kept), key.to_owned());
            move |query: Query| answer(&query, &key, &kept)
        };
        let answers = session.declare_queryable(name.clone()).callback(answer).await;
        let answers = answers.map_err(RosError::zenoh("the history of a topic cannot be declared"))?;
        let token = session.liveliness().declare_token(name).await;
        let token = token.map_err(RosError::zenoh("the liveliness token cannot be declared"))?;
        Ok(Self { kept, depth, _answers: answers, _token: token })
    }

    /// Keeps a message; the oldest gives way.
    pub(crate) fn keep(&self, payload: Vec<u8>, attachment: [u8; ATTACHMENT_BYTES]) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() >= self.depth {
            kept.pop_front();
        }
        kept.push_back((payload, attachment));
    }
}

/// Sends the kept messages, the oldest first, as many as are wanted.
fn answer(query: &Query, key: &str, kept: &Kept) {
    let wanted = query.parameters().get(MAX).and_then(|max| max.parse().ok()).unwrap_or(usize::MAX);
    let messages = kept.lock().unwrap_or_else(PoisonError::into_inner).clone();
    for (payload, attachment) in messages.iter().skip(messages.len().saturating_sub(wanted)) {
        // Who asked may be gone.
        let _ = query.reply(key, payload.as_slice()).attachment(attachment).wait();
    }
}

/// Asks publishers for what they published before, those that are found later too.
#[derive(Debug)]
pub(crate) struct ReceivedHistory {
    _publishers: pubsub::Subscriber<()>,
}

impl ReceivedHistory {
    /// # Arguments
    /// * `key`: of the messages, a key expression.
    /// * `receive`: called for each message, which may have come before.
    pub(crate) async fn fetch(
        session: &Session,
        key: &str,
        receive: &Arc<dyn Fn(&Sample) + Send + Sync>,
    ) -> Result<Self, RosError> {
        let asking = session.clone();
        let receive = Arc::clone(receive);
        let found = move |token: Sample| {
            if token.kind() != SampleKind::Put {
                return;
            }
            let receive = Arc::clone(&receive);
            let take = move |reply: Reply| {
                if let Ok(sample) = reply.result() {
                    receive(sample);
                }
            };
            let history = asking
                .get(format!("{}?{ANY_KEY}", token.key_expr()))
                .target(QueryTarget::All)
                .consolidation(ConsolidationMode::None)
                .timeout(TIMEOUT)
                .callback(take);
            // Only a session that is closed refuses, and then nobody receives.
            let _ = history.wait();
        };
        let publishers = session
            .liveliness()
            .declare_subscriber(format!("{key}/{ADVANCED}/pub/**"))
            .history(true)
            .callback(found)
            .await
            .map_err(RosError::zenoh("the publishers of a topic cannot be looked for"))?;
        Ok(Self { _publishers: publishers })
    }
}

/// The newest message of each publisher, so that one that comes twice, from the history and as it was published, counts once.
#[derive(Debug, Default)]
pub(crate) struct Newest {
    numbers: Mutex<HashMap<[u8; GID_BYTES], i64>>,
}

impl Newest {
    /// Whether a message is newer than those before from its publisher. One without an attachment is new.
    pub(crate) fn is_new(&self, attachment: Option<&Attachment>) -> bool {
        let Some(Attachment { sequence_number, gid, .. }) = attachment else { return true };
        let mut numbers = self.numbers.lock().unwrap_or_else(PoisonError::into_inner);
        let newest = numbers.entry(*gid).or_insert(i64::MIN);
        let is_new = sequence_number > newest;
        *newest = (*newest).max(*sequence_number);
        is_new
    }
}
