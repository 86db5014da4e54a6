//! Queries between the network and the workers: bounded in number and in bytes, and fair to clients.
//!
//! Zenoh calls a queryable from the thread that reads the network, so queries are only enqueued there. If the queue is
//! full, a query of the client with the most waiting bytes is answered with `Busy` at once: overload does not exhaust the
//! server's memory, and whoever causes it pays for it.
//!
//! A client is the session that it states, where that is connected, or the subject of its certificate (`senders`); whoever states
//! another name shares one place with all that do. What a query costs beyond its bytes is charged to its client when it is known.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use protocol::{ErrorCode, ErrorReply, keys};
use tokio::sync::Semaphore;
use zenoh::query::Query;

use crate::cells::{CellSlot, StoredCell};
use crate::fair_queue::{self, Client, FairQueue};
use crate::handlers;
use crate::kind::{CellKind, Kind};
use crate::metrics::ServerMetrics;
use crate::reports::ReportSender;
use crate::routing::RoutedMap;
use crate::senders::Senders;
use crate::served_map::MapSlot;
use recognition::LoadedMap;

/// So long a query waits for a cell that is not in memory; then it is asked again, or another server is.
const LONGEST_WAIT: Duration = Duration::from_secs(1);

/// A query to be answered.
pub(crate) struct Job {
    pub(crate) query: Query,
    pub(crate) target: Target,
    pub(crate) client: Client,
    pub(crate) received: Instant,
    /// From when on nobody waits for a first reply, where the client states it.
    pub(crate) expires: Option<Instant>,
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
    pub(crate) fn is_expired(&self) -> bool {
        self.begun.is_none() && self.expires.is_some_and(|expires| expires <= Instant::now())
    }

    /// Bytes of its payload.
    pub(crate) fn bytes(&self) -> usize {
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
    waiting: Mutex<Waiting>,
    /// A job was added, or the queue was closed.
    changed: Condvar,
    metrics: Arc<ServerMetrics>,
    pub(crate) reports: ReportSender,
    senders: Arc<Senders>,
    /// Places for queries that wait for a cell, in bytes: as much as the queue has.
    set_aside: Arc<Semaphore>,
}

struct Waiting {
    jobs: FairQueue<Job>,
    /// No more are taken in.
    is_closed: bool,
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
            waiting: Mutex::new(Waiting { jobs: FairQueue::new(length, bytes), is_closed: false }),
            changed: Condvar::new(),
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
    pub(crate) fn enqueue(&self, job: Job, bytes: usize) {
        let client = job.client.clone();
        let refused = {
            let mut waiting = self.lock();
            if waiting.is_closed { vec![job] } else { waiting.jobs.put(&client, bytes, job) }
        };
        self.changed.notify_one();
        for job in &refused {
            self.refuse(job);
        }
    }

    pub(crate) fn refuse(&self, job: &Job) {
        let Job { query, target, received, .. } = job;
        self.metrics.note_refused();
        let message = "the map server has too many queries, ask again later";
        let error = ErrorReply::new(ErrorCode::Busy, message);
        handlers::fail(query, &error);
        self.reports.note(query, target.kind(), target.name(), *received, || Err(error));
    }

    /// The next job, as soon as there is one; `None` once the queue is closed and empty.
    pub(crate) fn take(&self) -> Option<Job> {
        let mut waiting = self.lock();
        loop {
            let next = waiting.jobs.take();
            if next.is_some() || waiting.is_closed {
                return next;
            }
            waiting = self.changed.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Charges the client of a query with the time of a worker.
    pub(crate) fn charge(&self, client: &Client, bytes: usize, elapsed: Duration) {
        let extra = fair_queue::extra_cost(bytes, elapsed);
        if extra > 0 {
            self.lock().jobs.charge(client, extra);
        }
    }

    /// Ends the workers once the queue is empty.
    pub(crate) fn close(&self) {
        self.lock().is_closed = true;
        self.changed.notify_all();
    }
}

impl Queue {
    /// Sets a query aside until its cell is in memory, and enqueues it again. No worker waits.
    pub(crate) fn await_cell(self: &Arc<Self>, job: Job, cell: Arc<StoredCell>) {
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
    pub(crate) fn note_end(
        &self,
        query: &Query,
        target: &Target,
        received: Instant,
        answered: Result<(), ErrorReply>,
    ) {
        let is_answered = answered.is_ok();
        if let Err(failure) = answered {
            handlers::fail(query, &failure);
            tracing::debug!(key = query.key_expr().as_str(), "answered with an error: {failure}");
            self.reports.note(query, target.kind(), target.name(), received, || Err(failure));
        }
        self.metrics.note_done(target.name(), target.metric(), received.elapsed(), is_answered);
    }

    /// The error of a query whose answering panicked.
    pub(crate) fn panicked(&self, query: &Query, panic: &str) -> ErrorReply {
        self.metrics.note_panic();
        tracing::error!(key = query.key_expr().as_str(), "answering a query panicked: {panic}");
        ErrorReply::new(ErrorCode::Internal, "the map server failed on this query; its log says more")
    }
}
