//! An open recording of any format.

use crate::packed_file::TemporaryFile;
use crate::storage::{Channel, Encoding, Metadata, OpenFile, Place, Schema, Storage};
use crate::{BagError, mcap_file, packed_file, rosbag1_file, rosbag2_folder, sqlite_file};
use std::fmt;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Bytes at the begin of a file that tell its format.
const FORMAT_BYTES: u64 = 16;

/// A recording: its topics, and where their messages are.
///
/// Methods take `&self`, also from several threads; messages are read from the file when they are asked for.
pub struct Bag {
    path: PathBuf,
    topics: Vec<Topic>,
    files: Vec<Box<dyn Storage>>,
    metadata: Vec<Metadata>,
    damage: Vec<String>,
    notes: Vec<String>,
    /// Copies that exist as long as their recording is open; after the files, which are closed before.
    temporary: Vec<TemporaryFile>,
}

/// A topic and its messages.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Topic {
    /// Name, as recorded.
    pub name: String,
    /// Type of its messages, in the form `sensor_msgs/Imu` for ROS 1 and ROS 2.
    pub type_name: String,
    /// How its messages are serialized.
    pub encoding: Encoding,
    /// The definition of the type, where the recording carries it.
    pub schema: Option<Schema>,
    /// Its messages in order of the time at which they were recorded.
    pub messages: Vec<StoredMessage>,
}

/// A message that was not read yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StoredMessage {
    /// When it was recorded, nanoseconds. The sensor's own time is in the message.
    pub log_ns: i64,
    /// Where it is; see [`Bag::read`].
    pub place: Place,
}

impl fmt::Debug for Bag {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Bag({}, {} topics)", self.path.display(), self.topics.len())
    }
}

impl Bag {
    /// Whether a path looks like a recording of one of the formats: by the first bytes of a file, and of a folder by its
    /// `metadata.yaml` or its files.
    pub fn is_bag(path: &Path) -> bool {
        if path.is_dir() { rosbag2_folder::is_rosbag2(path) } else { is_recording_file(path) }
    }

    /// Opens a file, or the folder of a rosbag2. A file that is compressed as a whole is unpacked into a temporary folder.
    ///
    /// # Errors
    /// [`BagError`] with the file: it cannot be read, or is of no known format. What is damaged within it is left out,
    /// and told by [`Bag::damage`].
    pub fn open(path: &Path) -> Result<Self, BagError> {
        let mut bag = Self {
            path: path.to_path_buf(),
            topics: Vec::new(),
            files: Vec::new(),
            metadata: Vec::new(),
            damage: Vec::new(),
            notes: Vec::new(),
            temporary: Vec::new(),
        };
        if path.is_dir() {
            if !rosbag2_folder::is_rosbag2(path) {
                return Err(BagError::UnknownFormat { path: path.to_path_buf() });
            }
            let files = rosbag2_folder::read(path)?;
            (bag.notes, bag.metadata) = (files.notes, files.metadata);
            for file in &files.paths {
                match bag.add_file(file) {
                    Err(error) if files.paths.len() > 1 => bag.damage.push(error.to_string()),
                    added => added?,
                }
            }
        } else {
            bag.add_file(path)?;
        }
        for topic in &mut bag.topics {
            topic.messages.sort_by_key(|message| message.log_ns);
        }
        bag.topics.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(bag)
    }

    /// Adds a file; one that is compressed as a whole is unpacked before.
    fn add_file(&mut self, path: &Path) -> Result<(), BagError> {
        if !packed_file::is_packed(path) {
            let opened = open_file(path)?;
            self.add(path, opened);
            return Ok(());
        }
        let (unpacked, notes) = packed_file::unpack(path)?;
        let opened = open_file(&unpacked.path)?;
        self.notes.extend(notes);
        self.add(path, opened);
        self.temporary.push(unpacked);
        Ok(())
    }

    fn add(&mut self, path: &Path, opened: OpenFile) {
        let file = self.files.len() as u16;
        self.files.push(opened.storage);
        for channel in opened.channels {
            let messages = channel.messages.iter().map(|&(log_ns, chunk, offset)| StoredMessage {
                log_ns,
                place: Place { file, chunk, offset },
            });
            let same = |topic: &&mut Topic| topic.is_of(&channel);
            if let Some(topic) = self.topics.iter_mut().find(same) {
                topic.messages.extend(messages);
                continue;
            }
            let messages = messages.collect();
            let Channel { topic: name, type_name, encoding, schema, .. } = channel;
            self.topics.push(Topic { name, type_name, encoding, schema, messages });
        }
        for metadata in opened.metadata {
            // A file of a rosbag2 repeats what its folder states.
            if !self.metadata.contains(&metadata) {
                self.metadata.push(metadata);
            }
        }
        self.notes.extend(opened.notes);
        self.temporary.extend(opened.temporary);
        let lines = opened.damage.into_lines();
        self.damage.extend(lines.into_iter().map(|line| format!("{}: {line}", path.display())));
    }

    /// The file or folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The topics in order of their names.
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// Texts about the recording that are no messages, in the order of the file, of MCAP and rosbag2 (its `custom_data`).
    pub fn metadata(&self) -> &[Metadata] {
        &self.metadata
    }

    /// What could not be read, a line each; empty for a sound recording.
    pub fn damage(&self) -> &[String] {
        &self.damage
    }

    /// What had to be done to read the recording, a line each: a folder without `metadata.yaml`, files that were unpacked.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// The bytes of a message, unpacked where it is compressed for itself.
    ///
    /// # Errors
    /// [`BagError`]: the file cannot be read there, or is damaged. Other messages may be sound.
    pub fn read(&self, place: Place) -> Result<Vec<u8>, BagError> {
        self.read_start(place, usize::MAX)
    }

    /// The first bytes of a message, at most `most`.
    ///
    /// # Errors
    /// As [`Bag::read`].
    pub fn read_start(&self, place: Place, most: usize) -> Result<Vec<u8>, BagError> {
        self.files[usize::from(place.file)].read(place.chunk, place.offset, most)
    }
}

impl Topic {
    fn is_of(&self, channel: &Channel) -> bool {
        (&self.name, &self.type_name, &self.encoding)
            == (&channel.topic, &channel.type_name, &channel.encoding)
    }
}

/// Format of a file.
enum Format {
    Mcap,
    Rosbag1,
    Sqlite,
}

impl Format {
    /// The format by the first bytes.
    fn of(path: &Path) -> Result<Self, BagError> {
        let mut start = Vec::new();
        files::open(path)
            .and_then(|file| file.take(FORMAT_BYTES).read_to_end(&mut start))
            .map_err(|source| BagError::io(path, source))?;
        Self::by(&start).ok_or_else(|| BagError::UnknownFormat { path: path.to_path_buf() })
    }

    fn by(start: &[u8]) -> Option<Self> {
        let formats = [
            (mcap_file::MAGIC, Self::Mcap),
            (rosbag1_file::MAGIC, Self::Rosbag1),
            (sqlite_file::MAGIC, Self::Sqlite),
        ];
        let found = formats.into_iter().find(|(magic, _)| start.starts_with(magic));
        found.map(|(_, format)| format)
    }
}

/// Whether a file is a recording, also one that is compressed as a whole.
pub(crate) fn is_recording_file(path: &Path) -> bool {
    let is_unpacked =
        || packed_file::start_of(path, FORMAT_BYTES).is_ok_and(|start| Format::by(&start).is_some());
    Format::of(path).is_ok() || (packed_file::is_packed(path) && is_unpacked())
}

fn open_file(path: &Path) -> Result<OpenFile, BagError> {
    match Format::of(path)? {
        Format::Mcap => mcap_file::open(path),
        Format::Rosbag1 => rosbag1_file::open(path),
        Format::Sqlite => sqlite_file::open(path),
    }
}
