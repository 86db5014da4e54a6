//! Queries between the network and the workers: bounded in number and in bytes.
//!
//! Zenoh calls a queryable from the thread that reads the network, so queries are only enqueued there. If the queue is
//! full, a query is answered with `Busy` at once: overload does not exhaust the server's memory. Matching runs on tokio's
//! blocking threads; a panic there ends one query with an error reply.

use std::sync::Arc;
use std::time::Instant;

use protocol::{ErrorCode, ErrorReply};
use tokio::sync::{Mutex, OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::task::JoinHandle;
use zenoh::query::Query;

use crate::handlers::{self, Kind};
use crate::metrics::ServerMetrics;
use crate::served_map::MapSlot;
use recognition::RecognitionOptions;

/// A query to be answered.
pub(crate) struct Job {
    pub(crate) query: Query,
    pub(crate) kind: Kind,
    pub(crate) map: Arc<MapSlot>,
    pub(crate) received: Instant,
}

/// A job with its reservation of the byte limit.
pub(crate) struct Ticket {
    job: Job,
    _bytes: OwnedSemaphorePermit,
}

/// Waiting queries.
pub(crate) struct Queue {
    sender: std::sync::Mutex<Option<mpsc::Sender<Ticket>>>,
    /// Free part of the byte limit, KiB.
    free_kib: Arc<Semaphore>,
    metrics: Arc<ServerMetrics>,
}

impl Queue {
    /// A queue of at most `length` jobs and `bytes` bytes of payload.
    pub(crate) fn new(
        length: usize,
        bytes: usize,
        metrics: Arc<ServerMetrics>,
    ) -> (Arc<Queue>, mpsc::Receiver<Ticket>) {
        let (sender, receiver) = mpsc::channel(length.max(1));
        let free_kib = Arc::new(Semaphore::new((bytes / 1024).clamp(1, Semaphore::MAX_PERMITS)));
        let sender = std::sync::Mutex::new(Some(sender));
        (Arc::new(Queue { sender, free_kib, metrics }), receiver)
    }

    /// Enqueues a query, or answers it with `Busy`. Never blocks.
    pub(crate) fn put(&self, job: Job) {
        let query = job.query.clone();
        self.metrics.note_received();
        if self.try_put(job).is_none() {
            self.metrics.note_refused();
            let message = "the map server has too many queries, ask again later";
            handlers::fail(&query, &ErrorReply::new(ErrorCode::Busy, message));
        }
    }

    fn try_put(&self, job: Job) -> Option<()> {
        let kib = job.query.payload().map_or(0, zenoh::bytes::ZBytes::len).div_ceil(1024);
        let bytes = Arc::clone(&self.free_kib).try_acquire_many_owned(u32::try_from(kib).ok()?).ok()?;
        let sender = self.sender.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        sender.as_ref()?.try_send(Ticket { job, _bytes: bytes }).ok()
    }

    /// Ends the workers once the queue is empty.
    pub(crate) fn close(&self) {
        self.sender.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take();
    }
}

/// Starts tasks that answer queries of the queue, each one at a time.
pub(crate) fn start_workers(
    jobs: mpsc::Receiver<Ticket>,
    count: usize,
    options: &RecognitionOptions,
    queue: &Arc<Queue>,
) -> Vec<JoinHandle<()>> {
    let jobs = Arc::new(Mutex::new(jobs));
    let options = Arc::new(options.clone());
    let worker = |_| tokio::spawn(work(Arc::clone(&jobs), Arc::clone(&options), Arc::clone(queue)));
    (0..count.max(1)).map(worker).collect()
}

async fn work(jobs: Arc<Mutex<mpsc::Receiver<Ticket>>>, options: Arc<RecognitionOptions>, queue: Arc<Queue>) {
    loop {
        let next = jobs.lock().await.recv().await;
        let Some(ticket) = next else { return };
        let (query, map) = (ticket.job.query.clone(), Arc::clone(&ticket.job.map));
        let (kind, received) = (ticket.job.kind, ticket.job.received);
        let options = Arc::clone(&options);
        let answered = catch_panic(move || {
            let Job { query, kind, map, .. } = &ticket.job;
            handlers::answer(query, *kind, &map.name, &map.current(), &options)
        });
        let answered = answered.await;
        let duration = received.elapsed();
        let note_done = |is_answered| queue.metrics.note_done(&map.name, kind, duration, is_answered);
        let failure = match answered {
            Ok(Ok(())) => {
                note_done(true);
                continue;
            }
            Ok(Err(failure)) => failure,
            Err(panic) => {
                queue.metrics.note_panic();
                tracing::error!(key = query.key_expr().as_str(), "answering a query panicked: {panic}");
                ErrorReply::new(ErrorCode::Internal, "the map server failed on this query; its log says more")
            }
        };
        handlers::fail(&query, &failure);
        note_done(false);
        tracing::debug!(key = query.key_expr().as_str(), "answered with an error: {failure}");
    }
}

/// The message of a panic.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
struct Panicked {
    message: String,
}

/// Runs a job on a blocking thread and catches a panic in it.
async fn catch_panic<T: Send + 'static>(job: impl FnOnce() -> T + Send + 'static) -> Result<T, Panicked> {
    let ended = tokio::task::spawn_blocking(job).await;
    let message = |error: tokio::task::JoinError| match error.try_into_panic() {
        Ok(panic) => {
            let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
            text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "a panic".to_owned())
        }
        Err(cancelled) => cancelled.to_string(),
    };
    ended.map_err(|error| Panicked { message: message(error) })
}

#[cfg(test)]
mod tests {
    use super::{Panicked, catch_panic};

    #[tokio::test]
    async fn a_panic_is_an_error_and_the_next_job_runs() {
        let panicked = catch_panic(|| -> u32 { panic!("job {}", 7) }).await;
        assert_eq!(panicked, Err(Panicked { message: "job 7".to_owned() }));
        assert_eq!(catch_panic(|| 8).await, Ok(8));
    }
}
