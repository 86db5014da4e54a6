//! Writes rosbag2: a file of SQLite, and `metadata.yaml` beside it.

use crate::BagError;
use crate::qos::{self, OfferedQos};
use crate::rosbag2_metadata::{custom_data_yaml, quoted};
use crate::storage::Metadata;
use crate::writer::{MessageType, WrittenTopic};
use rusqlite::{Connection, params};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Version of the information about a recording.
const METADATA_VERSION: u32 = 9;

/// The tables of version 4.
const TABLES: &str = "PRAGMA journal_mode = WAL;
    CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
    CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
    CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
        serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
    CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
        encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
    CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
        data BLOB NOT NULL);
    CREATE INDEX timestamp_idx ON messages (timestamp ASC);
    INSERT INTO schema(schema_version, ros_distro) VALUES (4, 'jazzy');
    BEGIN;";

#[derive(Debug)]
pub(crate) struct SqliteWriter {
    folder: PathBuf,
    file: PathBuf,
    connection: Connection,
    topics: Vec<TopicCount>,
    metadata: Vec<Metadata>,
    first_ns: Option<i64>,
    last_ns: i64,
}

#[derive(Debug)]
struct TopicCount {
    name: String,
    type_name: &'static str,
    hash: &'static str,
    qos: OfferedQos,
    messages: u64,
}

impl SqliteWriter {
    pub(crate) fn create(folder: &Path) -> Result<Self, BagError> {
        std::fs::create_dir(folder).map_err(|source| BagError::io(folder, source))?;
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        let file = folder.join(format!("{name}_0.db3"));
        let opened = Connection::open(&file).and_then(|connection| {
            connection.execute_batch(TABLES)?;
            Ok(connection)
        });
        let connection = opened.map_err(|source| BagError::sqlite(&file, source))?;
        Ok(Self {
            folder: folder.to_path_buf(),
            file,
            connection,
            topics: Vec::new(),
            metadata: Vec::new(),
            first_ns: None,
            last_ns: 0,
        })
    }

    fn execute(&self, statement: &str, values: impl rusqlite::Params) -> Result<(), BagError> {
        let prepared = self.connection.prepare_cached(statement);
        let done = prepared.and_then(|mut statement| statement.execute(values));
        done.map(|_| ()).map_err(|source| BagError::sqlite(&self.file, source))
    }

    pub(crate) fn topic(
        &mut self,
        name: &str,
        of: &MessageType,
        qos: OfferedQos,
    ) -> Result<WrittenTopic, BagError> {
        let id = self.topics.len() as u16 + 1;
        self.execute(
            "INSERT INTO topics VALUES (?1, ?2, ?3, 'cdr', ?4, ?5)",
            params![id, name, of.name, qos.yaml(""), of.hash],
        )?;
        if !self.topics.iter().any(|topic| topic.type_name == of.name) {
            self.execute(
                "INSERT INTO message_definitions(topic_type, encoding, encoded_message_definition, type_description_hash)
                 VALUES (?1, 'ros2msg', ?2, ?3)",
                params![of.name, of.definition, of.hash],
            )?;
        }
        self.topics.push(TopicCount {
            name: name.to_owned(),
            type_name: of.name,
            hash: of.hash,
            qos,
            messages: 0,
        });
        Ok(WrittenTopic(id))
    }

    pub(crate) fn metadata(&mut self, metadata: &Metadata) -> Result<(), BagError> {
        self.metadata.push(metadata.clone());
        self.write_metadata_table()
    }

    /// The file has the information of `metadata.yaml`, too: it may be read alone, or its recorder be killed.
    fn write_metadata_table(&self) -> Result<(), BagError> {
        self.execute(
            "INSERT OR REPLACE INTO metadata(id, metadata_version, metadata) VALUES (1, ?1, ?2)",
            params![METADATA_VERSION, self.information("")],
        )
    }

    pub(crate) fn write(&mut self, topic: WrittenTopic, log_ns: i64, bytes: &[u8]) -> Result<(), BagError> {
        self.execute(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES (?1, ?2, ?3)",
            params![topic.0, log_ns, bytes],
        )?;
        if let Some(count) = self.topics.get_mut(usize::from(topic.0) - 1) {
            count.messages += 1;
        }
        self.first_ns = Some(self.first_ns.map_or(log_ns, |first_ns| first_ns.min(log_ns)));
        self.last_ns = self.last_ns.max(log_ns);
        Ok(())
    }

    pub(crate) fn flush(&mut self) -> Result<(), BagError> {
        self.commit("COMMIT; BEGIN")
    }

    fn commit(&self, statements: &str) -> Result<(), BagError> {
        self.connection.execute_batch(statements).map_err(|source| BagError::sqlite(&self.file, source))
    }

    pub(crate) fn finish(self) -> Result<(), BagError> {
        self.write_metadata_table()?;
        self.commit("COMMIT; PRAGMA journal_mode = DELETE")?;
        let path = self.folder.join("metadata.yaml");
        let text = format!("rosbag2_bagfile_information:\n{}", self.information("  "));
        files::write_whole(&path, text.as_bytes()).map_err(|source| BagError::io(&path, source))
    }

    /// What is stated about the recording, as YAML.
    ///
    /// # Arguments
    /// * `indent`: before each line.
    fn information(&self, indent: &str) -> String {
        let (begin_ns, messages) =
            (self.first_ns.unwrap_or(0), self.topics.iter().map(|topic| topic.messages).sum::<u64>());
        let duration_ns = self.last_ns.saturating_sub(begin_ns).max(0);
        let file = quoted(&self.file.file_name().unwrap_or_default().to_string_lossy());
        let mut topics = String::new();
        for TopicCount { name, type_name, hash, qos, messages } in &self.topics {
            let (name, key, profiles) = (quoted(name), qos::KEY, qos.yaml("        "));
            let _ = write!(
                topics,
                "  - topic_metadata:\n      name: {name}\n      type: {type_name}\n      serialization_format: cdr\n      \
                 {key}:\n{profiles}      type_description_hash: {hash}\n    message_count: {messages}\n"
            );
        }
        let topics = if topics.is_empty() { " []\n".to_owned() } else { format!("\n{topics}") };
        let custom_data = custom_data_yaml(&self.metadata);
        let text = format!(
            "version: {METADATA_VERSION}\nstorage_identifier: sqlite3\nduration:\n  nanoseconds: {duration_ns}\n\
             starting_time:\n  nanoseconds_since_epoch: {begin_ns}\nmessage_count: {messages}\n\
             topics_with_message_count:{topics}compression_format: \"\"\ncompression_mode: \"\"\n\
             relative_file_paths:\n  - {file}\nfiles:\n  - path: {file}\n    starting_time:\n      \
             nanoseconds_since_epoch: {begin_ns}\n    duration:\n      nanoseconds: {duration_ns}\n    \
             message_count: {messages}\ncustom_data:{custom_data}ros_distro: jazzy\n"
        );
        text.split_inclusive('\n').flat_map(|line| [indent, line]).collect()
    }
}
