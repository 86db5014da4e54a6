//! MCAP files.
//!
//! The records are walked from the beginning to the end of the file, chunks and attachments skipped: the message index
//! behind each chunk says what it holds. So a file without its summary, which a writer that is killed leaves behind,
//! is read in the same way as a complete one.

use crate::BagError;
use crate::chunk_index::ChunkIndex;
use crate::chunks::{Chunk, ChunkedFile, Packing};
use crate::fields::Fields;
use crate::packed_message;
use crate::storage::{
    Channel, Damage, Encoding, MAX_MESSAGE, Metadata, NO_CHUNK, OpenFile, Schema, Storage, short_type,
};
use mcap::parse_record;
use mcap::records::{Record, op};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

pub(crate) const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// Operation code and length before each record, bytes.
const RECORD_HEAD: u64 = 9;
/// Channel, sequence number and two times before the data of a message, bytes.
const MESSAGE_HEAD: u64 = 22;
/// Start of a chunk up to the name of its compression, with room for the name, bytes.
const CHUNK_HEAD: u64 = 64;

/// Reads the index of a file.
pub(crate) fn open(path: &Path) -> Result<OpenFile, BagError> {
    let mut index = Index::new(path)?;
    index.walk()?;
    Ok(index.finish())
}

struct Index {
    chunked: ChunkIndex<u16>,
    schemas: HashMap<u16, (String, Schema)>,
    channels: BTreeMap<u16, mcap::records::Channel>,
    metadata: Vec<Metadata>,
    damage: Damage,
}

impl Index {
    fn new(path: &Path) -> Result<Self, BagError> {
        Ok(Self {
            chunked: ChunkIndex::new(ChunkedFile::open(path)?),
            schemas: HashMap::new(),
            channels: BTreeMap::new(),
            metadata: Vec::new(),
            damage: Damage::default(),
        })
    }

    /// Reads every record of the file but the contents of chunks, as far as the file goes.
    fn walk(&mut self) -> Result<(), BagError> {
        let mut at = MAGIC.len() as u64;
        loop {
            let head = self.chunked.file.range(at, RECORD_HEAD)?;
            let mut fields = Fields::new(&head);
            let (Some(code), Some(length)) = (fields.u8(), fields.u64()) else {
                self.damage.add(format!("the file is cut off at byte {}", self.chunked.file.length()));
                break;
            };
            let body = at + RECORD_HEAD;
            let end = body.saturating_add(length);
            let is_cut = end > self.chunked.file.length();
            if code == 0 || (is_cut && code > op::DATA_END) {
                self.damage.add(format!("there is no record at byte {at}: what follows is left out"));
                break;
            }
            if code != op::MESSAGE_INDEX {
                self.end_chunk(true)?;
            }
            match code {
                op::CHUNK => self.add_chunk(body, end)?,
                op::MESSAGE if !is_cut => self.add_message(at)?,
                op::MESSAGE_INDEX | op::SCHEMA | op::CHANNEL | op::METADATA
                    if !is_cut && length <= MAX_MESSAGE =>
                {
                    let bytes = self.chunked.file.range(body, length)?;
                    match parse_record(code, &bytes) {
                        Ok(Record::MessageIndex(index)) => {
                            let entries = index.records.iter();
                            let entries = entries.map(|entry| (entry.log_time as i64, entry.offset));
                            self.chunked.add_index(index.channel_id, entries);
                        }
                        Ok(record) => self.add_description(record),
                        Err(error) => self.damage.add(format!("the record at byte {at}: {error}")),
                    }
                }
                _ => {}
            }
            if is_cut {
                self.damage.add(format!("the file is cut off in the record at byte {at}"));
                break;
            }
            if code == op::FOOTER {
                break;
            }
            at = end;
        }
        self.end_chunk(false)?;
        self.read_missing_channels()
    }

    /// Takes note of a chunk.
    fn add_chunk(&mut self, body: u64, end: u64) -> Result<(), BagError> {
        let head = self.chunked.file.range(body, CHUNK_HEAD)?;
        let Some((chunk, head_length)) = chunk_head(&head) else {
            self.damage.add(format!("the chunk at byte {body} has no valid head, or an unknown compression"));
            return Ok(());
        };
        let start = body + head_length;
        let packed = chunk.packed.min(end.min(self.chunked.file.length()).saturating_sub(start));
        self.chunked.add_chunk(Chunk { start, packed, ..chunk });
        Ok(())
    }

    /// Ends the newest chunk; searches it where its index is missing or cut off.
    fn end_chunk(&mut self, is_complete: bool) -> Result<(), BagError> {
        self.chunked.end_chunk(is_complete).map_or(Ok(()), |number| self.scan_chunk(number))
    }

    /// Finds the messages of a chunk in itself.
    fn scan_chunk(&mut self, number: u32) -> Result<(), BagError> {
        let unpacked = self.chunked.file.unpack(self.chunked.file.chunks[number as usize])?;
        unpacked.problem.into_iter().for_each(|problem| self.damage.add(problem));
        for_each_record(&unpacked.bytes, |code, offset, body| {
            if code == op::MESSAGE {
                let mut fields = Fields::new(body);
                if let (Some(channel), Some(stamp_ns)) = (u16_of(&mut fields), log_time(&mut fields)) {
                    self.chunked.add_message(channel, stamp_ns, number, offset);
                }
            } else if let Ok(record) = parse_record(code, body) {
                self.add_description(record);
            }
        });
        Ok(())
    }

    /// Takes note of a message outside of chunks.
    fn add_message(&mut self, at: u64) -> Result<(), BagError> {
        let head = self.chunked.file.range(at + RECORD_HEAD, MESSAGE_HEAD)?;
        let mut fields = Fields::new(&head);
        if let (Some(channel), Some(stamp_ns)) = (u16_of(&mut fields), log_time(&mut fields)) {
            self.chunked.add_message(channel, stamp_ns, NO_CHUNK, at);
        }
        Ok(())
    }

    fn add_description(&mut self, record: Record<'_>) {
        match record {
            Record::Schema { header, data } => {
                let schema = Schema { encoding: header.encoding, text: data.into_owned() };
                self.schemas.insert(header.id, (header.name, schema));
            }
            Record::Channel(channel) => {
                self.channels.insert(channel.id, channel);
            }
            Record::Metadata(mcap::records::Metadata { name, metadata: entries }) => {
                self.metadata.push(Metadata { name, entries });
            }
            _ => {}
        }
    }

    /// Reads the channels that are described in chunks only.
    fn read_missing_channels(&mut self) -> Result<(), BagError> {
        for number in 0..self.chunked.file.chunks.len() {
            if self.chunked.messages.keys().all(|id| self.channels.contains_key(id)) {
                break;
            }
            let unpacked = self.chunked.file.unpack(self.chunked.file.chunks[number])?;
            for_each_record(&unpacked.bytes, |code, _, body| {
                if matches!(code, op::SCHEMA | op::CHANNEL)
                    && let Ok(record) = parse_record(code, body)
                {
                    self.add_description(record);
                }
            });
        }
        Ok(())
    }

    fn finish(mut self) -> OpenFile {
        let mut channels = Vec::new();
        for (id, channel) in self.channels {
            let schema = self.schemas.get(&channel.schema_id);
            channels.push(Channel {
                topic: channel.topic,
                type_name: schema.map(|(name, _)| short_type(name)).unwrap_or_default(),
                encoding: Encoding::of(&channel.message_encoding),
                schema: schema.map(|(_, schema)| schema.clone()),
                messages: self.chunked.messages.remove(&id).unwrap_or_default(),
            });
        }
        for (id, messages) in &self.chunked.messages {
            self.damage.add(format!("{} messages of channel {id}, which is not described", messages.len()));
        }
        let storage = Box::new(McapFile { file: self.chunked.file });
        OpenFile { metadata: self.metadata, ..OpenFile::new(channels, storage, self.damage) }
    }
}

/// An MCAP file whose messages are read.
#[derive(Debug)]
struct McapFile {
    file: ChunkedFile,
}

impl Storage for McapFile {
    fn read(&self, chunk: u32, offset: u64, most: usize) -> Result<Vec<u8>, BagError> {
        let damaged = |problem: &str| BagError::message(self.file.path(), offset, problem);
        let head = self.file.bytes(chunk, offset, RECORD_HEAD)?;
        let mut fields = Fields::new(&head);
        let (Some(op::MESSAGE), Some(length)) = (fields.u8(), fields.u64()) else {
            return Err(damaged("there is no message"));
        };
        let Some(length) = length.checked_sub(MESSAGE_HEAD).filter(|length| *length <= MAX_MESSAGE) else {
            return Err(damaged("its length is wrong"));
        };
        let read = |wanted: u64| {
            let bytes = self.file.bytes(chunk, offset + RECORD_HEAD + MESSAGE_HEAD, wanted)?;
            if bytes.len() as u64 == wanted { Ok(bytes) } else { Err(damaged("it is cut off")) }
        };
        let bytes = read(length.min(most.max(packed_message::ZSTD_MAGIC.len()) as u64))?;
        packed_message::finish(bytes, most, || read(length), |problem| damaged(&problem))
    }
}

/// The head of a chunk with its length; the `start` of the chunk is to be set.
fn chunk_head(head: &[u8]) -> Option<(Chunk, u64)> {
    let mut fields = Fields::new(head);
    let _times = fields.bytes(16)?;
    let unpacked = fields.u64()?;
    let crc = fields.u32()?;
    let name = fields.sized()?;
    let packed = fields.u64()?;
    let length = 16 + 8 + 4 + 4 + name.len() as u64 + 8;
    let crc = (crc != 0).then_some(crc);
    Some((Chunk { packing: Packing::of(name)?, start: 0, packed, unpacked, crc }, length))
}

/// Calls `each` with the code, offset and body of every complete record of a chunk.
fn for_each_record(bytes: &[u8], mut each: impl FnMut(u8, u64, &[u8])) {
    let mut fields = Fields::new(bytes);
    let mut offset = 0;
    while let (Some(code), Some(length)) = (fields.u8(), fields.u64()) {
        let Some(body) = fields.bytes(length as usize) else { return };
        each(code, offset, body);
        offset += RECORD_HEAD + length;
    }
}

fn u16_of(fields: &mut Fields<'_>) -> Option<u16> {
    fields.bytes(2)?.try_into().ok().map(u16::from_le_bytes)
}

/// The log time of a message, nanoseconds. `fields`: from the sequence number on.
fn log_time(fields: &mut Fields<'_>) -> Option<i64> {
    fields.u32()?;
    fields.u64().map(|stamp_ns| stamp_ns as i64)
}
