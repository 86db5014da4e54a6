//! Match queries in the background, for a thread that must not block.

use crate::error::ClientError;
use crate::map_client::{MapClient, MatchAnswer};
use crate::request::{Retry, Traffic};
use protocol::MatchRequest;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};
use tokio::runtime::Handle;

/// How much longer than the deadline a task may take to report; then its query has ended without an answer.
const REPORT_TIMEOUT: Duration = Duration::from_secs(1);

/// The end of one query.
#[derive(Debug)]
pub struct QueryResult<T> {
    /// The caller's token of the query.
    pub token: T,
    /// The request.
    pub request: Arc<MatchRequest>,
    /// The answer, "no match" included, or why there is none.
    pub answer: Result<MatchAnswer, ClientError>,
    /// Time from submission to the end of the query.
    pub elapsed: Duration,
    /// Payload bytes sent, repetitions included.
    pub bytes_sent: usize,
    /// Payload bytes received.
    pub bytes_received: usize,
}

/// What a task reports.
#[derive(Debug)]
struct Report {
    /// Of the query.
    number: u64,
    answer: Result<MatchAnswer, ClientError>,
    elapsed: Duration,
    traffic: Traffic,
}

/// A query whose task has not reported.
#[derive(Debug)]
struct Pending<T> {
    token: T,
    request: Arc<MatchRequest>,
    begin: Instant,
}

/// Sends match queries as tasks of a tokio runtime and returns their results through a channel.
///
/// `T` is a token by which the caller recognizes a query, for example the id of the camera pose it is about. Every
/// submitted query has exactly one result, even if its task panics or never ends: a second after the deadline it is
/// [`ClientError::Deadline`].
///
/// # Example
/// ```
/// use client::{ClientError, MapClient, QueryTasks, SessionOptions, open_session};
/// use std::time::Duration;
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
/// let session = runtime.block_on(open_session(&SessionOptions::default()))?;
/// let hall = MapClient::new(session, "hall")?;
/// let mut queries = QueryTasks::new(hall, runtime.handle().clone(), Duration::from_millis(100));
/// let request = protocol::decode(protocol::Format::Json, br#"{
///     "schema": 10, "robot": "ada", "stamp_ns": 0, "max_keyframes": 4,
///     "camera": {"width": 640, "height": 480, "focal": [500, 500], "centre": [319.5, 239.5], "distortion": "none"},
///     "features": {"pixels": [[10, 20]], "descriptors": {"kind": "binary", "width": 2, "hex": ["a0ff"]}}
/// }"#)?;
/// queries.submit(7, request); // returns at once
/// assert_eq!(queries.pending(), 1);
/// let result = queries.wait().ok_or("no result")?;
/// assert_eq!(result.token, 7);
/// assert!(matches!(result.answer, Err(ClientError::NoServer)));
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct QueryTasks<T> {
    client: MapClient,
    runtime: Handle,
    deadline: Duration,
    sender: Sender<Report>,
    receiver: Receiver<Report>,
    /// By number, the oldest first.
    pending: BTreeMap<u64, Pending<T>>,
    /// Number of the next query.
    next: u64,
    /// Whether the last query found no server: then the next one is sent once only, so that queries of a robot without
    /// a server do not accumulate.
    no_server: bool,
    /// Whether it was logged that the server does not serve the map.
    unknown_map_logged: bool,
}

impl<T: Send + 'static> QueryTasks<T> {
    /// Queries to the map of `client`.
    ///
    /// # Arguments
    /// * `runtime`: the multi-threaded runtime of the session.
    /// * `deadline`: time from the submission of a query to its end.
    pub fn new(client: MapClient, runtime: Handle, deadline: Duration) -> Self {
        let (sender, receiver) = channel();
        Self {
            client,
            runtime,
            deadline,
            sender,
            receiver,
            pending: BTreeMap::new(),
            next: 0,
            no_server: false,
            unknown_map_logged: false,
        }
    }

    /// Sends a query and returns at once.
    pub fn submit(&mut self, token: T, request: MatchRequest) {
        let (client, runtime, sender) = (self.client.clone(), self.runtime.clone(), self.sender.clone());
        let (deadline, number, begin) = (self.deadline, self.next, Instant::now());
        self.next += 1;
        let retry = if self.no_server { Retry::Never } else { Retry::Transient };
        let request = Arc::new(request);
        self.pending.insert(number, Pending { token, request: Arc::clone(&request), begin });
        self.runtime.spawn(async move {
            // A task of its own: if it panics, the query still has a result.
            let task = runtime.spawn(async move {
                let mut traffic = Traffic::default();
                let answer =
                    client.match_image_counted(&request, begin + deadline, retry, &mut traffic).await;
                (answer, traffic)
            });
            let (answer, traffic) = task.await.unwrap_or_else(|error| {
                (Err(ClientError::TaskFailed { problem: error.to_string() }), Traffic::default())
            });
            // Without a receiver the run is over.
            let _ = sender.send(Report { number, answer, elapsed: begin.elapsed(), traffic });
        });
    }

    /// Number of queries without a result yet.
    pub fn pending(&self) -> usize {
        self.pending.len()
    }

    /// The next result that is available now.
    pub fn poll(&mut self) -> Option<QueryResult<T>> {
        while let Ok(report) = self.receiver.try_recv() {
            if let Some(result) = self.take(report) {
                return Some(result);
            }
        }
        self.expired()
    }

    /// Blocks until the next result; `None` if no query is pending. For playback that pauses the recording meanwhile.
    pub fn wait(&mut self) -> Option<QueryResult<T>> {
        while self.pending() > 0 {
            let taken = self.wait_at_most(self.deadline + REPORT_TIMEOUT);
            if taken.is_some() {
                return taken;
            }
        }
        None
    }

    /// The same, but blocks no longer than `most`; `None` also where no result came in that time.
    pub fn wait_at_most(&mut self, most: Duration) -> Option<QueryResult<T>> {
        let (_, oldest) = self.pending.first_key_value()?;
        let limit = (self.deadline + REPORT_TIMEOUT).saturating_sub(oldest.begin.elapsed());
        match self.receiver.recv_timeout(limit.min(most)) {
            Ok(report) => self.take(report),
            Err(_) => self.expired(),
        }
    }

    /// The result that a task reports; `None` for a query that had ended before.
    fn take(&mut self, report: Report) -> Option<QueryResult<T>> {
        let Report { number, answer, elapsed, traffic } = report;
        let Pending { token, request, .. } = self.pending.remove(&number)?;
        let (bytes_sent, bytes_received) = (traffic.sent, traffic.received);
        Some(self.note(QueryResult { token, request, answer, elapsed, bytes_sent, bytes_received }))
    }

    /// The oldest query, where its task should have reported by now.
    fn expired(&mut self) -> Option<QueryResult<T>> {
        let (&number, oldest) = self.pending.first_key_value()?;
        let elapsed = oldest.begin.elapsed();
        if elapsed < self.deadline + REPORT_TIMEOUT {
            return None;
        }
        let answer = Err(ClientError::Deadline);
        self.take(Report { number, answer, elapsed, traffic: Traffic::default() })
    }

    /// Learns from a result how the next query is to be sent.
    fn note(&mut self, result: QueryResult<T>) -> QueryResult<T> {
        self.no_server = result.answer.is_err() && result.bytes_received == 0;
        if let Err(error) = &result.answer
            && error.is_unknown_map()
            && !std::mem::replace(&mut self.unknown_map_logged, true)
        {
            tracing::warn!(
                map = self.client.map(),
                "{error}; name a map of this server with --map, or start the server with this map too (map_server --map \
                 NAME=DB): until then no match query is answered"
            );
        }
        result
    }
}
