//! A publisher.

use super::attachment::Attachment;
use super::error::RosError;
use super::history::PublishedHistory;
use super::liveliness::GID_BYTES;
use ros_messages::{RosMessage, encode};
use std::marker::PhantomData;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::SystemTime;
use zenoh::liveliness::LivelinessToken;

/// Publishes messages of one type on one topic. Other nodes see it as long as it exists.
#[derive(Debug)]
pub struct Publisher<M> {
    samples: zenoh::pubsub::Publisher<'static>,
    /// For subscribers that come later, where the topic is transient local.
    history: Option<PublishedHistory>,
    _token: LivelinessToken,
    gid: [u8; GID_BYTES],
    sent: AtomicI64,
    message: PhantomData<fn(M)>,
}

impl<M: RosMessage> Publisher<M> {
    pub(crate) fn new(
        samples: zenoh::pubsub::Publisher<'static>,
        history: Option<PublishedHistory>,
        token: LivelinessToken,
        gid: [u8; GID_BYTES],
    ) -> Self {
        Self { samples, history, _token: token, gid, sent: AtomicI64::new(0), message: PhantomData }
    }

    /// Whether a subscriber listens to the topic.
    ///
    /// # Errors
    /// [`RosError`]: the session is closed.
    pub async fn is_matched(&self) -> Result<bool, RosError> {
        let status = self.samples.matching_status().await;
        Ok(status.map_err(RosError::zenoh("the subscribers of a topic are not known"))?.matching())
    }

    /// Sends a message. On a congested network it is dropped, for newer ones follow, unless the topic's quality of service is
    /// [`Qos::every_message`](crate::Qos::every_message).
    ///
    /// # Errors
    /// [`RosError`]: the message cannot be written, or the session is closed.
    pub async fn publish(&self, message: &M) -> Result<(), RosError> {
        let attachment = Attachment {
            sequence_number: self.sent.fetch_add(1, Ordering::Relaxed) + 1,
            source_stamp_ns: now_ns(),
            gid: self.gid,
        };
        let (payload, attachment) = (encode(message)?, attachment.to_bytes());
        if let Some(history) = &self.history {
            history.keep(payload.clone(), attachment);
        }
        let put = self.samples.put(payload).attachment(attachment);
        put.await.map_err(RosError::zenoh("the message cannot be published"))
    }
}

fn now_ns() -> i64 {
    let since_epoch = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    since_epoch.as_nanos() as i64
}
