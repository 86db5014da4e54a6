//! Files of rosbag2 in SQLite (`.db3`): the tables `topics` and `messages`.

use crate::BagError;
use crate::storage::{Channel, Damage, Encoding, MAX_MESSAGE, OpenFile, Schema, Storage, short_type};
use rusqlite::{Connection, OpenFlags, OptionalExtension, Row};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

pub(crate) const MAGIC: &[u8] = b"SQLite format 3\0";

/// Reads the index of a file. `packed`: each message is compressed with zstd, as `metadata.yaml` says.
pub(crate) fn open(path: &Path, packed: bool) -> Result<OpenFile, BagError> {
    let sqlite = |source| BagError::sqlite(path, source);
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = Connection::open_with_flags(path, flags).map_err(sqlite)?;
    let mut damage = Damage::default();
    let mut channels = read_topics(&connection).map_err(sqlite)?;
    if let Err(error) = read_messages(&connection, &mut channels, &mut damage) {
        damage.add(format!("the table of messages is damaged: {error}; what follows is left out"));
    }
    let storage = SqliteFile { path: path.to_path_buf(), connection: Mutex::new(connection), packed };
    Ok(OpenFile { channels: channels.into_values().collect(), storage: Box::new(storage), damage })
}

fn read_topics(connection: &Connection) -> rusqlite::Result<BTreeMap<i64, Channel>> {
    let mut statement = connection.prepare("SELECT id, name, type, serialization_format FROM topics")?;
    let rows = statement.query_map((), |row| {
        let type_name: String = row.get(2)?;
        let channel = Channel {
            topic: row.get(1)?,
            encoding: Encoding::of(&row.get::<_, String>(3)?),
            schema: definition(connection, &type_name),
            type_name: short_type(&type_name),
            messages: Vec::new(),
        };
        Ok((row.get(0)?, channel))
    })?;
    rows.collect()
}

/// The definition of a type, which only newer files carry.
fn definition(connection: &Connection, type_name: &str) -> Option<Schema> {
    let query = "SELECT encoding, encoded_message_definition FROM message_definitions WHERE topic_type = ?1";
    let schema = |row: &Row<'_>| {
        let text: String = row.get(1)?;
        Ok(Schema { encoding: row.get(0)?, text: text.into_bytes() })
    };
    connection.query_row(query, [type_name], schema).ok().filter(|schema| !schema.text.is_empty())
}

fn read_messages(
    connection: &Connection,
    channels: &mut BTreeMap<i64, Channel>,
    damage: &mut Damage,
) -> rusqlite::Result<()> {
    let mut statement = connection.prepare("SELECT id, topic_id, timestamp FROM messages ORDER BY id")?;
    let mut rows = statement.query(())?;
    while let Some(row) = rows.next()? {
        match (row.get::<_, i64>(0), row.get(1), row.get(2)) {
            (Ok(id), Ok(topic), Ok(stamp_ns)) if channels.contains_key(&topic) => {
                if let Some(channel) = channels.get_mut(&topic) {
                    channel.messages.push((stamp_ns, 0, id as u64));
                }
            }
            _ => damage.add("a row of messages is damaged, or its topic is not described"),
        }
    }
    Ok(())
}

#[derive(Debug)]
struct SqliteFile {
    path: PathBuf,
    connection: Mutex<Connection>,
    packed: bool,
}

impl Storage for SqliteFile {
    fn read(&self, _: u32, row: u64, most: usize) -> Result<Vec<u8>, BagError> {
        let connection = self.connection.lock().unwrap_or_else(PoisonError::into_inner);
        let wanted = if self.packed { MAX_MESSAGE } else { (most as u64).min(MAX_MESSAGE) };
        let query = "SELECT substr(data, 1, ?2) FROM messages WHERE id = ?1";
        let found = connection
            .prepare_cached(query)
            .and_then(|mut statement| {
                statement.query_row((row as i64, wanted as i64), |row| row.get::<_, Vec<u8>>(0)).optional()
            })
            .map_err(|source| BagError::sqlite(&self.path, source))?;
        let bytes = found.ok_or_else(|| BagError::message(&self.path, row, "it is missing"))?;
        if !self.packed {
            return Ok(bytes);
        }
        let reader = zstd::stream::Decoder::with_buffer(bytes.as_slice());
        let mut unpacked = Vec::new();
        let read = reader.and_then(|reader| {
            std::io::Read::read_to_end(&mut std::io::Read::take(reader, most as u64), &mut unpacked)
        });
        read.map_err(|error| BagError::message(&self.path, row, error.to_string()))?;
        Ok(unpacked)
    }
}
