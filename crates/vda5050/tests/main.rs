//! Tests of the bridge to VDA 5050.
#![allow(clippy::unwrap_used)]

mod bridge;
mod broker;
mod messages;
mod robot;
mod schema;
mod tls;
mod vehicle;
