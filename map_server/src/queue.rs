//! Queries between the network and the workers: bounded in number and in bytes, and fair to clients.
//!
//! Zenoh calls a queryable from the thread that reads the network, so queries are only enqueued there. If the queue is
//! full, a query of the client with the most waiting bytes is answered with `Busy` at once: overload does not exhaust the
//! server's memory, and whoever causes it pays for it. Matching runs on tokio's blocking threads; a panic there ends one
//! query with an error reply.
//!
//! A client is the session that it states, where that is connected, or the subject of its certificate (`senders`); whoever states
//! another name shares one place with all that do. What a query costs beyond its bytes is charged to its client when it is known.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use protocol::{ErrorCode, ErrorReply, keys};
use tokio::sync::{Notify, Semaphore};
use tokio::task::JoinHandle;
use zenoh::query::Query;

use crate::cells::{CellSlot, StoredCell};
use crate::fair_queue::{self, Client, FairQueue};
use crate::handlers::{self, Progress, ReceivedQuery};
use crate::kind::{CellKind, Kind, Subject};
use crate::metrics::ServerMetrics;
use crate::reports::ReportSender;
use crate::routing::RoutedMap;
use crate::senders::Senders;
use crate::served_map::MapSlot;
use recognition::{LoadedMap, RecognitionOptions};

/// So long a query waits for a cell that is not in memory; then it is asked again, or another server is.
const LONGEST_WAIT: Duration = Duration::from_secs(1);

/// A query to be answered.
pub(crate) struct Job {
    pub(crate) query: Query,
    pub(crate) target: Target,
    client: Client,
    pub(crate) received: Instant,
    /// From when on nobody waits for a first reply, where the client states it.
    expires: Option<Instant>,
    /// The version that the query is answered with, and how many of its keyframes a query for all of them got in its former
    /// turns. `None` for one that is still to be had.
    pub(crate) begun: Option<(Arc<LoadedMap>, usize)>,
}

impl Job {
    /// A query that was just received.
    pub(crate) fn new(query: Query, target: Target) -> Self {
        let client = Client::Stated(String::new());
        let received = Instant::now();
        let patience = query.parameters().get(keys::PATIENCE_PARAMETER);
        let patience = patience.and_then(|stated| stated.parse().ok()).map(Duration::from_millis);
        let expires = patience.and_then(|patience| received.checked_add(patience));
        Self { query, target, client, received, expires, begun: None }
    }

    /// Whether nobody waits for its first reply any more.
    fn is_expired(&self) -> bool {
        self.begun.is_none() && self.expires.is_some_and(|expires| expires <= Instant::now())
    }

    /// Bytes of its payload.
    fn bytes(&self) -> usize {
        self.query.payload().map_or(0, zenoh::bytes::ZBytes::len)
    }
}

/// Who answers a query, of which kind.
#[derive(Clone)]
pub(crate) enum Target {
    /// A map in memory.
    Map(Kind, Arc<MapSlot>),
    /// A cell of a map, in memory or not.
    Cell(CellKind, Arc<CellSlot>),
    /// Cells, here and elsewhere.
    Routed(Kind, Arc<RoutedMap>),
}

impl Target {
    /// Name of the map.
    pub(crate) fn name(&self) -> &str {
        match self {
            Target::Map(_, slot) => &slot.name,
            Target::Cell(_, slot) => &slot.name,
            Target::Routed(_, routed) => &routed.name,
        }
    }

    fn kind(&self) -> Kind {
        match self {
            Target::Map(kind, _) | Target::Routed(kind, _) => *kind,
            Target::Cell(kind, _) => kind.of_map(),
        }
    }

    /// The kind of a query in metrics.
    fn metric(&self) -> &'static str {
        match self {
            Target::Map(kind, _) | Target::Routed(kind, _) => kind.name(),
            Target::Cell(kind, _) => kind.name(),
        }
    }
}

/// Waiting queries.
pub(crate) struct Queue {
    waiting: Mutex<FairQueue<Job>>,
    closed: AtomicBool,
    /// A job was added, or the queue was closed.
    changed: Notify,
    metrics: Arc<ServerMetrics>,
    reports: ReportSender,
    senders: Arc<Senders>,
    /// Places for queries that wait for a cell, in bytes: as much as the queue has.
    set_aside: Arc<Semaphore>,
}

impl Queue {
    /// A queue of at most `length` jobs and `bytes` bytes of payload.
    pub(crate) fn new(
        length: usize,
        bytes: usize,
        metrics: Arc<ServerMetrics>,
        reports: ReportSender,
        senders: Arc<Senders>,
    ) -> Arc<Queue> {
        let places = fair_queue::capacity_of(length, bytes);
        Arc::new(Queue {
            waiting: Mutex::new(FairQueue::new(length, bytes)),
            closed: AtomicBool::new(false),
            changed: Notify::new(),
            metrics,
            reports,
            senders,
            set_aside: Arc::new(Semaphore::new(places.min(Semaphore::MAX_PERMITS))),
        })
    }

    /// Enqueues a query; answers those that do not fit with `Busy`. Never blocks.
    pub(crate) fn put(&self, mut job: Job) {
        self.metrics.note_received();
        let stated = job.query.parameters().get(keys::CLIENT_PARAMETER).unwrap_or_default();
        job.client = self.senders.client(stated);
        let bytes = job.bytes();
        self.enqueue(job, bytes);
    }

    /// Enqueues a job whose next turn counts as so many bytes.
    fn enqueue(&self, job: Job, bytes: usize) {
        let client = job.client.clone();
        let refused = if self.closed.load(Ordering::Acquire) {
            vec![job]
        } else {
            self.lock().put(&client, bytes, job)
        };
        self.changed.notify_one();
        for job in &refused {
            self.refuse(job);
        }
    }

    fn refuse(&self, job: &Job) {
        let Job { query, target, received, .. } = job;
        self.metrics.note_refused();
        let message = "the map server has too many queries, ask again later";
        let error = ErrorReply::new(ErrorCode::Busy, message);
        handlers::fail(query, &error);
        self.reports.note(query, target.kind(), target.name(), *received, || Err(error));
    }

    /// The next job; `None` once the queue is closed and empty.
    async fn take(&self) -> Option<Job> {
        loop {
            let closed = self.closed.load(Ordering::Acquire);
            let (next, is_empty) = {
                let mut waiting = self.lock();
                (waiting.take(), waiting.is_empty())
            };
            if closed || !is_empty {
                // One notification may stand for several changes.
                self.changed.notify_one();
            }
            if next.is_some() || closed {
                return next;
            }
            self.changed.notified().await;
        }
    }

    fn lock(&self) -> MutexGuard<'_, FairQueue<Job>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Charges the client of a query with the time of a worker.
    fn charge(&self, client: &Client, bytes: usize, elapsed: Duration) {
        let extra = fair_queue::extra_cost(bytes, elapsed);
        if extra > 0 {
            self.lock().charge(client, extra);
        }
    }

    /// Ends the workers once the queue is empty.
    pub(crate) fn close(&self) {
        self.closed.store(true, Ordering::Release);
        self.changed.notify_one();
    }
}

/// Starts tasks that answer queries of the queue, each one at a time.
pub(crate) fn start_workers(
    queue: &Arc<Queue>,
    count: usize,
    options: &RecognitionOptions,
) -> Vec<JoinHandle<()>> {
    let options = Arc::new(options.clone());
    let worker = |_| tokio::spawn(work(Arc::clone(queue), Arc::clone(&options)));
    (0..count.max(1)).map(worker).collect()
}

async fn work(queue: Arc<Queue>, options: Arc<RecognitionOptions>) {
    while let Some(mut job) = queue.take().await {
        if job.is_expired() {
            queue.refuse(&job);
            continue;
        }
        let begun = job.begun.take();
        match job.target.clone() {
            Target::Map(kind, slot) => {
                let begun = begun.unwrap_or_else(|| (slot.current(), 0));
                answer(&queue, job, Subject::Map(kind), begun, &options).await;
            }
            Target::Cell(kind, slot) => {
                let cell = slot.current();
                match begun.or_else(|| Some((cell.if_in_memory()?, 0))) {
                    Some(begun) => {
                        answer(&queue, job, Subject::Cell(kind, slot.cell), begun, &options).await;
                        cell.memory().trim();
                    }
                    None => queue.await_cell(job, cell),
                }
            }
            Target::Routed(kind, routed) => route(&queue, job, kind, routed).await,
        }
    }
}

/// Answers a query with a map that is in memory.
async fn answer(
    queue: &Arc<Queue>,
    job: Job,
    subject: Subject,
    (loaded, sent): (Arc<LoadedMap>, usize),
    options: &Arc<RecognitionOptions>,
) {
    let (bytes, begin) = (job.bytes(), Instant::now());
    let Job { query, target, client, received, .. } = job;
    let name = target.name().to_owned();
    let asked = ReceivedQuery { query: query.clone(), subject, name, received, sent };
    let (version, options, reports) = (Arc::clone(&loaded), Arc::clone(options), queue.reports.clone());
    let answered = catch_panic(move || handlers::answer(&asked, &version, &options, &reports)).await;
    queue.charge(&client, bytes, begin.elapsed());
    match answered {
        Ok(Ok(Progress::Keyframes { sent, bytes })) => {
            queue.enqueue(
                Job { query, target, client, received, expires: None, begun: Some((loaded, sent)) },
                bytes,
            );
        }
        Ok(Ok(Progress::Done)) => queue.note_end(&query, &target, received, Ok(())),
        Ok(Err(failure)) => queue.note_end(&query, &target, received, Err(failure)),
        Err(panic) => queue.note_end(&query, &target, received, Err(queue.panicked(&query, &panic))),
    }
}

/// Plans with a worker, and asks cells without one.
async fn route(queue: &Arc<Queue>, job: Job, kind: Kind, routed: Arc<RoutedMap>) {
    let (bytes, begin) = (job.bytes(), Instant::now());
    let Job { query, target, client, received, .. } = job;
    let (planning, asked) = (Arc::clone(&routed), query.clone());
    let planned = catch_panic(move || planning.plan(&asked, kind, received)).await;
    queue.charge(&client, bytes, begin.elapsed());
    let plan = match planned {
        Ok(Ok(plan)) => plan,
        Ok(Err(failure)) => return queue.note_end(&query, &target, received, Err(failure)),
        Err(panic) => {
            let failure = queue.panicked(&query, &panic);
            return queue.note_end(&query, &target, received, Err(failure));
        }
    };
    let queue = Arc::clone(queue);
    tokio::spawn(async move {
        let answered = routed.answer(plan).await;
        queue.note_end(&query, &target, received, answered);
    });
}

impl Queue {
    /// Sets a query aside until its cell is in memory, and enqueues it again. No worker waits.
    fn await_cell(self: &Arc<Self>, job: Job, cell: Arc<StoredCell>) {
        let bytes = job.bytes();
        let cost = u32::try_from(fair_queue::cost_of(bytes)).unwrap_or(u32::MAX);
        let Ok(place) = Arc::clone(&self.set_aside).try_acquire_many_owned(cost) else {
            return self.refuse(&job);
        };
        let queue = Arc::clone(self);
        tokio::spawn(async move {
            let brought = cell.bring(LONGEST_WAIT).await;
            drop(place);
            match brought {
                Ok(loaded) => queue.enqueue(Job { begun: Some((loaded, 0)), ..job }, bytes),
                Err(failure) => {
                    let Job { query, target, received, .. } = job;
                    queue.note_end(&query, &target, received, Err(failure));
                }
            }
        });
    }

    /// Sends the error of a query that failed, and counts the query.
    fn note_end(&self, query: &Query, target: &Target, received: Instant, answered: Result<(), ErrorReply>) {
        let is_answered = answered.is_ok();
        if let Err(failure) = answered {
            handlers::fail(query, &failure);
            tracing::debug!(key = query.key_expr().as_str(), "answered with an error: {failure}");
            self.reports.note(query, target.kind(), target.name(), received, || Err(failure));
        }
        self.metrics.note_done(target.name(), target.metric(), received.elapsed(), is_answered);
    }

    fn panicked(&self, query: &Query, panic: &Panicked) -> ErrorReply {
        self.metrics.note_panic();
        tracing::error!(key = query.key_expr().as_str(), "answering a query panicked: {panic}");
        ErrorReply::new(ErrorCode::Internal, "the map server failed on this query; its log says more")
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
