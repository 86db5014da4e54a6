//! Metrics and health of a program over HTTP, for Prometheus and for whatever restarts programs; and its log.
//!
//! | path | answer |
//! |---|---|
//! | `/metrics` | all metrics of the registry in the OpenMetrics text format |
//! | `/health` | [`Health`] as JSON, with status 200, or 503 where it is not well |
//!
//! The server knows no users and reads nothing from requests but their path. At most [`MAX_CONNECTIONS`] are open, and a request's
//! header must come within [`HEADER_TIME`]; [`serve`] serves other routers so. Bind it to a loopback or management address.
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

mod activity;
mod connection;
mod health;
mod log;
mod server;
mod serving;

pub use health::Health;
pub use log::{LogFormat, LogFormatError, start_log};
pub use server::{MonitoringError, MonitoringServer, monitoring_routes};
pub use serving::{HEADER_TIME, MAX_CONNECTIONS, serve};
