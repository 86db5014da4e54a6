//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

#[cfg(feature = "bags")]
mod bags;
#[cfg(feature = "bags")]
mod cases;
#[cfg(feature = "bags")]
mod convert;
