//! Bags of ROS 2 messages, written.

use crate::ros::ImageMessage;
use bags::{BagError, BagWriter, Format, MessageType, WrittenTopic};
use ros_messages::RosMessage;
use ros_messages::sensor_msgs::{CompressedImage, Image};
use std::collections::BTreeMap;
use std::path::Path;

impl ImageMessage {
    /// Its type.
    pub fn message_type(&self) -> MessageType {
        match self {
            Self::Raw(_) => message_type::<Image>(),
            Self::Compressed(_) => message_type::<CompressedImage>(),
        }
    }
}

/// The type of a message, with its definition: a text that is put together.
pub fn message_type<M: RosMessage>() -> MessageType {
    MessageType { name: M::TYPE_NAME, hash: M::TYPE_HASH, definition: ros_messages::definition::<M>() }
}

/// A bag whose topics are added when they are first written.
#[derive(Debug)]
pub struct RosBagWriter {
    writer: BagWriter,
    topics: BTreeMap<String, WrittenTopic>,
}

impl RosBagWriter {
    /// Creates the bag.
    ///
    /// # Errors
    /// As [`BagWriter::create`].
    pub fn create(path: &Path, format: Format) -> Result<Self, BagError> {
        Ok(Self { writer: BagWriter::create(path, format)?, topics: BTreeMap::new() })
    }

    /// Appends a message as CDR.
    ///
    /// # Arguments
    /// * `of`: its type, asked for only where the topic is new.
    /// * `log_ns`: when it was recorded, nanoseconds.
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be written.
    pub fn write(
        &mut self,
        name: &str,
        of: impl FnOnce() -> MessageType,
        log_ns: i64,
        bytes: &[u8],
    ) -> Result<(), BagError> {
        let topic = if let Some(topic) = self.topics.get(name) {
            *topic
        } else {
            let topic = self.writer.topic(name, &of())?;
            self.topics.insert(name.to_owned(), topic);
            topic
        };
        self.writer.write(topic, log_ns, bytes)
    }

    /// As [`BagWriter::flush`].
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be written.
    pub fn flush(&mut self) -> Result<(), BagError> {
        self.writer.flush()
    }

    /// As [`BagWriter::finish`].
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be written.
    pub fn finish(self) -> Result<(), BagError> {
        self.writer.finish()
    }
}
