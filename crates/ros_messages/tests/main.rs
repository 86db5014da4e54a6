//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

mod definitions;
mod goldens;
mod hostile_input;
mod ros1;
mod round_trip;
