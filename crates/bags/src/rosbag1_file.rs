//! ROS 1 bags, version 2.0.
//!
//! The records are walked from the beginning, chunks skipped: the index behind each chunk says what it holds. So a bag
//! that was not closed (`.bag.active`) is read in the same way as a complete one. The crate `rosbag` ends the program on
//! such a file, and unpacks every chunk to find a message.

use crate::BagError;
use crate::chunk_index::ChunkIndex;
use crate::chunks::{Chunk, ChunkedFile, Packing};
use crate::fields::Fields;
use crate::storage::{
    Channel, Damage, Encoding, MAX_MESSAGE, NO_CHUNK, OpenFile, Schema, Storage, short_type,
};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

pub(crate) const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
/// Larger heads of records are damage, bytes.
const MAX_HEAD: u64 = 1 << 16;

const MESSAGE: u8 = 0x02;
const BAG: u8 = 0x03;
const INDEX: u8 = 0x04;
const CHUNK: u8 = 0x05;
const CONNECTION: u8 = 0x07;

/// Reads the index of a file.
pub(crate) fn open(path: &Path) -> Result<OpenFile, BagError> {
    let mut index = Index {
        chunked: ChunkIndex::new(ChunkedFile::open(path)?),
        connections: BTreeMap::new(),
        damage: Damage::default(),
    };
    index.walk()?;
    index.read_missing_connections()?;
    Ok(index.finish())
}

struct Connection {
    topic: String,
    type_name: String,
    definition: Vec<u8>,
}

struct Index {
    /// By connection.
    chunked: ChunkIndex<u32>,
    connections: BTreeMap<u32, Connection>,
    damage: Damage,
}

impl Index {
    fn walk(&mut self) -> Result<(), BagError> {
        let mut at = MAGIC.len() as u64;
        while at < self.chunked.file.length() {
            let Some((head, data, length)) = self.record_at(at)? else {
                self.damage
                    .add(format!("the file is cut off or damaged at byte {at}: what follows is left out"));
                break;
            };
            let head = Head::new(&head);
            let code = head.code();
            if code != Some(INDEX) {
                self.end_chunk(true)?;
            }
            let is_cut = data + length > self.chunked.file.length();
            match code {
                Some(BAG) => self.check_closed(&head),
                Some(CHUNK) => self.add_chunk(&head, data, length),
                Some(INDEX) if !is_cut => {
                    let entries = self.chunked.file.range(data, length)?;
                    self.add_index(&head, &entries);
                }
                Some(CONNECTION) if !is_cut => {
                    let data = self.chunked.file.range(data, length)?;
                    self.add_connection(&head, &data);
                }
                Some(MESSAGE) if !is_cut => {
                    if let (Some(connection), Some(stamp_ns)) = (head.u32(b"conn"), head.time()) {
                        self.chunked.add_message(connection, stamp_ns, NO_CHUNK, at);
                    }
                }
                _ => {}
            }
            if is_cut {
                self.damage.add(format!("the file is cut off in the record at byte {at}"));
                break;
            }
            at = data + length;
        }
        self.end_chunk(false)
    }

    /// The head of a bag that was closed says where its index is.
    fn check_closed(&mut self, head: &Head<'_>) {
        let index = head.field(b"index_pos").and_then(|value| Fields::new(value).u64());
        if !index.is_some_and(|index| (1..self.chunked.file.length()).contains(&index)) {
            self.damage.add("the bag was not closed, or its end is missing");
        }
    }

    /// The head of a record, the first byte of its data, and how many they are.
    fn record_at(&self, at: u64) -> Result<Option<(Vec<u8>, u64, u64)>, BagError> {
        let Some(head_length) = self.u32_at(at)?.filter(|length| *length <= MAX_HEAD) else {
            return Ok(None);
        };
        let head = self.chunked.file.range(at + 4, head_length)?;
        if head.len() as u64 != head_length || Head::new(&head).code().is_none() {
            return Ok(None);
        }
        let data = at + 4 + head_length;
        Ok(self.u32_at(data)?.map(|length| (head, data + 4, length)))
    }

    fn u32_at(&self, at: u64) -> Result<Option<u64>, BagError> {
        Ok(Fields::new(&self.chunked.file.range(at, 4)?).u32().map(u64::from))
    }

    fn add_chunk(&mut self, head: &Head<'_>, data: u64, length: u64) {
        let packing = head.field(b"compression").and_then(Packing::of);
        let (Some(packing), Some(unpacked)) = (packing, head.u32(b"size")) else {
            self.damage.add(format!("the chunk at byte {data} has an unknown compression"));
            return;
        };
        let packed = length.min(self.chunked.file.length().saturating_sub(data));
        let unpacked = u64::from(unpacked);
        self.chunked.add_chunk(Chunk { packing, start: data, packed, unpacked, crc: None });
    }

    /// Takes the messages of a connection in the newest chunk from its index.
    fn add_index(&mut self, head: &Head<'_>, entries: &[u8]) {
        let Some(connection) = head.u32(b"conn") else { return };
        let mut fields = Fields::new(entries);
        let entries = std::iter::from_fn(|| Some((time(&mut fields)?, u64::from(fields.u32()?))));
        self.chunked.add_index(connection, entries);
    }

    /// Ends the newest chunk; searches it where its index is missing or cut off.
    fn end_chunk(&mut self, is_complete: bool) -> Result<(), BagError> {
        self.chunked.end_chunk(is_complete).map_or(Ok(()), |number| self.scan_chunk(number))
    }

    /// Finds the messages of a chunk in itself.
    fn scan_chunk(&mut self, number: u32) -> Result<(), BagError> {
        let unpacked = self.chunked.file.unpack(self.chunked.file.chunks[number as usize])?;
        unpacked.problem.into_iter().for_each(|problem| self.damage.add(problem));
        for_each_record(&unpacked.bytes, |offset, head, data| match head.code() {
            Some(MESSAGE) => {
                if let (Some(connection), Some(stamp_ns)) = (head.u32(b"conn"), head.time()) {
                    self.chunked.add_message(connection, stamp_ns, number, offset);
                }
            }
            Some(CONNECTION) => self.add_connection(head, data),
            _ => {}
        });
        Ok(())
    }

    fn add_connection(&mut self, head: &Head<'_>, data: &[u8]) {
        let data = Head::new(data);
        let text = |value: Option<&[u8]>| value.map(|value| String::from_utf8_lossy(value).into_owned());
        let (Some(id), Some(topic), Some(type_name)) =
            (head.u32(b"conn"), text(head.field(b"topic")), text(data.field(b"type")))
        else {
            return self.damage.add("a connection without topic or type");
        };
        let definition = data.field(b"message_definition").unwrap_or_default().to_vec();
        self.connections.insert(id, Connection { topic, type_name, definition });
    }

    /// Reads the connections of a bag that was not closed: they are in its chunks.
    fn read_missing_connections(&mut self) -> Result<(), BagError> {
        for number in 0..self.chunked.file.chunks.len() {
            if self.chunked.messages.keys().all(|id| self.connections.contains_key(id)) {
                break;
            }
            let unpacked = self.chunked.file.unpack(self.chunked.file.chunks[number])?;
            for_each_record(&unpacked.bytes, |_, head, data| {
                if head.code() == Some(CONNECTION) {
                    self.add_connection(head, data);
                }
            });
        }
        Ok(())
    }

    fn finish(mut self) -> OpenFile {
        let mut channels = Vec::new();
        for (id, connection) in self.connections {
            channels.push(Channel {
                topic: connection.topic,
                type_name: short_type(&connection.type_name),
                encoding: Encoding::Ros1,
                schema: Some(Schema { encoding: "ros1msg".to_owned(), text: connection.definition }),
                messages: self.chunked.messages.remove(&id).unwrap_or_default(),
            });
        }
        for (id, messages) in &self.chunked.messages {
            self.damage
                .add(format!("{} messages of connection {id}, which is not described", messages.len()));
        }
        OpenFile::new(channels, Box::new(Rosbag1File { file: self.chunked.file }), self.damage)
    }
}

/// A ROS 1 bag whose messages are read.
#[derive(Debug)]
struct Rosbag1File {
    file: ChunkedFile,
}

impl Storage for Rosbag1File {
    fn read(&self, chunk: u32, offset: u64, most: usize) -> Result<Vec<u8>, BagError> {
        let damaged = |problem: &str| BagError::message(self.file.path(), offset, problem);
        let u32_at = |at: u64| -> Result<u64, BagError> {
            let bytes = self.file.bytes(chunk, at, 4)?;
            Fields::new(&bytes).u32().map(u64::from).ok_or_else(|| damaged("it is cut off"))
        };
        let head_length = u32_at(offset)?;
        let head = self.file.bytes(chunk, offset + 4, head_length.min(MAX_HEAD))?;
        if Head::new(&head).code() != Some(MESSAGE) {
            return Err(damaged("there is no message"));
        }
        let data = offset + 4 + head_length;
        let length = u32_at(data)?;
        if length > MAX_MESSAGE {
            return Err(damaged("its length is wrong"));
        }
        let wanted = length.min(most as u64);
        let bytes = self.file.bytes(chunk, data + 4, wanted)?;
        if bytes.len() as u64 == wanted { Ok(bytes) } else { Err(damaged("it is cut off")) }
    }
}

/// Fields `name=value` of a record; of two with the same name the last one counts.
struct Head<'a> {
    fields: HashMap<&'a [u8], &'a [u8]>,
}

impl<'a> Head<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        let mut fields = HashMap::new();
        let mut rest = Fields::new(bytes);
        while let Some(field) = rest.sized() {
            let Some(equals) = field.iter().position(|&byte| byte == b'=') else { break };
            fields.insert(&field[..equals], &field[equals + 1..]);
        }
        Self { fields }
    }

    fn field(&self, name: &[u8]) -> Option<&'a [u8]> {
        self.fields.get(name).copied()
    }

    /// What kind of record it is.
    fn code(&self) -> Option<u8> {
        match self.field(b"op") {
            Some([code]) => Some(*code),
            _ => None,
        }
    }

    fn u32(&self, name: &[u8]) -> Option<u32> {
        Fields::new(self.field(name)?).u32()
    }

    fn time(&self) -> Option<i64> {
        time(&mut Fields::new(self.field(b"time")?))
    }
}

/// Seconds and nanoseconds as nanoseconds.
fn time(fields: &mut Fields<'_>) -> Option<i64> {
    let (seconds, nanoseconds) = (fields.u32()?, fields.u32()?);
    Some(i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds))
}

/// Calls `each` with the offset, the head and the data of every complete record of a chunk.
fn for_each_record(bytes: &[u8], mut each: impl FnMut(u64, &Head<'_>, &[u8])) {
    let mut fields = Fields::new(bytes);
    let mut offset = 0;
    while let (Some(head), Some(data)) = (fields.sized(), fields.sized()) {
        each(offset, &Head::new(head), data);
        offset += 8 + (head.len() + data.len()) as u64;
    }
}
