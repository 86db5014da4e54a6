//! Files of rosbag2 in SQLite (`.db3`): the tables `topics` and `messages`.

use crate::BagError;
use crate::packed_file::TemporaryFile;
use crate::packed_message;
use crate::rosbag2_metadata::Information;
use crate::storage::{
    Channel, Damage, Encoding, MAX_MESSAGE, Metadata, OpenFile, Schema, Storage, short_type,
};
use rusqlite::{Connection, OpenFlags, OptionalExtension, Row};
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

pub(crate) const MAGIC: &[u8] = b"SQLite format 3\0";

/// Longest information about a recording that is read (characters).
const MAX_INFORMATION: i64 = 1 << 20;

/// How the name of a write-ahead log ends.
const LOG: &str = "-wal";

/// Reads the index of a file, with the write-ahead log that a recorder which was killed leaves beside it.
pub(crate) fn open(path: &Path) -> Result<OpenFile, BagError> {
    let Opened { connection, notes, copy } = connect(path)?;
    if let Some(name) = not_a_table(&connection).map_err(|source| BagError::sqlite(path, source))? {
        let problem = format!("{name} is not a table of rows, as rosbag2 writes it: a view may have no end");
        return Err(BagError::invalid(path, problem));
    }
    let mut damage = Damage::default();
    let mut channels = read_topics(&connection).map_err(|source| BagError::sqlite(path, source))?;
    if let Err(error) = read_messages(&connection, &mut channels, &mut damage) {
        damage.add(format!("the table of messages is damaged: {error}; what follows is left out"));
    }
    let metadata = read_metadata(&connection);
    let storage = SqliteFile { path: path.to_path_buf(), connection: Mutex::new(connection) };
    let opened = OpenFile::new(channels.into_values().collect(), Box::new(storage), damage);
    Ok(OpenFile { metadata, notes, temporary: copy, ..opened })
}

/// The texts about the recording, which only newer files carry.
fn read_metadata(connection: &Connection) -> Vec<Metadata> {
    let query = "SELECT metadata FROM metadata WHERE length(metadata) <= ?1 ORDER BY id DESC";
    let text = connection.query_row(query, [MAX_INFORMATION], |row| row.get::<_, String>(0));
    let information = text.ok().and_then(|text| serde_saphyr::from_str::<Information>(&text).ok());
    information.map(|information| information.metadata()).unwrap_or_default()
}

struct Opened {
    connection: Connection,
    notes: Vec<String>,
    copy: Option<TemporaryFile>,
}

/// Opens a file. SQLite reads a write-ahead log only where it can write a file beside it; on a read-only disk, copies are
/// read.
fn connect(path: &Path) -> Result<Opened, BagError> {
    let log = with_ending(path, LOG);
    let has_log = log.metadata().is_ok_and(|metadata| metadata.len() > 0);
    let mut notes = Vec::new();
    if has_log {
        notes.push(format!(
            "{}: there is a write-ahead log, as a recorder that was killed leaves it; its messages are read, too",
            path.display()
        ));
    }
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let error = match try_connect(path, flags) {
        Ok(connection) => return Ok(Opened { connection, notes, copy: None }),
        Err(error) => BagError::sqlite(path, error),
    };
    if !has_log {
        // Without a log, nothing beside the file is needed.
        let uri = immutable_uri(path);
        let opened = try_connect(&uri, flags | OpenFlags::SQLITE_OPEN_URI);
        return opened.map(|connection| Opened { connection, notes, copy: None }).map_err(|_| error);
    }
    let copy = TemporaryFile::named_as(path)?;
    for (from, to) in [(path, &copy.path), (&log, &with_ending(&copy.path, LOG))] {
        copy_contents(from, to).map_err(|source| BagError::io(from, source))?;
    }
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let Ok(connection) = try_connect(&copy.path, flags) else { return Err(error) };
    notes.push(format!(
        "{}: the log cannot be read there (a read-only disk?); copies were made in {} for now",
        path.display(),
        copy.path.parent().unwrap_or(path).display()
    ));
    Ok(Opened { connection, notes, copy: Some(copy) })
}

/// Opens a file, and reads from it: only then SQLite looks at it.
fn try_connect(path: &Path, flags: OpenFlags) -> rusqlite::Result<Connection> {
    let connection = Connection::open_with_flags(path, flags)?;
    connection.query_row("SELECT count(*) FROM sqlite_master", (), |_| Ok(()))?;
    Ok(connection)
}

/// The copy of a read-only file is not read-only.
fn copy_contents(from: &Path, to: &Path) -> std::io::Result<()> {
    std::io::copy(&mut files::open(from)?, &mut File::create(to)?).map(drop)
}

fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

/// A file that nobody changes, as SQLite names it.
fn immutable_uri(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let escaped = path.to_string_lossy().replace('%', "%25").replace('?', "%3f").replace('#', "%23");
    format!("file:{escaped}?immutable=1").into()
}

/// The name of something that takes the place of a table.
fn not_a_table(connection: &Connection) -> rusqlite::Result<Option<String>> {
    let query = "SELECT name FROM sqlite_master WHERE lower(name) IN ('topics', 'messages', 'message_definitions', 'metadata') \
                 AND (type IN ('view', 'trigger') OR type = 'table' AND sql LIKE 'CREATE VIRTUAL%')";
    connection.query_row(query, (), |row| row.get(0)).optional()
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
}

impl SqliteFile {
    /// The first bytes of a message as they are stored.
    fn stored(&self, row: u64, most: u64) -> Result<Vec<u8>, BagError> {
        let connection = self.connection.lock().unwrap_or_else(PoisonError::into_inner);
        let wanted = most.min(MAX_MESSAGE) as i64;
        let failed = |source| BagError::sqlite(&self.path, source);
        // The length is known without the bytes; whatever is taken of them, SQLite reads all.
        let length = connection
            .prepare_cached("SELECT length(data) FROM messages WHERE id = ?1")
            .and_then(|mut statement| {
                statement.query_row([row as i64], |row| row.get::<_, i64>(0)).optional()
            })
            .map_err(failed)?;
        if let Some(bytes) = length.filter(|bytes| *bytes > MAX_MESSAGE as i64) {
            let problem = format!("it has {bytes} bytes, more than {MAX_MESSAGE}");
            return Err(BagError::message(&self.path, row, problem));
        }
        let found = connection
            .prepare_cached("SELECT substr(data, 1, ?2) FROM messages WHERE id = ?1")
            .and_then(|mut statement| {
                statement.query_row((row as i64, wanted), |row| row.get::<_, Vec<u8>>(0)).optional()
            })
            .map_err(failed)?;
        found.ok_or_else(|| BagError::message(&self.path, row, "it is missing"))
    }
}

impl Storage for SqliteFile {
    fn read(&self, _: u32, row: u64, most: usize) -> Result<Vec<u8>, BagError> {
        let start = self.stored(row, most.max(packed_message::ZSTD_MAGIC.len()) as u64)?;
        let damaged = |problem| BagError::message(&self.path, row, problem);
        packed_message::finish(start, most, || self.stored(row, MAX_MESSAGE), damaged)
    }
}
