//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

mod answers;
mod common;
mod descriptors;
mod evidence;
mod kinds;
mod places;
mod poses;
mod report;
