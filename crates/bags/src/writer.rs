//! Writes recordings of ROS 2 messages.

use crate::BagError;
use crate::mcap_writer::McapWriter;
use crate::qos::OfferedQos;
use crate::sqlite_writer::SqliteWriter;
use crate::storage::Metadata;
use std::path::Path;

/// Formats that are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// An MCAP file.
    Mcap,
    /// A rosbag2: a folder with `metadata.yaml` and a file of SQLite.
    Rosbag2,
}

/// A topic of a [`BagWriter`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrittenTopic(pub(crate) u16);

/// A type of messages: its name as ROS 2 writes it, its hash and its definition.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MessageType {
    /// For example `sensor_msgs/msg/Imu`.
    pub name: &'static str,
    /// `RIHS01_` and 64 digits.
    pub hash: &'static str,
    /// In `ros2msg`.
    pub definition: String,
}

/// A recording that is being written. Messages are CDR.
#[derive(Debug)]
pub struct BagWriter(Inner);

#[derive(Debug)]
enum Inner {
    Mcap(Box<McapWriter>),
    Sqlite(Box<SqliteWriter>),
}

impl BagWriter {
    /// Creates a file, or the folder of a rosbag2.
    ///
    /// # Errors
    /// [`BagError`]: it exists already, or cannot be created.
    pub fn create(path: &Path, format: Format) -> Result<Self, BagError> {
        Ok(Self(match format {
            Format::Mcap => Inner::Mcap(Box::new(McapWriter::create(path)?)),
            Format::Rosbag2 => Inner::Sqlite(Box::new(SqliteWriter::create(path)?)),
        }))
    }

    /// Adds a topic.
    ///
    /// # Arguments
    /// * `qos`: what its publisher offers.
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be written.
    pub fn topic(&mut self, name: &str, of: &MessageType, qos: OfferedQos) -> Result<WrittenTopic, BagError> {
        match &mut self.0 {
            Inner::Mcap(writer) => writer.topic(name, of, qos),
            Inner::Sqlite(writer) => writer.topic(name, of, qos),
        }
    }

    /// Adds a text about the recording, which is no message: metadata of an MCAP, `custom_data` of a rosbag2.
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be written.
    pub fn metadata(&mut self, metadata: &Metadata) -> Result<(), BagError> {
        match &mut self.0 {
            Inner::Mcap(writer) => writer.metadata(metadata),
            Inner::Sqlite(writer) => writer.metadata(metadata),
        }
    }

    /// Appends a message.
    ///
    /// # Arguments
    /// * `log_ns`: when it was recorded, nanoseconds.
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be written.
    pub fn write(&mut self, topic: WrittenTopic, log_ns: i64, bytes: &[u8]) -> Result<(), BagError> {
        match &mut self.0 {
            Inner::Mcap(writer) => writer.write(topic, log_ns, bytes),
            Inner::Sqlite(writer) => writer.write(topic, log_ns, bytes),
        }
    }

    /// Makes what was written readable, even if the program is killed afterwards.
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be written.
    pub fn flush(&mut self) -> Result<(), BagError> {
        match &mut self.0 {
            Inner::Mcap(writer) => writer.flush(),
            Inner::Sqlite(writer) => writer.flush(),
        }
    }

    /// Completes the recording with its index. Without it a recording is readable up to the last [`Self::flush`].
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be written.
    pub fn finish(self) -> Result<(), BagError> {
        match self.0 {
            Inner::Mcap(writer) => writer.finish(),
            Inner::Sqlite(writer) => writer.finish(),
        }
    }
}
