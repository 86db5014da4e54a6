//! The client's side of a map server: sessions, map queries with deadline and retry, and map changes.
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod answer;
pub mod map_change_subscriber;
pub mod map_client;
pub mod query_client;
pub mod session;
