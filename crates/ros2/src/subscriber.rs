//! A subscriber.

use super::attachment::Attachment;
use super::error::RosError;
use super::history::{Newest, ReceivedHistory};
use super::qos::Durability;
use ros_messages::{CdrError, RosMessage, decode};
use std::sync::Arc;
use std::time::{Instant, SystemTime};
use zenoh::Session;
use zenoh::handlers::{Callback, IntoHandler, RingChannel, RingChannelHandler};
use zenoh::liveliness::LivelinessToken;
use zenoh::sample::Sample;

/// A message with what is known of its way.
#[derive(Debug)]
pub struct Received<M> {
    /// The message, or why its bytes are none.
    pub message: Result<M, CdrError>,
    /// When it arrived, by the clock that only runs forward.
    pub arrived: Instant,
    /// When it arrived, by the clock of day.
    pub arrived_at: SystemTime,
    /// Number, time and sender; `None` where the sender is no node of `rmw_zenoh`.
    pub attachment: Option<Attachment>,
}

/// Receives messages of one type from one topic, in the order of their arrival.
#[derive(Debug)]
pub struct Subscriber<M> {
    samples: zenoh::pubsub::Subscriber<RingChannelHandler<Received<M>>>,
    _history: Option<ReceivedHistory>,
    _token: Option<LivelinessToken>,
}

impl<M: RosMessage + Send + 'static> Subscriber<M> {
    pub(crate) async fn declare(
        session: &Session,
        key: String,
        capacity: usize,
        durability: Durability,
    ) -> Result<Self, RosError> {
        let (queue, handler) = IntoHandler::<Received<M>>::into_handler(RingChannel::new(capacity));
        let newest = Newest::default();
        let is_latched = durability == Durability::TransientLocal;
        let receive: Arc<dyn Fn(&Sample) + Send + Sync> = Arc::new(move |sample: &Sample| {
            let received = received(sample);
            if !is_latched || newest.is_new(received.attachment.as_ref()) {
                queue.call(received);
            }
        });
        let live = {
            let receive = Arc::clone(&receive);
            Callback::from(move |sample: Sample| receive(&sample))
        };
        let samples = session.declare_subscriber(key.clone()).with((live, handler)).await;
        let samples = samples.map_err(RosError::zenoh("the subscriber cannot be declared"))?;
        let history =
            if is_latched { Some(ReceivedHistory::fetch(session, &key, &receive).await?) } else { None };
        Ok(Self { samples, _history: history, _token: None })
    }

    /// Keeps the token by which others see it.
    pub(crate) fn announced(self, token: LivelinessToken) -> Self {
        Self { _token: Some(token), ..self }
    }

    /// Waits for the next message.
    ///
    /// # Errors
    /// [`RosError`]: the session is closed.
    pub async fn receive(&self) -> Result<Received<M>, RosError> {
        self.samples.recv_async().await.map_err(RosError::zenoh("there will be no more messages"))
    }

    /// The next message, if it is there.
    ///
    /// # Errors
    /// [`RosError`]: the session is closed.
    pub fn try_receive(&self) -> Result<Option<Received<M>>, RosError> {
        self.samples.try_recv().map_err(RosError::zenoh("there will be no more messages"))
    }
}

/// Decodes on the thread that receives: bytes are copied once, images are not decompressed.
fn received<M: RosMessage>(sample: &Sample) -> Received<M> {
    let (arrived, arrived_at) = (Instant::now(), SystemTime::now());
    let attachment = sample.attachment().and_then(|bytes| Attachment::from_bytes(&bytes.to_bytes()));
    Received { message: decode(&sample.payload().to_bytes()), arrived, arrived_at, attachment }
}
