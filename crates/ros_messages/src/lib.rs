//! ROS 2 messages of a localizer: structs, type names, type hashes (REP-2016) and CDR, without ROS.
//!
//! | module | what |
//! |---|---|
//! | [`message`] | [`RosMessage`]: name and hash of a type |
//! | [`cdr`] | [`encode`] and [`decode`]: CDR with its header, bounded by the input |
//! | `definition` | [`definition`]: the text of a type for recordings |
//! | [`ros1`] | the same messages as ROS 1 writes them, decoded only |
//! | [`builtin_interfaces`], [`std_msgs`], [`geometry_msgs`], [`sensor_msgs`], [`nav_msgs`], [`rosgraph_msgs`], [`tf2_msgs`], [`diagnostic_msgs`] | one module for each ROS package |
//!
//! Fields have the names, the order and the units of their ROS definitions (REP-103: metres, radians, seconds).
//! Decoded values are not validated: a NaN or a width of zero is what the sender wrote.

pub mod builtin_interfaces;
pub mod cdr;
mod definition;
pub mod diagnostic_msgs;
pub mod geometry_msgs;
pub mod message;
pub mod nav_msgs;
pub mod ros1;
pub mod rosgraph_msgs;
pub mod sensor_msgs;
pub mod std_msgs;
pub mod tf2_msgs;

pub use cdr::{CdrError, decode, encode};
pub use definition::{Definition, definition};
pub use message::RosMessage;
