//! What the end to end tests share: a small scenario, a server that can be stopped and started again, robots.
//!
//! Nothing in this package is part of the product. Faults of the environment (no free port, no disk) panic.

#![allow(clippy::unwrap_used, clippy::missing_panics_doc)]

pub mod attack;
pub mod crates_picture;
pub mod data;
pub mod fleet;
pub mod images;
pub mod link;
#[path = "../../crates/mapping/tests/common/map_errors.rs"]
pub mod map_errors;
pub mod network;
#[path = "../../crates/mapping/tests/common/requests.rs"]
pub mod requests;
pub mod robot;
#[path = "../../crates/mapping/tests/common/scenario.rs"]
pub mod scenario;
pub mod server;
#[path = "../../crates/mapping/tests/common/sessions.rs"]
pub mod sessions;
