//! What the end to end tests share: a small scenario, a server that can be stopped and started again, robots.
//!
//! Nothing in this package is part of the product. Faults of the environment (no free port, no disk) panic.

#![allow(clippy::unwrap_used, clippy::missing_panics_doc)]

pub mod attack;
pub mod data;
pub mod fleet;
pub mod images;
pub mod link;
pub mod map_errors;
pub mod network;
pub mod robot;
pub mod scenario;
pub mod server;
pub mod sessions;
