//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

mod camera_models;
mod cameras;
mod common;
mod pnp;
mod poses;
mod triangulation;
