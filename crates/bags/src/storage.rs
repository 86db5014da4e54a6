//! What a format of recordings provides.

use crate::BagError;
use crate::packed_file::TemporaryFile;
use std::collections::BTreeMap;
use std::fmt;

/// Larger messages are refused before memory is allocated, bytes.
pub const MAX_MESSAGE: u64 = 1 << 28;

/// So many damages of a file are told, the others counted.
const MAX_DAMAGE: usize = 10;

/// How the messages of a topic are serialized.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Encoding {
    /// ROS 1.
    Ros1,
    /// CDR: ROS 2.
    Cdr,
    /// Another, by the name that the recording gives.
    Other(String),
}

impl Encoding {
    pub(crate) fn of(name: &str) -> Self {
        match name {
            "ros1" => Self::Ros1,
            "cdr" => Self::Cdr,
            _ => Self::Other(name.to_owned()),
        }
    }
}

impl fmt::Display for Encoding {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Ros1 => "ros1",
            Self::Cdr => "cdr",
            Self::Other(name) => name,
        })
    }
}

/// The definition of a message type, as the recording carries it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schema {
    /// What it is written in: `ros1msg`, `ros2msg`, `ros2idl`, `jsonschema`, `protobuf`.
    pub encoding: String,
    /// The definition.
    pub text: Vec<u8>,
}

/// A text about a recording that is no message, as MCAP has it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Metadata {
    /// What it is: each program has names of its own.
    pub name: String,
    /// Its entries by their names.
    pub entries: BTreeMap<String, String>,
}

/// Where a message is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Number of the file, for a recording of several.
    pub(crate) file: u16,
    /// Number of the chunk; [`NO_CHUNK`] where `offset` does not count in an unpacked chunk.
    pub(crate) chunk: u32,
    /// Byte of the file or of the unpacked chunk, or row of the table.
    pub(crate) offset: u64,
}

/// See [`Place::chunk`].
pub(crate) const NO_CHUNK: u32 = u32::MAX;

/// The messages of one writer to a topic of one file.
#[derive(Debug)]
pub(crate) struct Channel {
    pub(crate) topic: String,
    pub(crate) type_name: String,
    pub(crate) encoding: Encoding,
    pub(crate) schema: Option<Schema>,
    /// Log time (ns), chunk, offset.
    pub(crate) messages: Vec<(i64, u32, u64)>,
}

/// What could not be read of a file, in words.
#[derive(Debug, Default)]
pub(crate) struct Damage {
    lines: Vec<String>,
    more: usize,
}

impl Damage {
    /// Takes note of a damage; only counts it after the first few.
    pub(crate) fn add(&mut self, line: impl Into<String>) {
        if self.lines.len() < MAX_DAMAGE {
            self.lines.push(line.into());
        } else {
            self.more += 1;
        }
    }

    pub(crate) fn into_lines(mut self) -> Vec<String> {
        if self.more > 0 {
            self.lines.push(format!("and {} more", self.more));
        }
        self.lines
    }
}

/// A file whose index was read.
#[derive(Debug)]
pub(crate) struct OpenFile {
    pub(crate) channels: Vec<Channel>,
    pub(crate) storage: Box<dyn Storage>,
    pub(crate) damage: Damage,
    pub(crate) metadata: Vec<Metadata>,
    /// What had to be done to read it.
    pub(crate) notes: Vec<String>,
    /// A copy that is read in place of the file.
    pub(crate) temporary: Option<TemporaryFile>,
}

impl OpenFile {
    /// A file that is read where it is.
    pub(crate) fn new(channels: Vec<Channel>, storage: Box<dyn Storage>, damage: Damage) -> Self {
        Self { channels, storage, damage, metadata: Vec::new(), notes: Vec::new(), temporary: None }
    }
}

/// Reads the messages of one file.
pub(crate) trait Storage: fmt::Debug + Send + Sync {
    /// The first bytes of a message, at most `most`; unpacked where it is compressed for itself.
    fn read(&self, chunk: u32, offset: u64, most: usize) -> Result<Vec<u8>, BagError>;
}

/// A type's name without the folder that ROS 2 puts in its middle: `sensor_msgs/Imu` for `sensor_msgs/msg/Imu`, and for
/// the names of IDL and DDS, `sensor_msgs::msg::Imu` and `sensor_msgs::msg::dds_::Imu_`.
pub(crate) fn short_type(name: &str) -> String {
    let name = name.replace("::", "/");
    let name = match name.split_once("/dds_/") {
        Some((folder, of_dds)) => format!("{folder}/{}", of_dds.trim_end_matches('_')),
        None => name,
    };
    name.replacen("/msg/", "/", 1)
}

#[cfg(test)]
mod tests {
    use super::short_type;

    #[test]
    fn every_form_of_a_type_name_is_the_same_type() {
        for name in [
            "sensor_msgs/Imu",
            "sensor_msgs/msg/Imu",
            "sensor_msgs::msg::Imu",
            "sensor_msgs::msg::dds_::Imu_",
        ] {
            assert_eq!(short_type(name), "sensor_msgs/Imu", "{name}");
        }
    }
}
