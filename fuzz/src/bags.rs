//! Recordings of other programs.

use crate::files::in_file;

/// Messages of a topic that are read.
const MESSAGES: usize = 100;

/// A file of rosbag2, which is a database of SQLite.
///
/// # Panics
/// Reading does.
pub fn sqlite_bags(data: &[u8]) {
    in_file("bag.db3", data, |path| {
        let Ok(bag) = bags::Bag::open(path) else { return };
        for topic in bag.topics() {
            for message in topic.messages.iter().take(MESSAGES) {
                let _ = bag.read(message.place);
            }
        }
    });
}
