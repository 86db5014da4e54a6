//! Laws of session files.
#![allow(clippy::unwrap_used)]

mod cut_off;
mod inbox;
mod made;
mod round_trip;
