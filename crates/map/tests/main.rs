//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

mod added;
mod aliases;
mod common_errors;
mod crossing;
mod damage;
mod difference;
mod edit;
mod existence;
mod formats;
mod hostile;
#[cfg(unix)]
mod interrupted;
mod parts;
mod segments;
mod sessions;
mod store;
