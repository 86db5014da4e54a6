//! Serving a router: connections are limited in number, headers in time.
//!
//! Where all places are taken, a connection gives way that had no answer yet, the oldest first, then one on which nothing moves:
//! whoever opens connections and asks nothing, or byte by byte, keeps nobody out.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::task::{AbortHandle, JoinSet};
use tokio::time::Instant;

use crate::activity::Activity;
use crate::connection::LimitedConnection;

/// Connections at the same time; beyond, one that waits for nothing gives way, or the new one is closed.
pub const MAX_CONNECTIONS: usize = 128;

/// From the begin of a connection, or from an answer, to the end of the next request's header.
pub const HEADER_TIME: Duration = Duration::from_secs(10);

/// A connection on which nothing moved for so long gives way where all places are taken. Open pages are sent robots more often.
const QUIET: Duration = Duration::from_secs(10);

/// Pause after a connection could not be accepted: the process has no file descriptors left.
const PAUSE: Duration = Duration::from_millis(100);

/// Longest wait for the place of a connection that gave way.
const PLACE_TIME: Duration = Duration::from_millis(200);

/// Serves a router until it is dropped; then all connections are closed.
///
/// # Arguments
/// * `router`: a request is answered as it says; its body is not limited here.
pub async fn serve(listener: TcpListener, router: Router) {
    serve_within(HEADER_TIME, listener, router).await;
}

async fn serve_within(header_time: Duration, listener: TcpListener, router: Router) {
    let free = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    let mut connections = Connections { header_time, tasks: JoinSet::new(), open: Vec::new() };
    loop {
        let (stream, address) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::warn!("a connection was not accepted: {error}");
                tokio::time::sleep(PAUSE).await;
                continue;
            }
        };
        connections.leave_out_ended();
        if free.available_permits() == 0 && !connections.end_one() {
            tracing::debug!(%address, "closed: {MAX_CONNECTIONS} connections are in use");
            continue;
        }
        let place = tokio::time::timeout(PLACE_TIME, Arc::clone(&free).acquire_owned()).await;
        let Ok(Ok(permit)) = place else { continue };
        connections.start(stream, address, permit, router.clone());
    }
}

/// The open connections, in the order in which they came.
struct Connections {
    /// From the begin, or from an answer, to the end of the next header.
    header_time: Duration,
    tasks: JoinSet<()>,
    open: Vec<(AbortHandle, Arc<Activity>)>,
}

impl Connections {
    fn start(
        &mut self,
        stream: TcpStream,
        address: SocketAddr,
        permit: tokio::sync::OwnedSemaphorePermit,
        router: Router,
    ) {
        let activity = Arc::new(Activity::new());
        let connection = TokioIo::new(LimitedConnection::new(stream, Arc::clone(&activity), permit));
        let header_time = self.header_time;
        let task = self.tasks.spawn(async move {
            let serving = http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(header_time)
                .serve_connection(connection, TowerToHyperService::new(router))
                .with_upgrades();
            if let Err(error) = serving.await {
                tracing::debug!(%address, "a connection ended: {error}");
            }
        });
        self.open.push((task, activity));
    }

    fn leave_out_ended(&mut self) {
        while self.tasks.try_join_next().is_some() {}
        self.open.retain(|(task, _)| !task.is_finished());
    }

    /// Ends the connection that is missed least; whether there was one.
    fn end_one(&mut self) -> bool {
        let unanswered = self.open.iter().position(|(_, activity)| !activity.was_answered());
        let quiet = || {
            let now = Instant::now();
            let idle = |activity: &Activity| now.saturating_duration_since(activity.last());
            let all = self.open.iter().enumerate().map(|(at, (_, activity))| (idle(activity), at));
            all.max().filter(|(idle, _)| *idle > QUIET).map(|(_, at)| at)
        };
        let Some(at) = unanswered.or_else(quiet) else { return false };
        self.open.remove(at).0.abort();
        true
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use axum::routing::get;
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};

    async fn start(header_time: Duration) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let router = Router::new().route("/health", get(|| async { "well" }));
        tokio::spawn(serve_within(header_time, listener, router));
        address
    }

    async fn is_well(address: SocketAddr) -> bool {
        let mut stream = TcpStream::connect(address).await.unwrap();
        let request = b"GET /health HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n";
        let mut text = String::new();
        stream.write_all(request).await.is_ok()
            && stream.read_to_string(&mut text).await.is_ok()
            && text.ends_with("well")
    }

    #[tokio::test]
    async fn half_requests_keep_nobody_out() {
        let address = start(HEADER_TIME).await;
        let mut half = Vec::new();
        for _ in 0..MAX_CONNECTIONS + 10 {
            let mut stream = TcpStream::connect(address).await.unwrap();
            stream.write_all(b"GET /he").await.unwrap();
            half.push(stream);
        }
        for _ in 0..20 {
            let asked = Instant::now();
            assert!(is_well(address).await);
            assert!(asked.elapsed() < HEADER_TIME / 2, "{:?}", asked.elapsed());
        }
    }

    #[tokio::test]
    async fn a_header_that_comes_byte_by_byte_is_not_waited_for() {
        let header_time = Duration::from_millis(300);
        let address = start(header_time).await;
        let mut stream = TcpStream::connect(address).await.unwrap();
        let begin = Instant::now();
        let mut answer = Vec::new();
        for byte in b"GET /health HTTP/1.1\r\nHost: a-name-that-takes-its-time\r\n\r\n" {
            if stream.write_all(&[*byte]).await.is_err() {
                break;
            }
            if let Ok(Ok(0) | Err(_)) =
                tokio::time::timeout(Duration::from_millis(50), stream.read_buf(&mut answer)).await
            {
                break;
            }
        }
        let lived = begin.elapsed();
        assert!(lived < header_time + Duration::from_secs(1), "{lived:?}");
        assert!(!answer.ends_with(b"well"));
    }
}
