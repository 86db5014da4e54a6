//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

mod nees;
mod rig;
mod year;
