//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;
mod damage;
mod held_keyframes;
mod json_examples;
mod keys;
mod round_trip;
mod validation;
