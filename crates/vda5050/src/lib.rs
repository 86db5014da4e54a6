//! Localization for fleet software that speaks [VDA 5050](https://github.com/VDA5050/VDA5050): where vehicles are, over MQTT.
//!
//! | module | what |
//! |---|---|
//! | [`bridge`] | [`run`]: publishes the robots of a Zenoh session as vehicles at a broker |
//! | [`vehicle`] | [`Vehicle`]: what a robot published, as `agvPosition` and `velocity` |
//! | [`messages`] | the messages `visualization` and `connection` |
//! | [`quality`] | `localizationScore` and `deviationRange` of a covariance |
//! | [`names`], [`broker`], [`timestamp`] | topics, addresses and times |
//! | [`tls`] | [`BrokerTls`]: authorities, certificate and key of `mqtts://` |
//!
//! # Which messages
//! A localizer knows neither orders nor actions, loads or batteries, of which the message `state` must tell: that is for the vehicle's
//! controller. The bridge publishes `visualization`, whose `agvPosition` and `velocity` are the same objects as those of `state`, so that a
//! controller puts them into its `state` as they are; and `connection`, unless the controller does.
//!
//! A controller in Rust makes them itself:
//! ```
//! use std::time::Instant;
//! use vda5050::{Published, Vehicle, VehicleSettings};
//!
//! let mut vehicle = Vehicle::new(VehicleSettings::default(), Instant::now());
//! // For each message of `robot/cart7/{pose,odometry,status}`:
//! let message = br#"{"schema": 10, "type": "robot_status", "stamp_ns": 5, "state": "localized", "reason": "", "map": "hall",
//!     "keyframes_held": 24, "queries_sent": 310, "queries_answered": 308}"#;
//! let status = protocol::decode(protocol::Format::Json, message)?;
//! vehicle.note(Published::Status(status), Instant::now());
//!
//! let mut state = serde_json::json!({ "orderId": "", "driving": false });
//! state["agvPosition"] = serde_json::to_value(vehicle.position(Instant::now()))?;
//! assert_eq!(state["agvPosition"]["mapId"], "hall");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod bridge;
pub mod broker;
mod fleet;
pub mod messages;
mod mqtt;
pub mod names;
pub mod quality;
mod session;
pub mod timestamp;
pub mod tls;
pub mod vehicle;

pub use bridge::{BridgeError, BridgeEvent, BridgeSettings, run};
pub use broker::{BrokerAddress, BrokerAddressError, BrokerUser};
pub use messages::{AgvPosition, Connection, ConnectionState, Header, Velocity, Visualization};
pub use names::{NameError, Topics};
pub use protocol::Published;
pub use quality::{deviation_range_m, localization_score};
pub use timestamp::iso_8601;
pub use tls::{BrokerTls, BrokerTlsError, CertificateOf, ClientIdentity};
pub use vehicle::{Vehicle, VehicleSettings};

/// The examples of the README run as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
