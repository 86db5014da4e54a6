//! Recordings of robots as topics and messages in order of time: MCAP, rosbag2 (SQLite), rosbag1.
//!
//! | module | what |
//! |---|---|
//! | `bag` | [`Bag`], an open recording of any format: its [`Topic`]s and their messages |
//! | `storage` | what a format has to provide |
//! | `mcap_file`, `sqlite_file`, `rosbag1_file` | the formats |
//! | `rosbag2_folder` | the files of a rosbag2, by its `metadata.yaml` or without it |
//! | `rosbag2_metadata` | what a rosbag2 states about itself: its files, texts as `custom_data` |
//! | `packed_file`, `packed_message` | files and messages that are compressed for themselves |
//! | `writer`, `mcap_writer`, `sqlite_writer` | [`BagWriter`]: MCAP and rosbag2 of ROS 2 messages |
//! | `qos` | [`OfferedQos`], what the publisher of a written topic offered |
//! | `chunk_index` | where the messages are, for the formats with chunks |
//! | `chunks` | reading and unpacking chunks, with a small cache |
//! | `fields` | numbers and strings of a byte slice |
//! | `error` | [`BagError`] |
//!
//! Opening reads the index, which takes 32 bytes of memory a message, and no message. A file that was cut off, as by a
//! full disk or a robot that was switched off, is read as far as it goes; [`Bag::damage`] says what is missing.
//!
//! The messages themselves are opaque here: their bytes come with the name of their type and their encoding.
//!
//! ```no_run
//! let bag = bags::Bag::open("drive.mcap".as_ref())?;
//! for topic in bag.topics() {
//!     println!("{}: {} messages of type {}", topic.name, topic.messages.len(), topic.type_name);
//! }
//! # Ok::<(), bags::BagError>(())
//! ```
#![cfg_attr(test, allow(clippy::unwrap_used))]

mod bag;
mod chunk_index;
mod chunks;
mod error;
mod fields;
mod mcap_file;
mod mcap_writer;
mod packed_file;
mod packed_message;
mod qos;
mod rosbag1_file;
mod rosbag2_folder;
mod rosbag2_metadata;
mod sqlite_file;
mod sqlite_writer;
mod storage;
mod writer;

pub use bag::{Bag, StoredMessage, Topic};
pub use error::BagError;
pub use qos::OfferedQos;
pub use storage::{Encoding, MAX_MESSAGE, Metadata, Place, Schema};
pub use writer::{BagWriter, Format, MessageType, WrittenTopic};
