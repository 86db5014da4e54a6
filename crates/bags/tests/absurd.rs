//! Files of SQLite that are none of a recorder: views without end, messages of gigabytes, pipes in the place of files.

use bags::Bag;
use rusqlite::Connection;
use std::path::Path;

const TOPICS: &str =
    "CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
    INSERT INTO topics VALUES (1, '/imu', 'sensor_msgs/msg/Imu', 'cdr');";

fn written(path: &Path, statements: &str) {
    Connection::open(path).unwrap().execute_batch(&format!("{TOPICS}{statements}")).unwrap();
}

/// Its rows have no end: whoever reads them does not come back.
#[test]
fn a_view_in_the_place_of_a_table_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag.db3");
    written(
        &path,
        "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n)
         SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM n;",
    );
    let error = Bag::open(&path).unwrap_err().to_string();
    assert!(error.contains("messages is not a table"), "{error}");
}

#[test]
fn a_message_beyond_the_limit_is_not_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag.db3");
    written(
        &path,
        "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
         INSERT INTO messages VALUES (1, 1, 10, zeroblob(300000000)), (2, 1, 20, x'01020304');",
    );
    let bag = Bag::open(&path).unwrap();
    let messages = &bag.topics()[0].messages;
    let error = bag.read(messages[0].place).unwrap_err().to_string();
    assert!(error.contains("300000000 bytes"), "{error}");
    assert_eq!(bag.read(messages[1].place).unwrap(), [1, 2, 3, 4]);
}

#[cfg(unix)]
#[test]
fn pipes_and_devices_are_named_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("bag.mcap");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    assert!(Bag::open(&pipe).unwrap_err().to_string().contains("pipe"));
    let device = folder.path().join("bag.db3");
    std::os::unix::fs::symlink("/dev/zero", &device).unwrap();
    assert!(Bag::open(&device).unwrap_err().to_string().contains("device"));
}
