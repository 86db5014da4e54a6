//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

mod lying_map;
mod map_consistency;
mod odometry_consistency;
mod rendered_flights;
mod rescue;
