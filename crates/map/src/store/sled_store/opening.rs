//! Opening and closing a sled database.

use std::fs::File;
use std::path::Path;
use std::time::{Duration, Instant};

use crate::store::error::DatabaseError;

/// The page cache of a database that is written: its leaves are changed many times.
pub(super) const WRITING_CACHE_BYTES: u64 = 128 * 1024 * 1024;
/// The page cache of a database that is read, from the first key to the last: what was read is not needed again.
pub(super) const READING_CACHE_BYTES: u64 = 8 * 1024 * 1024;

/// How long closing waits for sled's background threads to let go of the files.
const CLOSING_TIME: Duration = Duration::from_secs(10);
/// How often it looks.
const CLOSING_POLL: Duration = Duration::from_millis(2);

/// Opens a database, or creates an empty one.
///
/// # Arguments
/// * `cache_bytes`: of its page cache.
pub(super) fn open_database(folder: &Path, cache_bytes: u64) -> Result<sled::Db, DatabaseError> {
    let config = sled::Config::new()
        .path(folder)
        .cache_capacity(cache_bytes)
        // It is flushed before it is closed, so no timer is needed.
        .flush_every_ms(None);
    config.open().map_err(failed)
}

/// Flushes and closes a database. All handles of its trees must have been dropped.
///
/// # Errors
/// [`DatabaseError::Failed`]: not everything is on the disk.
pub(super) fn close_database(folder: &Path, database: sled::Db) -> Result<(), DatabaseError> {
    database.flush().map_err(failed)?;
    drop(database);
    // sled holds this lock until the last of its threads is done with the files.
    let file = File::open(folder.join("db")).map_err(|source| failed(source.into()))?;
    let started = Instant::now();
    while file.try_lock().is_err() {
        if started.elapsed() > CLOSING_TIME {
            let source = format!("it was not closed within {} s", CLOSING_TIME.as_secs()).into();
            return Err(DatabaseError::Failed { source });
        }
        std::thread::sleep(CLOSING_POLL);
    }
    Ok(())
}

pub(super) fn failed(source: sled::Error) -> DatabaseError {
    DatabaseError::Failed { source: source.into() }
}
