//! Large answers that are being sent, limited in their bytes.
//!
//! An answer stays in memory until its reader has taken the last of it. Those that are made for one reader are counted, and
//! where too many are on their way, the next reader waits a while and is then refused.

use axum::body::Bytes;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;

/// Bytes of all answers together that wait for their readers.
pub const MAX_UNSENT_BYTES: usize = 32 << 20;
/// Bytes that are counted as one.
const UNIT: usize = 1024;
/// How long a reader waits for others.
const PATIENCE: Duration = Duration::from_secs(5);

/// Counts the bytes of answers that are being sent.
#[derive(Debug)]
pub(crate) struct Outbox {
    free: Arc<Semaphore>,
    patience: Duration,
}

impl Default for Outbox {
    fn default() -> Self {
        Self::new(PATIENCE)
    }
}

fn units(bytes: usize) -> usize {
    bytes.div_ceil(UNIT)
}

impl Outbox {
    fn new(patience: Duration) -> Self {
        Self { free: Arc::new(Semaphore::new(units(MAX_UNSENT_BYTES))), patience }
    }

    /// Room for an answer of about so many bytes; `None` where there is none for a while.
    pub(crate) async fn reserve(&self, bytes: usize) -> Option<Room> {
        let wanted = units(bytes.min(MAX_UNSENT_BYTES)) as u32;
        let acquiring = Arc::clone(&self.free).acquire_many_owned(wanted);
        let permit = timeout(self.patience, acquiring).await.ok()?.ok()?;
        Some(Room { free: Arc::clone(&self.free), permit })
    }
}

/// Room for an answer.
pub(crate) struct Room {
    free: Arc<Semaphore>,
    permit: OwnedSemaphorePermit,
}

impl Room {
    /// The answer, which takes its room until the last of it is dropped; `None` where it is longer than announced, and there
    /// is no more room.
    pub(crate) fn hold(mut self, answer: Vec<u8>) -> Option<Bytes> {
        let (needed, has) = (units(answer.len()), self.permit.num_permits());
        if needed > has {
            let more = Arc::clone(&self.free).try_acquire_many_owned((needed - has) as u32).ok()?;
            self.permit.merge(more);
        } else {
            drop(self.permit.split(has - needed));
        }
        Some(Bytes::from_owner(Held { answer: answer.into_boxed_slice(), _permit: self.permit }))
    }
}

struct Held {
    answer: Box<[u8]>,
    _permit: OwnedSemaphorePermit,
}

impl AsRef<[u8]> for Held {
    fn as_ref(&self) -> &[u8] {
        &self.answer
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn answers_are_limited_in_their_bytes_until_they_are_dropped() {
        let outbox = Outbox::new(Duration::from_millis(20));
        let mut held = Vec::new();
        while let Some(room) = outbox.reserve(5 << 20).await {
            // It is shorter than announced, and takes no more than its length.
            held.push(room.hold(vec![0; 2 << 20]).unwrap());
        }
        let bytes: usize = held.iter().map(Bytes::len).sum();
        assert!((MAX_UNSENT_BYTES - (5 << 20)..=MAX_UNSENT_BYTES).contains(&bytes), "{bytes}");
        // A part keeps the whole.
        let part = held.pop().unwrap().slice(..1);
        assert!(outbox.reserve(5 << 20).await.is_none());
        drop(part);
        held.pop();
        assert!(outbox.reserve(5 << 20).await.is_some());
    }

    #[tokio::test]
    async fn an_answer_that_is_longer_than_announced_needs_more_room() {
        let outbox = Outbox::new(Duration::from_millis(20));
        let first = outbox.reserve(UNIT).await.unwrap().hold(vec![0; MAX_UNSENT_BYTES - UNIT]).unwrap();
        let second = outbox.reserve(UNIT).await.unwrap();
        assert!(second.hold(vec![0; UNIT + 1]).is_none());
        drop(first);
        assert!(outbox.reserve(MAX_UNSENT_BYTES).await.is_some());
    }
}
