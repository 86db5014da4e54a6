//! Recordings of other programs.

use crate::files::in_file;

/// Messages of a topic that are read.
const MESSAGES: usize = 100;

/// A file of rosbag2, which is a database of SQLite.
///
/// # Panics
/// Reading does.
pub fn sqlite_bags(data: &[u8]) {
    read("bag.db3", data);
}

/// A file of MCAP.
///
/// # Panics
/// Reading does.
pub fn mcap_bags(data: &[u8]) {
    read("bag.mcap", data);
}

/// A file of rosbag1.
///
/// # Panics
/// Reading does.
pub fn rosbag1_bags(data: &[u8]) {
    read("bag.bag", data);
}

fn read(name: &str, data: &[u8]) {
    in_file(name, data, |path| {
        let Ok(bag) = bags::Bag::open(path) else { return };
        for topic in bag.topics() {
            for message in topic.messages.iter().take(MESSAGES) {
                let _ = bag.read(message.place);
            }
        }
    });
}
