//! A ROS 2 node over a Zenoh session, compatible with `rmw_zenoh` (Jazzy from 0.2.4 on, Kilted), without ROS.
//!
//! | module | what |
//! |---|---|
//! | [`node`] | [`Node`]: one node of a session; makes publishers and subscribers |
//! | [`publisher`], [`subscriber`] | [`Publisher`], [`Subscriber`]: typed topics |
//! | [`names`] | ROS names, and the keys of topics |
//! | [`liveliness`] | the tokens by which nodes and topics are discovered, and the id (GID) of a publisher |
//! | `discovery` | [`DiscoveredTopic`]s of other nodes, and why a topic is silent: [`explain_silence`] |
//! | [`attachment`] | [`Attachment`]: number, time and sender of a message |
//! | `history` | transient local topics: what was published before, for subscribers that come later |
//! | [`qos`] | [`Qos`] and its text in tokens |
//! | [`error`] | [`RosError`] |
//!
//! Names, tokens, attachments and quality of service are pure functions, tested against goldens.
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod attachment;
mod discovery;
pub mod error;
mod history;
pub mod liveliness;
pub mod names;
pub mod node;
mod offers;
pub mod publisher;
pub mod qos;
pub mod subscriber;

pub use attachment::Attachment;
pub use discovery::{DiscoveredTopic, explain_silence};
pub use error::RosError;
pub use names::NameError;
pub use node::{Node, NodeOptions};
pub use publisher::Publisher;
pub use qos::{Durability, History, Qos, Reliability};
pub use subscriber::{Received, Subscriber};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
