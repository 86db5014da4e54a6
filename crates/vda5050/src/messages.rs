//! The messages, as the JSON schemas of VDA 5050 version 2.1.0 define them.

use crate::timestamp::iso_8601;
use serde::Serialize;
use std::time::SystemTime;

/// The version of the protocol.
pub const VERSION: &str = "2.1.0";

/// What every message begins with.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Header {
    /// Counts the messages of a topic, beginning with 0; wraps around.
    pub header_id: u32,
    /// When the message was made: ISO 8601, UTC, hundredths of a second.
    pub timestamp: String,
    /// [`VERSION`].
    pub version: String,
    /// Manufacturer of the vehicle.
    pub manufacturer: String,
    /// Serial number of the vehicle.
    pub serial_number: String,
}

impl Header {
    /// The header of a message that is made at a time.
    pub fn new(header_id: u32, time: SystemTime, manufacturer: &str, serial_number: &str) -> Self {
        Self {
            header_id,
            timestamp: iso_8601(time),
            version: VERSION.to_owned(),
            manufacturer: manufacturer.to_owned(),
            serial_number: serial_number.to_owned(),
        }
    }
}

/// Where a vehicle is: `agvPosition`, the same object in `visualization` and `state`.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct AgvPosition {
    /// Whether the position holds at the time of the message. Where it does not, x, y and theta are the last that were known, or zero.
    pub position_initialized: bool,
    /// Quality from 0 (unknown) to 1 (known): see [`localization_score`](crate::localization_score).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub localization_score: Option<f64>,
    /// Radius that holds the position with 95 %, metres: see [`deviation_range_m`](crate::deviation_range_m).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub deviation_range: Option<f64>,
    /// In the frame of the map, metres.
    pub x: f64,
    /// In the frame of the map, metres.
    pub y: f64,
    /// Heading in the frame of the map, radians in [-pi, pi].
    pub theta: f64,
    /// Name of the map; empty where none is known.
    pub map_id: String,
}

/// How a vehicle moves, in its own axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Velocity {
    /// Forward, m/s.
    pub vx: f64,
    /// To the left, m/s.
    pub vy: f64,
    /// About the vertical axis, to the left, rad/s.
    pub omega: f64,
}

/// `visualization`: position and velocity at a rate of the publisher's choice.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Visualization {
    /// Counter, time, vehicle.
    #[serde(flatten)]
    pub header: Header,
    /// Where the vehicle is.
    pub agv_position: AgvPosition,
    /// How it moves; left out where that is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity: Option<Velocity>,
}

/// Whether a vehicle is connected to the broker.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum ConnectionState {
    /// It is.
    Online,
    /// It went in good order: the robot shut down, or the bridge did.
    Offline,
    /// It went without saying so.
    ConnectionBroken,
}

/// `connection`: retained by the broker.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Connection {
    /// Counter, time, vehicle.
    #[serde(flatten)]
    pub header: Header,
    /// Whether the vehicle is connected.
    pub connection_state: ConnectionState,
}
