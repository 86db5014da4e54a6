//! Metrics and health of a program over HTTP, for Prometheus and for whatever restarts programs; and its log.
//!
//! | path | answer |
//! |---|---|
//! | `/metrics` | all metrics of the registry in the OpenMetrics text format |
//! | `/health` | [`Health`] as JSON, with status 200, or 503 where it is not well |
//!
//! The server knows no users and reads nothing from requests but their path. Bind it to a loopback or management address.
//!
//! # Example
//! ```
//! use monitoring::{Health, MonitoringServer};
//! use prometheus_client::metrics::counter::Counter;
//! use prometheus_client::registry::Registry;
//!
//! # #[tokio::main(flavor = "current_thread")]
//! # async fn main() -> Result<(), monitoring::MonitoringError> {
//! let queries: Counter = Counter::default();
//! let mut registry = Registry::default();
//! registry.register("queries", "Queries answered", queries.clone());
//!
//! let address = "127.0.0.1:0".parse().unwrap();
//! let server = MonitoringServer::start(address, registry, || Health::well("serving")).await?;
//! println!("http://{}/metrics", server.address());
//! queries.inc();
//! server.stop().await;
//! # Ok(())
//! # }
//! ```

mod health;
mod log;
mod server;

pub use health::Health;
pub use log::{LogFormat, LogFormatError, start_log};
pub use server::{MonitoringError, MonitoringServer, monitoring_routes};
