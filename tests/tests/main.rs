//! All integration tests of the crate, in one program.
#![allow(clippy::unwrap_used, missing_docs)]

mod bad_input;
mod carried;
mod chaos;
mod consistency;
mod images;
mod initial_pose;
mod inspect;
mod live;
mod live_faults;
mod live_latency;
mod live_ros;
mod localize;
mod map_change;
mod map_extension;
mod map_gravity;
mod monitoring;
mod network;
mod other_map;
mod python_driver;
mod recorded;
mod released_map;
mod secure;
mod starting;
mod topology;
