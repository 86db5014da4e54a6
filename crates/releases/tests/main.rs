//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

mod candidates;
mod cells;
mod crossing;
mod formats;
#[cfg(unix)]
mod interrupted;
mod releases;
mod sessions;
