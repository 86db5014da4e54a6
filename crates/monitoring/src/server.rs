//! The HTTP server.

use crate::health::Health;
use crate::serving;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use axum::routing::get;
use axum::{Json, Router};
use prometheus_client::encoding::text;
use prometheus_client::registry::Registry;
use std::net::SocketAddr;
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;

/// Media type of the OpenMetrics text format.
const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Why metrics and health cannot be served.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MonitoringError {
    /// The address cannot be listened on.
    #[error("metrics cannot be served on {address}: {source}; is the port taken already?")]
    Bind {
        /// The address.
        address: SocketAddr,
        /// The error of the operating system.
        source: std::io::Error,
    },
}

/// What requests read.
struct Monitored {
    registry: Registry,
    health: Box<dyn Fn() -> Health + Send + Sync>,
}

/// A running HTTP server; dropped, it goes on until the runtime ends.
#[derive(Debug)]
pub struct MonitoringServer {
    address: SocketAddr,
    task: JoinHandle<()>,
}

impl MonitoringServer {
    /// Starts to serve a registry and a state of health.
    ///
    /// # Arguments
    /// * `address`: port 0 takes any free one.
    /// * `health`: called for each request of `/health`; must not block.
    ///
    /// # Errors
    /// [`MonitoringError::Bind`].
    pub async fn start(
        address: SocketAddr,
        registry: Registry,
        health: impl Fn() -> Health + Send + Sync + 'static,
    ) -> Result<Self, MonitoringError> {
        let cannot_bind = |source| MonitoringError::Bind { address, source };
        let listener = TcpListener::bind(address).await.map_err(cannot_bind)?;
        let address = listener.local_addr().map_err(cannot_bind)?;
        let router = monitoring_routes(registry, health);
        let task = tokio::spawn(serving::serve(listener, router));
        tracing::info!(%address, "metrics and health on http");
        Ok(Self { address, task })
    }

    /// The address that it listens on.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Stops at once.
    pub async fn stop(self) {
        self.task.abort();
        // Cancelled, as asked for.
        let _ = self.task.await;
    }
}

/// `/metrics` and `/health`, for a program that has an HTTP server of its own.
///
/// # Arguments
/// * `health`: called for each request of `/health`; must not block.
pub fn monitoring_routes(registry: Registry, health: impl Fn() -> Health + Send + Sync + 'static) -> Router {
    let monitored = Arc::new(Monitored { registry, health: Box::new(health) });
    Router::new().route("/metrics", get(metrics)).route("/health", get(health_of)).with_state(monitored)
}

async fn metrics(State(monitored): State<Arc<Monitored>>) -> impl IntoResponse {
    let mut body = String::new();
    match text::encode(&mut body, &monitored.registry) {
        Ok(()) => (StatusCode::OK, [(header::CONTENT_TYPE, OPEN_METRICS)], body),
        Err(error) => {
            let message = format!("the metrics cannot be written: {error}");
            (
                StatusCode::INTERNAL_SERVER_ERROR,
                [(header::CONTENT_TYPE, "text/plain; charset=utf-8")],
                message,
            )
        }
    }
}

async fn health_of(State(monitored): State<Arc<Monitored>>) -> impl IntoResponse {
    let health = (monitored.health)();
    let status = if health.is_well { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    (status, Json(health))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use prometheus_client::metrics::counter::Counter;
    use std::sync::atomic::{AtomicBool, Ordering};
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
    use tokio::net::TcpStream;

    async fn response(address: SocketAddr, request: &str) -> String {
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream.write_all(request.as_bytes()).await.unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).await.unwrap();
        text
    }

    async fn get(address: SocketAddr, path: &str) -> String {
        response(address, &format!("GET {path} HTTP/1.1\r\nHost: robot\r\nConnection: close\r\n\r\n")).await
    }

    #[tokio::test]
    async fn metrics_and_health_are_those_of_the_moment_and_nothing_else_is_served() {
        let queries: Counter = Counter::default();
        let mut registry = Registry::default();
        registry.register("queries", "Queries answered", queries.clone());
        let well = Arc::new(AtomicBool::new(true));
        let asked = Arc::clone(&well);
        let health = move || {
            if asked.load(Ordering::Relaxed) { Health::well("serving") } else { Health::unwell("no map") }
        };
        let local = "127.0.0.1:0".parse().unwrap();
        let server = MonitoringServer::start(local, registry, health).await.unwrap();
        let address = server.address();

        queries.inc_by(3);
        let metrics = get(address, "/metrics").await;
        assert!(metrics.starts_with("HTTP/1.1 200") && metrics.contains("queries_total 3\n"), "{metrics}");
        assert!(metrics.contains(OPEN_METRICS) && metrics.ends_with("# EOF\n"), "{metrics}");

        let health = get(address, "/health").await;
        assert!(health.starts_with("HTTP/1.1 200"), "{health}");
        assert!(health.ends_with(r#"{"is_well":true,"reason":"serving"}"#), "{health}");
        well.store(false, Ordering::Relaxed);
        let health = get(address, "/health").await;
        assert!(health.starts_with("HTTP/1.1 503") && health.contains("no map"), "{health}");

        assert!(get(address, "/../etc/passwd").await.starts_with("HTTP/1.1 404"));
        let posted = response(address, "POST /health HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n").await;
        assert!(posted.starts_with("HTTP/1.1 405"), "{posted}");
        assert!(response(address, "\u{1}\u{2}\r\n\r\n").await.starts_with("HTTP/1.1 400"));
        assert!(get(address, "/health").await.starts_with("HTTP/1.1 503"), "it goes on after garbage");
        server.stop().await;
        assert!(TcpStream::connect(address).await.is_err(), "stopped");
    }

    #[tokio::test]
    async fn a_taken_port_is_named() {
        let taken = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = taken.local_addr().unwrap();
        let started = MonitoringServer::start(address, Registry::default(), || Health::well("")).await;
        let message = started.unwrap_err().to_string();
        assert!(message.contains(&address.to_string()), "{message}");
    }
}
