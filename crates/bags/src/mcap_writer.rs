//! Writes MCAP.

use crate::BagError;
use crate::qos::{self, OfferedQos};
use crate::storage::Metadata;
use crate::writer::{MessageType, WrittenTopic};
use mcap::{Compression, WriteOptions, Writer};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

/// A message of a chunk is readable when the chunk is complete: at 1 MB, or when it is flushed.
const CHUNK: u64 = 1 << 20;

/// Where rosbag2 writes the hash of a channel's type.
const TYPE_HASH: &str = "topic_type_hash";

pub(crate) struct McapWriter {
    path: PathBuf,
    writer: Writer<BufWriter<File>>,
    /// The same file, which the writer does not give out.
    file: File,
    /// Number of the next message of each topic.
    sequence: BTreeMap<u16, u32>,
}

impl std::fmt::Debug for McapWriter {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "McapWriter({})", self.path.display())
    }
}

impl McapWriter {
    pub(crate) fn create(path: &Path) -> Result<Self, BagError> {
        let file = File::create_new(path).map_err(|source| BagError::io(path, source))?;
        let of_writer = file.try_clone().map_err(|source| BagError::io(path, source))?;
        let options =
            WriteOptions::new().profile("ros2").chunk_size(Some(CHUNK)).compression(Some(Compression::Lz4));
        let writer = options.create(BufWriter::new(of_writer)).map_err(|error| failed(path, error))?;
        Ok(Self { path: path.to_path_buf(), writer, file, sequence: BTreeMap::new() })
    }

    pub(crate) fn topic(
        &mut self,
        name: &str,
        of: &MessageType,
        qos: OfferedQos,
    ) -> Result<WrittenTopic, BagError> {
        let schema = self.writer.add_schema(of.name, "ros2msg", of.definition.as_bytes());
        let metadata =
            BTreeMap::from([(qos::KEY.to_owned(), qos.yaml("")), (TYPE_HASH.to_owned(), of.hash.to_owned())]);
        let channel = schema.and_then(|schema| self.writer.add_channel(schema, name, "cdr", &metadata));
        channel.map(WrittenTopic).map_err(|error| failed(&self.path, error))
    }

    pub(crate) fn metadata(&mut self, metadata: &Metadata) -> Result<(), BagError> {
        let Metadata { name, entries } = metadata.clone();
        let record = mcap::records::Metadata { name, metadata: entries };
        self.writer.write_metadata(&record).map_err(|error| failed(&self.path, error))
    }

    pub(crate) fn write(&mut self, topic: WrittenTopic, log_ns: i64, bytes: &[u8]) -> Result<(), BagError> {
        let sequence = self.sequence.entry(topic.0).or_default();
        let time = u64::try_from(log_ns).unwrap_or_default();
        let header = mcap::records::MessageHeader {
            channel_id: topic.0,
            sequence: *sequence,
            log_time: time,
            publish_time: time,
        };
        *sequence = sequence.wrapping_add(1);
        let written = self.writer.write_to_known_channel(&header, bytes);
        written.map_err(|error| failed(&self.path, error))
    }

    pub(crate) fn flush(&mut self) -> Result<(), BagError> {
        self.writer.flush().map_err(|error| failed(&self.path, error))?;
        self.file.sync_data().map_err(|source| BagError::io(&self.path, source))
    }

    pub(crate) fn finish(mut self) -> Result<(), BagError> {
        self.writer.finish().map_err(|error| failed(&self.path, error))?;
        let written = self.writer.into_inner().flush().and_then(|()| self.file.sync_all());
        written.map_err(|source| BagError::io(&self.path, source))
    }
}

fn failed(path: &Path, error: mcap::McapError) -> BagError {
    match error {
        mcap::McapError::Io(source) => BagError::io(path, source),
        other => BagError::invalid(path, other.to_string()),
    }
}
