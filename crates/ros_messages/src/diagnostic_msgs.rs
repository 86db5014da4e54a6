//! Package `diagnostic_msgs`.

use crate::definition::{self, Definition};
use crate::message::RosMessage;
use crate::std_msgs::Header;
use serde::{Deserialize, Serialize};

/// A value of a [`DiagnosticStatus`] as text.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// What it is.
    pub key: String,
    /// Its value.
    pub value: String,
}

/// State of one component.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// [`DiagnosticStatus::OK`], `WARN`, `ERROR` or `STALE`.
    pub level: u8,
    /// Name of the component.
    pub name: String,
    /// One sentence for people.
    pub message: String,
    /// Serial number or name of the device.
    pub hardware_id: String,
    /// Details.
    pub values: Vec<KeyValue>,
}

impl DiagnosticStatus {
    /// Level: works.
    pub const OK: u8 = 0;
    /// Level: works worse than it should.
    pub const WARN: u8 = 1;
    /// Level: does not work.
    pub const ERROR: u8 = 2;
    /// Level: nothing was heard from it.
    pub const STALE: u8 = 3;
}

/// `diagnostic_msgs/msg/DiagnosticArray`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// Time; the frame is not used.
    pub header: Header,
    /// One for each component.
    pub status: Vec<DiagnosticStatus>,
}

impl RosMessage for DiagnosticArray {
    const TYPE_NAME: &'static str = "diagnostic_msgs/msg/DiagnosticArray";
    const TYPE_HASH: &'static str = "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e";
    const DEFINITION: Definition = definition::DIAGNOSTICS;
}
