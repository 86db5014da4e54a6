//! Asks the map about images, in the background: deadline, retry, never waiting.

use super::answer::map_answer;
use estimator::{CloneId, MapAnswer};
use protocol::{
    ErrorCode, ErrorReply, Format, MatchOutcome, MatchReply, MatchRequest, MatchStatus, MatchedKeyframe, keys,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};
use tokio::runtime::Handle;
use zenoh::Wait as _;
use zenoh::bytes::ZBytes;
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, QueryTarget};

/// First pause before an unanswered query is sent again; doubled each time.
const FIRST_PAUSE: Duration = Duration::from_millis(20);
/// Longest such pause.
const LONGEST_PAUSE: Duration = Duration::from_millis(500);

/// How a query ended.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// The map recognized the place.
    Matched(MapAnswer),
    /// The map was searched and does not know the place.
    NoMatch(MatchOutcome),
    /// No answer: no server, a dead one, or one that refused. With the reason, for a person.
    Failed(String),
}

/// The end of one query.
#[derive(Clone, Debug)]
pub struct QueryResult {
    /// The clone of the image that was asked about.
    pub clone: CloneId,
    /// Time of the image, nanoseconds.
    pub stamp_ns: i64,
    /// What came of it.
    pub outcome: Outcome,
    /// From asking to here.
    pub elapsed: Duration,
    /// Payload bytes sent, repetitions included.
    pub bytes_sent: usize,
    /// Payload bytes received.
    pub bytes_received: usize,
}

/// Sends match queries over a Zenoh session and hands back their answers through a channel.
#[derive(Debug)]
pub struct QueryClient {
    session: zenoh::Session,
    runtime: Handle,
    key: String,
    deadline: Duration,
    sender: Sender<QueryResult>,
    receiver: Receiver<QueryResult>,
    pending: usize,
    /// Whether the last query found nobody: then the next one is tried once only, so that a robot
    /// without a server does not pile up queries.
    nobody_there: bool,
    /// Whether it was said already that the server does not know the map.
    unknown_map_told: Arc<AtomicBool>,
}

impl QueryClient {
    /// A client for one map.
    ///
    /// # Errors
    /// [`keys::NameError`] for a map name that no key can hold.
    pub fn new(
        session: zenoh::Session,
        runtime: Handle,
        map: &str,
        deadline: Duration,
    ) -> Result<Self, keys::NameError> {
        let (sender, receiver) = channel();
        Ok(Self {
            session,
            runtime,
            key: keys::map_match(map)?,
            deadline,
            sender,
            receiver,
            pending: 0,
            nobody_there: false,
            unknown_map_told: Arc::default(),
        })
    }

    /// Sends a query and returns at once.
    pub fn ask(&mut self, clone: CloneId, request: MatchRequest) {
        self.pending += 1;
        let sender = self.sender.clone();
        let deadline = self.deadline;
        let asker = Asker {
            session: self.session.clone(),
            key: self.key.clone(),
            persistent: !self.nobody_there,
            unknown_map_told: self.unknown_map_told.clone(),
        };
        let runtime = self.runtime.clone();
        self.runtime.spawn(async move {
            let begin = Instant::now();
            let stamp_ns = request.stamp_ns;
            // On a task of its own: whatever happens to it, its clone gets an answer and is let go.
            let work = runtime.spawn(async move {
                let mut traffic = Traffic::default();
                let outcome = asker.ask_until(&request, begin + deadline, &mut traffic).await;
                (outcome, traffic)
            });
            let (outcome, traffic) = work.await.unwrap_or_else(|error| {
                (Outcome::Failed(format!("the query ended badly: {error}")), Traffic::default())
            });
            let answered = QueryResult {
                clone,
                stamp_ns,
                outcome,
                elapsed: begin.elapsed(),
                bytes_sent: traffic.sent,
                bytes_received: traffic.received,
            };
            // Nobody listens any more: the run is over.
            let _ = sender.send(answered);
        });
    }

    /// Queries on their way.
    pub fn pending(&self) -> usize {
        self.pending
    }

    /// The next answer that is already here.
    pub fn poll(&mut self) -> Option<QueryResult> {
        let answered = self.receiver.try_recv().ok()?;
        Some(self.note(answered))
    }

    /// The next answer; for a player that stops its recording meanwhile, not for a robot.
    pub fn wait(&mut self) -> Option<QueryResult> {
        if self.pending == 0 {
            return None;
        }
        match self.receiver.recv_timeout(self.deadline + Duration::from_secs(1)) {
            Ok(answered) => Some(self.note(answered)),
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => None,
        }
    }

    fn note(&mut self, answered: QueryResult) -> QueryResult {
        self.pending = self.pending.saturating_sub(1);
        self.nobody_there = matches!(answered.outcome, Outcome::Failed(_)) && answered.bytes_received == 0;
        answered
    }
}

#[derive(Default)]
struct Traffic {
    sent: usize,
    received: usize,
}

/// One attempt's end.
enum Attempt {
    Finished(Outcome),
    /// Worth another try, with the reason.
    Again(String),
}

/// What one query needs.
struct Asker {
    session: zenoh::Session,
    key: String,
    /// Whether to try again.
    persistent: bool,
    unknown_map_told: Arc<AtomicBool>,
}

impl Asker {
    async fn ask_until(&self, request: &MatchRequest, deadline: Instant, traffic: &mut Traffic) -> Outcome {
        let payload = match protocol::encode(Format::Bincode, request) {
            Ok(payload) => ZBytes::from(payload),
            Err(error) => return Outcome::Failed(format!("the query cannot be sent: {error}")),
        };
        let mut pause = FIRST_PAUSE;
        loop {
            traffic.sent += payload.len();
            let reason = match self.attempt(&payload, request, deadline, traffic).await {
                Attempt::Finished(outcome) => return outcome,
                Attempt::Again(reason) => reason,
            };
            if !self.persistent || Instant::now() + pause >= deadline {
                return Outcome::Failed(reason);
            }
            tokio::time::sleep(pause).await;
            pause = (pause * 2).min(LONGEST_PAUSE);
        }
    }

    async fn attempt(
        &self,
        payload: &ZBytes,
        request: &MatchRequest,
        deadline: Instant,
        traffic: &mut Traffic,
    ) -> Attempt {
        let left = deadline.saturating_duration_since(Instant::now());
        let (session, key, payload) = (self.session.clone(), self.key.clone(), payload.clone());
        let send = move || {
            session
                .get(key)
                .payload(payload)
                .encoding(Format::Bincode.encoding())
                .target(QueryTarget::BestMatching)
                // Replies travel as the query does: blocking, so that none is dropped under load.
                .congestion_control(CongestionControl::Block)
                .consolidation(ConsolidationMode::None)
                .timeout(left)
                .wait()
        };
        // On a congested link this holds its thread for seconds, past the deadline too: not one of the runtime's.
        let sent = tokio::time::timeout_at(deadline.into(), tokio::task::spawn_blocking(send)).await;
        let replies = match sent {
            Ok(Ok(Ok(replies))) => replies,
            Ok(Ok(Err(error))) => return Attempt::Again(format!("the query could not be sent: {error}")),
            Ok(Err(error)) => return Attempt::Again(format!("the query could not be sent: {error}")),
            Err(_) => {
                return Attempt::Again(
                    "the link is congested: the query was not sent before the deadline".into(),
                );
            }
        };
        let mut keyframes: Vec<MatchedKeyframe> = Vec::new();
        let mut any = false;
        loop {
            let reply = match tokio::time::timeout_at(deadline.into(), replies.recv_async()).await {
                Ok(Ok(reply)) => reply,
                // The channel closes without a final status: nobody there, or one that died in between.
                Ok(Err(_)) if any => {
                    return Attempt::Again("the map server stopped in the middle of its answer".into());
                }
                Ok(Err(_)) => {
                    return Attempt::Again(
                        "no map server answers; is it running and serving this map?".into(),
                    );
                }
                Err(_) => return Attempt::Again("no answer before the deadline".into()),
            };
            any = true;
            let sample = match reply.result() {
                Ok(sample) => sample,
                Err(error) => {
                    let bytes = error.payload().to_bytes();
                    traffic.received += bytes.len();
                    return self.refused(&bytes);
                }
            };
            let bytes = sample.payload().to_bytes();
            traffic.received += bytes.len();
            match protocol::decode::<MatchReply>(Format::Bincode, &bytes) {
                Ok(MatchReply::Keyframe(keyframe)) => keyframes.push(keyframe),
                Ok(MatchReply::Done(status)) => return finish(request, &status, keyframes),
                Err(error) => {
                    return Attempt::Finished(Outcome::Failed(format!(
                        "the map server's answer is unreadable: {error}"
                    )));
                }
            }
        }
    }

    /// An error reply. Those that time heals are tried again.
    fn refused(&self, bytes: &[u8]) -> Attempt {
        match protocol::decode::<ErrorReply>(Format::Bincode, bytes) {
            Ok(error) if error.code == ErrorCode::Busy => Attempt::Again(error.message),
            Ok(error) => {
                if error.code == ErrorCode::UnknownMap && !self.unknown_map_told.swap(true, Ordering::Relaxed)
                {
                    tracing::warn!(
                        key = self.key,
                        "{}; name a map of this server with --map, or start the server with this map too (map_server \
                         --map NAME=DB): until then no query about an image is answered",
                        error.message
                    );
                }
                Attempt::Finished(Outcome::Failed(error.message))
            }
            // Zenoh itself says "Timeout" when a server hangs.
            Err(_) => Attempt::Again(format!("no answer: {}", String::from_utf8_lossy(bytes))),
        }
    }
}

fn finish(request: &MatchRequest, status: &MatchStatus, keyframes: Vec<MatchedKeyframe>) -> Attempt {
    if status.outcome != MatchOutcome::Matched {
        return Attempt::Finished(Outcome::NoMatch(status.outcome));
    }
    if keyframes.len() != usize::from(status.keyframes_sent) {
        return Attempt::Again(format!("{} of {} keyframes arrived", keyframes.len(), status.keyframes_sent));
    }
    Attempt::Finished(Outcome::Matched(map_answer(&request.features, &request.held, status, keyframes)))
}
