//! One request to a queryable: encoded once, sent until the answer is complete or the deadline is near.

use crate::error::ClientError;
use protocol::{ErrorReply, Format, Message, keys};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use zenoh::Wait as _;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::Locality;

/// First pause before a request is sent again; doubled each time.
const FIRST_PAUSE: Duration = Duration::from_millis(20);
/// Longest such pause.
const LONGEST_PAUSE: Duration = Duration::from_millis(500);

/// Silence after which a request is sent again; doubled each time. A connection that ends takes queries along that
/// Zenoh does not report as lost.
const FIRST_SILENCE: Duration = Duration::from_secs(3);

/// Most replies that an attempt reads: the keyframes that may be asked for, and the final status.
const MAX_REPLIES: usize = protocol::MAX_ANSWER_KEYFRAMES as usize + 1;
/// Most payload bytes that an attempt reads: an answer of as many keyframes is some megabytes.
const MAX_RECEIVED: usize = 4 * protocol::MAX_MESSAGE_BYTES;

/// Assembles the replies to one attempt.
pub(crate) trait Collector: Default {
    /// Type of the replies.
    type Reply: Message;
    /// The assembled answer.
    type Answer;

    /// Adds a reply; the answer once it is complete, or an error if it can no longer be.
    fn add(&mut self, reply: Self::Reply) -> Option<Result<Self::Answer, ClientError>>;
}

/// The answer is one reply.
pub(crate) struct SingleReply<R>(std::marker::PhantomData<R>);

impl<R> Default for SingleReply<R> {
    fn default() -> Self {
        Self(std::marker::PhantomData)
    }
}

impl<R: Message> Collector for SingleReply<R> {
    type Reply = R;
    type Answer = R;

    fn add(&mut self, reply: R) -> Option<Result<R, ClientError>> {
        Some(Ok(reply))
    }
}

/// When a request that failed is sent again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Retry {
    /// Never.
    Never,
    /// After a transient error.
    Transient,
    /// After a transient error, and while no server of the network serves the map.
    TransientOrUnknownMap,
}

impl Retry {
    fn applies_to(self, error: &ClientError) -> bool {
        match self {
            Self::Never => false,
            Self::Transient => error.is_transient(),
            Self::TransientOrUnknownMap => error.is_transient() || error.is_unknown_map(),
        }
    }
}

/// Payload bytes of a request and its replies, repetitions included.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Traffic {
    pub(crate) sent: usize,
    pub(crate) received: usize,
}

/// A request to one key.
pub(crate) struct Request {
    session: zenoh::Session,
    key: String,
    /// Whom the server counts it for.
    client: String,
    destination: Locality,
    /// None for keys that take no payload.
    payload: Option<(ZBytes, Encoding)>,
    deadline: Instant,
}

impl Request {
    pub(crate) fn new(session: &zenoh::Session, key: String, deadline: Instant) -> Self {
        let client = session.zid().to_string();
        Self { session: session.clone(), key, client, destination: Locality::Any, payload: None, deadline }
    }

    /// In the name of another client, within this session or outside of it.
    pub(crate) fn for_client(mut self, client: &str, destination: Locality) -> Self {
        client.clone_into(&mut self.client);
        self.destination = destination;
        self
    }

    pub(crate) fn with_encoded(mut self, payload: ZBytes, encoding: Encoding) -> Self {
        self.payload = Some((payload, encoding));
        self
    }

    pub(crate) fn with_payload<Q: Message>(self, message: &Q) -> Result<Self, ClientError> {
        let payload = protocol::encode(Format::Bincode, message).map_err(ClientError::Encode)?;
        Ok(self.with_encoded(payload.into(), Encoding::from(Format::Bincode.encoding())))
    }

    /// Sends the request until its answer is complete, as `retry` says, or until the deadline.
    pub(crate) async fn send<C: Collector>(
        &self,
        retry: Retry,
        traffic: &mut Traffic,
    ) -> Result<C::Answer, ClientError> {
        let (mut pause, mut silence) = (FIRST_PAUSE, FIRST_SILENCE);
        loop {
            let patience = if retry == Retry::Never { Duration::MAX } else { silence };
            traffic.sent += self.payload.as_ref().map_or(0, |(payload, _)| payload.len());
            let error = match self.attempt::<C>(patience, traffic).await {
                Ok(answer) => return Ok(answer),
                Err(error) => error,
            };
            if !retry.applies_to(&error) || Instant::now() + pause >= self.deadline {
                return Err(error);
            }
            if matches!(error, ClientError::Deadline) {
                silence *= 2;
            }
            tokio::time::sleep(pause).await;
            pause = (pause * 2).min(LONGEST_PAUSE);
        }
    }

    /// Sends the request once.
    ///
    /// # Arguments
    /// * `patience`: longest time without a reply; then the error is [`ClientError::Deadline`], as at the deadline.
    async fn attempt<C: Collector>(
        &self,
        patience: Duration,
        traffic: &mut Traffic,
    ) -> Result<C::Answer, ClientError> {
        let timeout = self.deadline.saturating_duration_since(Instant::now());
        let (session, key, payload) = (self.session.clone(), &self.key, self.payload.clone());
        // Zenoh delivers replies from the thread that reads the network, which must not wait: whatever does not fit is more
        // than an answer has.
        let (sender, mut replies) = mpsc::channel(MAX_REPLIES + 1);
        let deliver = move |reply| drop(sender.try_send(reply));
        let destination = self.destination;
        let selector = format!(
            "{key}?{}={};{}={};format=bincode",
            keys::CLIENT_PARAMETER,
            self.client,
            keys::PATIENCE_PARAMETER,
            timeout.min(patience).as_millis()
        );
        let send = move || {
            let query = session
                .get(selector)
                .allowed_destination(destination)
                .target(QueryTarget::BestMatching)
                // Replies are sent with the congestion control of the query: blocking, so that none is dropped.
                .congestion_control(CongestionControl::Block)
                .consolidation(ConsolidationMode::None)
                .timeout(timeout)
                .callback(deliver);
            match payload {
                Some((payload, encoding)) => query.payload(payload).encoding(encoding).wait(),
                None => query.wait(),
            }
        };
        // On a congested link this blocks its thread for seconds, past the deadline too: not a thread of the runtime.
        let sent = tokio::time::timeout_at(self.deadline.into(), tokio::task::spawn_blocking(send)).await;
        match sent {
            Ok(Ok(Ok(()))) => {}
            Ok(Ok(Err(error))) => return Err(ClientError::Send { problem: error.to_string() }),
            Ok(Err(error)) => return Err(ClientError::Send { problem: error.to_string() }),
            Err(_) => return Err(ClientError::Congested),
        }
        let mut collector = C::default();
        let (mut replies_read, mut received) = (0, 0);
        loop {
            let wait = self.deadline.saturating_duration_since(Instant::now()).min(patience);
            let reply = match tokio::time::timeout(wait, replies.recv()).await {
                Ok(Some(reply)) => reply,
                // The channel closed before the answer was complete: no server, or one that stopped.
                Ok(None) if replies_read > 0 => return Err(ClientError::Interrupted),
                Ok(None) => return Err(ClientError::NoServer),
                Err(_) => return Err(ClientError::Deadline),
            };
            replies_read += 1;
            let sample = match reply.result() {
                Ok(sample) => sample,
                Err(error) => {
                    let bytes = error.payload().to_bytes();
                    traffic.received += bytes.len();
                    return Err(refusal(error.encoding(), &bytes));
                }
            };
            let bytes = sample.payload().to_bytes();
            traffic.received += bytes.len();
            received += bytes.len();
            if replies_read > MAX_REPLIES || received > MAX_RECEIVED {
                return Err(ClientError::TooLong { replies: replies_read, bytes: received });
            }
            let reply =
                protocol::decode(format_of(sample.encoding()), &bytes).map_err(ClientError::Unreadable)?;
            if let Some(answer) = collector.add(reply) {
                return answer;
            }
        }
    }
}

fn format_of(encoding: &Encoding) -> Format {
    Format::from_encoding(&encoding.to_string()).unwrap_or_default()
}

/// An error reply of the server, or one that Zenoh itself made, like "Timeout".
fn refusal(encoding: &Encoding, bytes: &[u8]) -> ClientError {
    match protocol::decode::<ErrorReply>(format_of(encoding), bytes) {
        Ok(reply) => ClientError::Refused(reply),
        Err(_) => ClientError::Transport { problem: String::from_utf8_lossy(bytes).into_owned() },
    }
}
