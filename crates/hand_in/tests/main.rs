//! Laws of session files.
#![allow(clippy::unwrap_used)]

mod cut_off;
mod example_session;
mod inbox;
mod memory;
mod round_trip;
