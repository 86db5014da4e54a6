//! The client side of a map server: sessions, map queries with deadline and retry, and map changes.
//!
//! | module | what |
//! |---|---|
//! | [`session`] | opening and closing a Zenoh session |
//! | `arguments` | the switches of a session (feature `arguments`) |
//! | [`map_client`] | [`MapClient`]: asynchronous queries to one map |
//! | [`cell_client`] | [`CellClient`]: queries of a server to the cells of a map |
//! | [`query_tasks`] | [`QueryTasks`]: match queries in the background, for a thread that must not block |
//! | [`map_change_subscriber`] | [`MapChangeSubscriber`]: notices of changes of a map |
//! | [`error`], `error_line` | [`ClientError`]; errors as programs print them: [`error_line()`] |
//!
//! # Retries
//! A query is repeated until its deadline when no server answered, when nothing was heard for 3 s (then 6 s, 12 s, ...),
//! when the server is busy, or when the answer is incomplete (no final status, or keyframes missing). None of these is
//! ever reported as "no match": that is an answer, [`protocol::MatchOutcome::NoMatch`]. Any other refusal of the server
//! is returned at once.
//!
//! # Example
//! A map server needs nothing but a queryable; this one lives in the client's own session:
//! ```
//! use client::{MapClient, SessionOptions, close_session, open_session};
//! use protocol::{Format, MapIdentity, MapInfoReply};
//! use std::time::{Duration, Instant};
//! use zenoh::Wait;
//!
//! # #[tokio::main]
//! # async fn main() -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
//! let session = open_session(&SessionOptions::default()).await?;
//! let info = MapInfoReply {
//!     name: "hall".into(), version: 4, identity: MapIdentity::from_bytes([7; 16]), database_schema: 4, keyframes: 212,
//!     landmarks: 9841, observations: 35120,
//!     cross_covariances: 0, gravity_in_global: None, extent: None, descriptors: None, extractor: "orb-1".into(),
//!     sigma_map_px: 1.0, feature_kinds: Vec::new(),
//! };
//! let payload = protocol::encode(Format::Bincode, &info)?;
//! let reply = move |query: zenoh::query::Query| {
//!     query.reply("map/hall/info", payload.clone()).encoding(Format::Bincode.encoding()).wait().ok();
//! };
//! let server = session.declare_queryable("map/hall/info").callback(reply).await?;
//!
//! let hall = MapClient::new(session.clone(), "hall")?;
//! let received = hall.info(Instant::now() + Duration::from_secs(5)).await?;
//! assert_eq!(received, info);
//! # server.undeclare().await?;
//! # close_session(&session).await;
//! # Ok(())
//! # }
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

#[cfg(feature = "arguments")]
pub mod arguments;
pub mod cell_client;
pub mod error;
mod error_line;
mod hand_in;
#[cfg(feature = "arguments")]
mod log;
pub mod map_change_subscriber;
pub mod map_client;
pub mod query_tasks;
#[cfg(feature = "arguments")]
mod renamed_switches;
mod request;
pub mod session;

#[cfg(feature = "arguments")]
pub use arguments::SessionArguments;
pub use cell_client::{CellClient, CellPlacement, CellReply, ForwardedQuery};
pub use error::ClientError;
pub use error_line::error_line;
pub use hand_in::SessionUpload;
#[cfg(feature = "arguments")]
pub use log::without_secrets;
pub use map_change_subscriber::MapChangeSubscriber;
pub use map_client::{MapClient, MatchAnswer};
pub use query_tasks::{QueryResult, QueryTasks};
#[cfg(feature = "arguments")]
pub use renamed_switches::{explain_renamed, renamed_switch};
pub use session::{DEFAULT_ENDPOINT, SessionError, SessionMode, SessionOptions, close_session, open_session};

/// The examples of the README run as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
